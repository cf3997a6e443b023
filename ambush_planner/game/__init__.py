# SPDX-License-Identifier: Apache-2.0
"""The ambush game on a network, and its solution.

``game`` has the ambush sites and losses, ``discs`` the edges that enter an ambush's reach.
``certificate`` bounds the value from both sides. ``solver`` finds the strategy: ``value`` has the
linear programs (LPs) that find the least value, ``distribution`` the most unpredictable strategy
near it. From outside, use ``solve`` of ``solver``, and ``strategy``: the record and its options.
"""
