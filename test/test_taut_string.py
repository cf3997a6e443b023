"""The taut string against a general minimiser; portals against the ground."""

import numpy as np
import pytest
from drive_samples import drives
from games import examples
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.optimize import minimize

from ambush_planner.routes.taut_string import Portals, portals_along, taut_strings


def string(portals, margin):
    """The corners (C, 2) of the taut string."""
    ends = {side: portals.places(margin, side) for side in (1, -1)}
    (corners,) = taut_strings(portals, margin, [0])
    return np.array([ends[side or 1][k] for k, side in corners])


@examples(20)
@given(drives, st.floats(0.0, 0.45))
def test_the_taut_string_is_the_shortest_line_through_the_portals(drive, share):
    corridors, route = drive[:2]
    assume(len(route) > 2)
    assert_taut(portals_along(corridors, [route]), share)


def assert_taut(portals, share):
    """The string is as short as a general minimiser finds, over one place on each portal."""
    margin = share * portals.width
    low, high = (margin - portals.right)[1:-1], (portals.left - margin)[1:-1]

    def length(t):
        points = portals.nodes.copy()
        points[1:-1] += t[:, None] * portals.leftward[1:-1]
        steps = np.diff(points, axis=0)
        size = np.hypot(*steps.T)
        pull = -np.diff(steps / size[:, None], axis=0)
        return size.sum(), (pull * portals.leftward[1:-1]).sum(axis=1)

    found = minimize(
        length, (low + high) / 2, jac=True, method='L-BFGS-B',
        bounds=np.stack((low, high), axis=1), options={'ftol': 1e-15, 'maxiter': 5000},
    )
    size = np.hypot(*np.diff(string(portals, margin), axis=0).T).sum()
    assert size == pytest.approx(found.fun, rel=1e-5)
    assert size <= found.fun * (1 + 1e-9)


def test_portals_approached_from_behind():
    """Two sharp turns, one after the other: from the start, the second portal looks reversed."""
    nodes = [(4.2683, 2.8259), (4.55, 3.85), (3.85, 4.55), (3.85, 3.85), (3.15, 4.55),
             (2.45, 5.25), (1.75, 5.25), (1.0186, 5.3343)]
    leftward = [(0, 0), (-0.9668, -0.2556), (0.3827, -0.9239), (0.3827, -0.9239),
                (-0.7071, -0.7071), (-0.3827, -0.9239), (-0.0573, -0.9984), (0, 0)]
    left = [0, 0.6201, 0.2387, 0.1018, 0.7, 0.5762, 0.0339, 0]
    right = [0, 0.1404, 0.0807, 0.2387, 0.0606, 0.0448, 0.4692, 0]
    arrays = (np.array(values, float) for values in (nodes, leftward, left, right))
    assert_taut(Portals(*arrays, np.zeros(len(nodes)), np.array([0, len(nodes)])), 0.0)
