# SPDX-License-Identifier: Apache-2.0
"""Solves in a process of their own, so that they block nothing else.

``solve_queue`` queues and shares solves; ``process`` starts, asks and kills the worker process;
``child`` is what runs in it; ``solve_errors`` has their errors.

The fork server of ``multiprocessing``, also below ``concurrent.futures``, would not do. Its workers
run the node's script and so import rclpy: each takes 1.5 s to start and 84 MB, here 0.02 s and
53 MB. They outlive a node that is killed for as long as the solve takes, and Ctrl-C reaches them.
"""
