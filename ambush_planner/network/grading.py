# SPDX-License-Identifier: Apache-2.0
"""The spacing of a graded network's nodes, place by place.

Of routes through nodes h apart, a disc of radius R covers a width of 2 R + h. So a finer spacing
gains most where few discs cover all routes: around the rim of the secured area, where routes fan
out, and around the ambusher's sites (docs/theory.md, section 10).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ..arrays import FloatArray

# Growth of the spacing per distance from the rim of the secured area, and from the rings around
# refined places.
END_GROWTH, PLACE_GROWTH = 0.25, 0.5
# A refined place is fine in a ring, of this mean radius and half-width [radius of refined places].
RING, HALF_WIDTH = 0.88, 0.12


@dataclass(frozen=True, eq=False)
class Grading:
    """Spacing of nodes as a function of the place.

    Parameters
    ----------
    finest
        Least spacing, at the rim of the secured area around the ends [m].
    rim
        Radius of the secured area around start, stops and goal [m].
    refined : (K, 3), optional
        Refined places (x, y) and their spacings [m], which hold in a ring, where routes squeeze
        past an ambush. None: the spacing is plain everywhere.
    radius
        Outer radius of the rings [m].
    """

    finest: float
    rim: float
    refined: FloatArray | None
    radius: float

    def spacing_at(self, points: FloatArray, ends: FloatArray, plain: float) -> FloatArray:
        """Return the spacing (K,) [m] at points (K, 2), for ``ends`` (E, 2); at most ``plain``."""
        if self.refined is None:
            return np.full(len(points), plain)
        rim_distance = np.abs(cKDTree(ends).query(points)[0] - self.rim)
        spacing = np.maximum(END_GROWTH * rim_distance, self.finest)
        for finest in np.unique(self.refined[:, 2]):
            places = self.refined[self.refined[:, 2] == finest, :2]
            distance = cKDTree(places).query(points)[0] / self.radius
            ring_distance = self.radius * (np.abs(distance - RING) - HALF_WIDTH)
            spacing = np.minimum(spacing, np.maximum(PLACE_GROWTH * ring_distance, finest))
        return np.minimum(spacing, plain)
