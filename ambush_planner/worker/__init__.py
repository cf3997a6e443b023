"""Solves in a process of their own, so that nothing else waits for them."""
