"""Damaged copies of a file."""

import numpy as np


def truncations(data, count):
    """Cut off at places spread evenly over the file."""
    return [data[:place] for place in np.linspace(0, len(data) - 1, count).astype(int)]


def flips(data, count, rng):
    """Each with one bit changed."""
    for place in rng.integers(0, len(data), count):
        changed = bytearray(data)
        changed[place] ^= 1 << int(rng.integers(0, 8))
        yield bytes(changed)
