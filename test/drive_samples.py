"""Routes to drive, made at random, for the tests of what is driven."""

from __future__ import annotations

import numpy as np
from games import random_map
from hypothesis import assume
from hypothesis import strategies as st

from ambush_planner import (
    GoalBlocked,
    InvalidNetwork,
    NetworkOptions,
    NoRoute,
    StartBlocked,
    build_network,
)
from ambush_planner.network.shortest_paths import shortest_path
from ambush_planner.routes.corridors import make_corridors

METHODS = ('uniform_delaunay', 'lattice_delaunay', 'uniform_grid8', 'random_delaunay')


def some_route(network, seed):
    """A route that is shortest for random lengths, so it turns a lot."""
    weights = 0.05 + np.random.default_rng(seed).random(len(network.edges))
    return shortest_path(
        network.edges, weights, len(network.points), network.source, network.target
    )


@st.composite
def drives(draw, tubes=(None, 0.05, 0.3, 1.0)):
    """Corridors, a route in them, and what they were made from."""
    cells = draw(st.integers(6, 14))
    risk_map = random_map(draw(st.integers(0, 10**6)), cells, 0.1, draw(st.floats(-4, 4)))
    place = st.tuples(*[st.floats(0.4, cells - 0.4)] * 2)
    clearance, clear_of_edge = draw(st.sampled_from((0.0, 0.25))), draw(st.booleans())
    options = NetworkOptions(
        draw(st.sampled_from(METHODS)), draw(st.sampled_from((0.7, 1.0, 1.6))), clearance,
        clear_of_edge=clear_of_edge,
    )
    ends = risk_map.to_world(np.array(draw(st.tuples(place, place))))
    try:
        network = build_network(risk_map, *ends, options)
    except (StartBlocked, GoalBlocked, NoRoute, InvalidNetwork):
        assume(False)
    tube = draw(st.sampled_from(tubes))
    corridors = make_corridors(network, risk_map, clearance, tube, clear_of_edge)
    route = some_route(network, draw(st.integers(0, 99)))
    return corridors, route, risk_map, clearance, tube, clear_of_edge


def distance_to(points, line):
    """Distance (K,) of points from a polyline (L, 2)."""
    line = line[np.append(np.hypot(*np.diff(line, axis=0).T) > 0.0, True)]
    a, along = line[:-1], np.diff(line, axis=0)
    t = ((points[:, None] - a) * along).sum(axis=2) / (along**2).sum(axis=1)
    foot = a + np.clip(t, 0.0, 1.0)[..., None] * along
    return np.linalg.norm(points[:, None] - foot, axis=2).min(axis=1)
