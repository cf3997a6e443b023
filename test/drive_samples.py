# SPDX-License-Identifier: Apache-2.0
"""Routes to drive, made at random, for the tests of what is driven."""

from functools import cache

import numpy as np
from games import HUNT, METHODS, random_map
from hypothesis import strategies as st

from ambush_planner import GoalBlocked, NetworkOptions, NoRoute, StartBlocked, build_network
from ambush_planner.network.shortest_paths import shortest_path
from ambush_planner.routes.corridors import make_corridors


def some_route(network, seed):
    """A route that is shortest for random lengths, so it turns a lot."""
    weights = 0.05 + np.random.default_rng(seed).random(len(network.edges))
    return shortest_path(
        network.edges, weights, len(network.points), network.source, network.target
    )


@cache
def drive(seed):
    """Corridors, a route in them, and what they were made from."""
    rng = np.random.default_rng(seed)
    while True:
        cells = int(rng.integers(6, 15))
        risk_map = random_map(int(rng.integers(10**6)), cells, 0.1, rng.uniform(-4, 4))
        clearance, clear_of_edge = rng.choice((0.0, 0.25)), bool(rng.integers(2))
        options = NetworkOptions(
            method=str(rng.choice(METHODS[:4])), spacing=rng.choice((0.7, 1.0, 1.6)),
            clearance=clearance,
            clear_of_edge=clear_of_edge,
        )
        ends = risk_map.to_world(rng.uniform(0.4, cells - 0.4, (2, 2)))
        try:
            network = build_network(risk_map, *ends, options)
        except (StartBlocked, GoalBlocked, NoRoute):
            continue
        tube = (None, None, 0.05, 0.3, 1.0)[rng.integers(5)]
        corridors = make_corridors(network, risk_map, clearance, tube, clear_of_edge)
        return corridors, some_route(network, seed), risk_map, clearance, tube, clear_of_edge


# A limited number of drives, which the tests of a file share.
drives = st.integers(0, 50 * HUNT).map(drive)


def distance_to(points, line):
    """Distance (K,) of points from a polyline (L, 2)."""
    line = line[np.append(np.hypot(*np.diff(line, axis=0).T) > 0.0, True)]
    a, along = line[:-1], np.diff(line, axis=0)
    t = ((points[:, None] - a) * along).sum(axis=2) / (along**2).sum(axis=1)
    foot = a + np.clip(t, 0.0, 1.0)[..., None] * along
    return np.linalg.norm(points[:, None] - foot, axis=2).min(axis=1)
