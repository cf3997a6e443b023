# SPDX-License-Identifier: Apache-2.0
"""The ROS node: one room of the package that needs rclpy.

``planner_node`` wires the parts and has the lifecycle, ``program`` runs it; ``subscriptions`` and
``inputs`` take what arrives, ``requests`` and ``compute_path`` answer, and ``dispatcher`` takes a
request through ``plan_cache`` to ``departures``; ``diagnostics`` publishes the status.
docs/architecture.md follows a request through these files.
"""
