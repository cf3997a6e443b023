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
# Least number of consecutive points at which one path follows another; fewer are a crossing.
MIN_SHARED = 5


def stripes(paths: Sequence[FloatArray]) -> list[list[tuple[FloatArray, int]]]:
    """Cut each path (L, 2) into pieces (K, 2), each with the number of later paths along it."""
    tolerance = SAME_ROAD * float(np.ptp(np.concatenate(paths), axis=0).max())
    pieces = []
    for k, path in enumerate(paths):
        count = np.zeros(len(path), dtype=int)
        for other in paths[k + 1 :]:
            count += cKDTree(other).query(path)[0] < tolerance
        count = scipy.ndimage.grey_opening(count, MIN_SHARED)
        runs = np.split(np.arange(len(path)), np.flatnonzero(np.diff(count)) + 1)
        pieces.append([(path[max(run[0] - 1, 0) : run[-1] + 1], int(count[run[0]]))
                       for run in runs])
    return pieces
