# SPDX-License-Identifier: Apache-2.0
"""Corridors: as wide as obstacles allow, clear of new ones, and from and to moved ends."""

import numpy as np
from drive_samples import check_path, drives, length_of
from games import examples
from hypothesis import assume, given
from hypothesis import strategies as st

from ambush_planner import RiskMap
from ambush_planner.maps.obstacles import ObstacleField
from ambush_planner.maps.risk_map import to_world
from ambush_planner.network.shortest_paths import distances_from, shortest_path
from ambush_planner.routes.corridor_update import add_obstacles, move_end
from ambush_planner.routes.corridors import make_corridors
from ambush_planner.routes.driven_path import driven_path


def with_obstacles(risk_map, cells):
    obstacles = risk_map.obstacles.copy()
    obstacles[tuple(np.array(cells).T)] = True
    return RiskMap(risk_map.alpha, obstacles, risk_map.resolution, risk_map.origin)


def a_route_left(network, lost, seed):
    weights = 0.05 + np.random.default_rng(seed).random(len(network.edges))
    kept = np.flatnonzero(~lost)
    graph = network.edges[kept], weights[kept], len(network.points), network.source
    assume(np.isfinite(distances_from(*graph)[network.target]))
    return shortest_path(*graph, network.target)


@examples(25)
@given(drives, st.data())
def test_paths_keep_clear_of_new_obstacles(drive, data):
    corridors, _, risk_map, clearance, tube, clear_of_edge = drive
    rows, columns = risk_map.obstacles.shape
    cell = st.tuples(st.integers(0, rows - 1), st.integers(0, columns - 1))
    newest = with_obstacles(risk_map, data.draw(st.lists(cell, min_size=1, max_size=4)))
    new = np.argwhere(newest.obstacles & ~risk_map.obstacles)
    assume(len(new))
    centres = (new[:, ::-1] + 0.5) * risk_map.resolution
    field, ends = ObstacleField(newest, clear_of_edge), corridors.uv[corridors.network.edges]
    lost = ~field.clear_segments(ends[:, 0], ends[:, 1], clearance)
    route = a_route_left(corridors.network, lost, data.draw(st.integers(0, 99)))
    far = add_obstacles(corridors, np.array([[1e4, 1e4]]), clearance, risk_map.resolution)
    np.testing.assert_array_equal(far.widths, corridors.widths)
    refitted = add_obstacles(corridors, centres, clearance, risk_map.resolution)
    check_path(driven_path(refitted, route, 0.2), refitted, route, field, clearance, tube)
    # Nothing is any wider, and nothing narrower than measured on the whole new map.
    whole = make_corridors(corridors.network, newest, clearance, tube, clear_of_edge,
                           reach=corridors.reach)
    before, now, full = (
        {tuple(link): widths for link, *widths in zip(
            each.links.tolist(), *each.widths.T, each.radii, strict=True)}
        for each in (corridors, refitted, whole)
    )
    links = corridors.uv[corridors.links]
    clear = field.clear_segments(links[:, 0], links[:, 1], clearance)
    for link in map(tuple, corridors.links[clear].tolist()):
        widths = now[link]
        for width, once, again in zip(widths, before[link], full.get(link, (0, 0, 0)), strict=True):
            assert np.all(width <= once) and np.all(width >= np.asarray(again) - 1e-9)


@examples(25)
@given(drives, st.floats(0.0, 0.5), st.floats(0.0, 6.3), st.booleans())
def test_paths_from_and_to_a_moved_end(drive, far, angle, at_start):
    corridors, route, risk_map, clearance, tube, clear_of_edge = drive
    network = corridors.network
    node = network.source if at_start else network.target
    place = corridors.uv[node] + far * np.array([np.cos(angle), np.sin(angle)])
    field = ObstacleField(risk_map, clear_of_edge)
    at = (network.tails == node) | (network.heads == node)
    others = corridors.uv[np.setdiff1d(network.edges[at], [node])]
    assume(np.hypot(*(others - place).T).min() > 1e-3)
    assume(field.clear_segments(np.broadcast_to(place, others.shape), others, clearance).all())
    where = tuple(to_world(corridors.origin, place).tolist())
    moved = move_end(
        corridors, node, where, risk_map, np.zeros(2), clearance, clear_of_edge
    )
    ends = [tuple(network.points[k].tolist()) for k in (network.source, network.target)]
    ends[0 if at_start else 1] = where
    poses = driven_path(moved, route, 0.2, ends=tuple(ends))
    assert [*map(tuple, poses[[0, -1], :2].tolist())] == ends
    check_path(poses, moved, route, field, clearance, tube)
    # At most 5 % longer than the straight line to the next node and the drawn route from there:
    # where a turn would be tight, the path swings wider.
    assert length_of(poses[:, :2]) <= 1.05 * length_of(moved.uv[route])
