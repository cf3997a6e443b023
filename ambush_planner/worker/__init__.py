"""Solves in a process of their own, so that they block nothing else.

``solve_queue`` queues and shares solves; ``process`` starts, asks and kills the worker process;
``child`` is what runs in it; ``solve_errors`` has their errors.
"""
