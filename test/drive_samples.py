# SPDX-License-Identifier: Apache-2.0
"""Routes to drive, made at random, for the tests of what is driven."""

from functools import cache
from itertools import pairwise

import numpy as np
from games import HUNT, METHODS, neighbours, random_map
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from ambush_planner import (
    GoalBlocked,
    Network,
    NetworkOptions,
    NoRoute,
    StartBlocked,
    build_network,
)
from ambush_planner.game.discs import SecuredArea
from ambush_planner.maps.obstacles import ObstacleField
from ambush_planner.maps.risk_map import to_map_axes
from ambush_planner.network.shortest_paths import shortest_path
from ambush_planner.routes.corridors import make_corridors

# Distance of the points that stand for a drawn route [m].
STEP = 0.02


def some_route(network, seed):
    """A route that is shortest for random lengths, so it turns a lot."""
    weights = 0.05 + np.random.default_rng(seed).random(len(network.edges))
    return shortest_path(
        network.edges, weights, len(network.points), network.source, network.target
    )


def graded(network, risk_map, options, rng):
    """Another network between the same ends, with many nodes near one place: edges of all lengths.

    Some are shorter than the tube.
    """
    ends = network.points[[network.source, network.target]]
    inside = risk_map.to_world(rng.uniform(0.05, 0.95, (40, 2)) * risk_map.size)
    near = inside[0] + np.exp(rng.uniform(-3.0, 1.0, (60, 1))) * rng.normal(size=(60, 2))
    uv = risk_map.to_map_axes(np.concatenate((ends, inside, near)))
    uv = uv[((uv > 0.0) & (uv < risk_map.size)).all(axis=1)]
    field = ObstacleField(risk_map, options.clear_of_edge)
    uv = uv[field.clear_points(uv, options.clearance)]
    edges = neighbours(uv)
    edges = edges[field.clear_segments(uv[edges[:, 0]], uv[edges[:, 1]], options.clearance)]
    edges = np.concatenate((edges, edges[:, ::-1]))
    edges = edges[(edges[:, 0] != 1) & (edges[:, 1] != 0)]
    return Network(risk_map.to_world(uv), np.r_[0.0, 0.0, np.ones(len(uv) - 2)],
                   np.unique(edges, axis=0), 0, 1)


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
            if rng.random() < 0.3:
                network = graded(network, risk_map, options, rng)
        except (StartBlocked, GoalBlocked, NoRoute):
            continue
        route = some_route(network, seed)
        if not len(route):
            continue
        tube = (None, None, 0.05, 0.3, 1.0)[rng.integers(5)]
        reach = 0.0 if tube is None else tube + (-tube, 0.5, 2.0, 8.0)[rng.integers(4)]
        secured = SecuredArea(ends, rng.uniform(0.0, 4.0, 2))
        corridors = make_corridors(network, risk_map, clearance, tube, clear_of_edge, reach=reach,
                                   secured=secured)
        return corridors, route, risk_map, clearance, tube, clear_of_edge


# A limited number of drives, which the tests of a file share.
drives = st.integers(0, 50 * HUNT).map(drive)


def excess(path, drawn, tube, reach, secured_area):
    """How far beyond ``reach`` of the drawn route (L, 2) an ambush may be that meets the path
    (K, 2) within ``reach`` less the tube [m].

    Parts in the secured area meet nobody; for the route, this area is smaller by the tube.
    """
    centres, radii = secured_area
    angle = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
    around = np.stack((np.cos(angle), np.sin(angle)), axis=1) * (reach - tube)
    steps = [np.linspace(a, b, 2 + int(np.hypot(*(b - a)) / STEP)) for a, b in pairwise(drawn)]
    points = np.concatenate(steps)

    def within(points, more):
        away = np.linalg.norm(points[:, None] - centres, axis=2)
        return (away < radii + more).any(axis=1)

    path = path[~within(path, tube + 1e-9)]
    if not len(path):
        return -np.inf
    places = (path[:, None] + np.concatenate((around, 0.5 * around))).reshape(-1, 2)
    return cKDTree(points[~within(points, -STEP)]).query(places)[0].max() - reach


def length_of(line):
    return np.hypot(*np.diff(line, axis=0).T).sum()


def between(a, b):
    """Differences of angles in [-pi, pi)."""
    return (a - b + np.pi) % (2 * np.pi) - np.pi


def dense(line, step):
    """Points at most ``step`` apart along a polyline (K, 2)."""
    gone = np.append(0.0, np.cumsum(np.hypot(*np.diff(line, axis=0).T)))
    places = np.union1d(gone, np.arange(0.0, gone[-1], step))
    return np.stack([np.interp(places, gone, xy) for xy in line.T], axis=1)


def check_path(poses, corridors, route, field, clearance, tube):
    """A path is clear, turns by at most 20 degrees, and is as near to its route as promised."""
    uv, drawn = to_map_axes(corridors.origin, poses[:, :2]), corridors.uv[route]
    assert field.clear_segments(uv[:-1], uv[1:], clearance).all()
    turned = np.abs(between(poses[1:, 2], poses[:-1, 2]))
    assert turned.max(initial=0.0) <= np.radians(20) + 1e-6
    if corridors.reach > 0.0:
        assert excess(dense(uv, 0.04), drawn, tube, corridors.reach, corridors.secured) <= STEP
    elif tube is not None:
        assert distance_to(dense(uv, 0.01), drawn).max() <= tube + 1e-9


def distance_to(points, line):
    """Distance (K,) of points from a polyline (L, 2)."""
    line = line[np.append(np.hypot(*np.diff(line, axis=0).T) > 0.0, True)]
    a, along = line[:-1], np.diff(line, axis=0)
    t = ((points[:, None] - a) * along).sum(axis=2) / (along**2).sum(axis=1)
    foot = a + np.clip(t, 0.0, 1.0)[..., None] * along
    return np.linalg.norm(points[:, None] - foot, axis=2).min(axis=1)
