# SPDX-License-Identifier: Apache-2.0
"""The program ``ambush``: one module for each command; ``cli`` is the entry and what they share.

Commands import ROS inside functions, so that all of them print their help, and those that read maps
run, without it. ``console`` prints, ``inputs`` reads maps and options.
"""
