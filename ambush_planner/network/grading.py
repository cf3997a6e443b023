# SPDX-License-Identifier: Apache-2.0
"""Distances between the nodes of a graded network, place by place.

A disc of radius R covers 2 R + h of the width of routes that run through nodes h apart, so nodes
belong where few discs cover all routes: around the rim of the secured area, where routes fan out,
and where the ambusher waits (docs/theory.md, section 10).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ..arrays import FloatArray

# Growth of the wanted spacing per distance from the rim of the secured area, and from the discs
# around refined places.
END_GROWTH, PLACE_GROWTH = 0.25, 0.5
# Places with less than this spacing are fine in a ring only; its radius and half its width. All are
# shares of the radius around places.
RING_BELOW, RING, HALF_WIDTH = 0.07, 0.88, 0.12


@dataclass(frozen=True, eq=False)
class Grading:
    """The spacing of nodes that is wanted at each place.

    Parameters
    ----------
    finest
        Least spacing around the ends [m].
    rim
        Radius of the secured area around start, stops and goal [m].
    refined : (K, 3), radius
        Places (x, y) and the spacing [m] within this radius [m] of each; the smallest spacings are
        wanted in a ring only, where routes squeeze past an ambush.
    """

    finest: float
    rim: float
    refined: FloatArray
    radius: float

    def wanted(self, points: FloatArray, ends: FloatArray, spacing: float) -> FloatArray:
        """Spacing (K,) [m] at points (K, 2), for ``ends`` (E, 2); at most the plain network's."""
        excess = cKDTree(ends).query(points)[0] - self.rim
        wanted = np.maximum(END_GROWTH * excess, self.finest)
        for finest in np.unique(self.refined[:, 2]):
            places = self.refined[self.refined[:, 2] == finest, :2]
            distance = cKDTree(places).query(points)[0] / self.radius
            excess = distance - 1.0
            if finest < RING_BELOW * self.radius:
                excess = np.abs(distance - RING) - HALF_WIDTH
            wanted = np.minimum(wanted, np.maximum(PLACE_GROWTH * self.radius * excess, finest))
        return np.minimum(wanted, spacing)
