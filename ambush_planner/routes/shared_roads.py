# SPDX-License-Identifier: Apache-2.0
"""Roads that several paths follow: pictures draw them there as stripes of one line."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy  # loads ndimage when it is used
from scipy.spatial import cKDTree

from ..arrays import FloatArray

# Maximum distance of paths on one road, as a share of the size of all.
SAME_ROAD = 0.0005
# Number of places in a row from which one path follows another: fewer are a crossing.
MIN_SHARED = 5


def stripes(paths: Sequence[FloatArray]) -> list[list[tuple[FloatArray, int]]]:
    """The pieces (K, 2) of each path (L, 2), and how many of the later paths follow each piece."""
    near = SAME_ROAD * float(np.ptp(np.concatenate(paths), axis=0).max())
    found = []
    for k, path in enumerate(paths):
        over = np.zeros(len(path), dtype=int)
        for other in paths[k + 1 :]:
            over += cKDTree(other).query(path)[0] < near
        over = scipy.ndimage.grey_opening(over, MIN_SHARED)
        runs = np.split(np.arange(len(path)), np.flatnonzero(np.diff(over)) + 1)
        found.append([(path[max(run[0] - 1, 0) : run[-1] + 1], int(over[run[0]])) for run in runs])
    return found
