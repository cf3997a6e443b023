# SPDX-License-Identifier: Apache-2.0
"""Driven paths: within the corridors, clear of obstacles, short and smooth; their taut strings."""

import itertools

import numpy as np
import pytest
from drive_samples import between, check_path, dense, distance_to, drives, length_of, some_route
from games import examples
from hypothesis import given
from hypothesis import strategies as st

from ambush_planner import NetworkOptions, RiskMap, build_network
from ambush_planner.maps.obstacles import ObstacleField
from ambush_planner.network.shortest_paths import shortest_path
from ambush_planner.routes.corridors import make_corridors
from ambush_planner.routes.driven_path import (
    MAX_MARGIN,
    driven_path,
    driven_paths,
    tight_turns,
    turn_radii,
)
from ambush_planner.routes.taut_string import portals_along


@examples(25)
@given(drives)
def test_the_path_stays_clear_in_its_tube_and_short(drive):
    corridors, route, risk_map, clearance, tube, clear_of_edge = drive
    network = corridors.network
    poses = driven_path(corridors, route, 0.2)
    check_path(poses, corridors, route, ObstacleField(risk_map, clear_of_edge), clearance, tube)
    uv = risk_map.to_map_axes(dense(poses[:, :2], 0.01))
    assert not risk_map.obstacles[risk_map.cells(uv)].any()
    if tube is None:
        others = np.delete(network.points, route, axis=0)
        if len(others):
            assert distance_to(others, poses[:, :2]).min() > 1e-3
    # Where a portal is all on one side of the node, the path keeps a margin from the node.
    detour = MAX_MARGIN * portals_along(corridors, [route]).width
    drawn = length_of(network.points[route])
    assert length_of(poses[:, :2]) <= drawn + 2 * detour.sum() + 1e-9


@examples(25)
@given(drives, st.sampled_from((0.03, 0.2, 1.0, 7.0)))
def test_poses_follow_one_another_smoothly_from_end_to_end(drive, spacing):
    corridors, route = drive[:2]
    poses = driven_path(corridors, route, spacing)
    network = corridors.network
    assert np.array_equal(poses[[0, -1], :2], network.points[[network.source, network.target]])
    steps = np.diff(poses[:, :2], axis=0)
    length = np.hypot(*steps.T)
    assert length.max() <= spacing + 1e-9
    moving = length > 1e-6
    heading = np.arctan2(steps[:, 1], steps[:, 0])
    assert np.abs(between(heading, poses[:-1, 2]))[moving].max() <= np.radians(20) + 1e-6
    assert (poses[:, 2] >= -np.pi).all() and (poses[:, 2] <= np.pi).all()


def open_map(cells=20, yaw=0.0):
    return RiskMap(np.ones((cells, cells)), np.zeros((cells, cells), bool), 1.0, (5.0, -2.0, yaw))


def corridors_on(risk_map, start, goal, spacing=1.0, **options):
    ends = risk_map.to_world(np.array([start, goal], float))
    network = build_network(risk_map, *ends,
                            NetworkOptions(method='uniform_delaunay', spacing=spacing))
    return make_corridors(network, risk_map, **options)


def test_a_staircase_becomes_a_straight_line():
    corridors = corridors_on(open_map(), (1.2, 1.3), (18.7, 18.4))
    network = corridors.network
    route = shortest_path(
        network.edges, network.lengths, len(network.points), network.source, network.target
    )
    poses = driven_path(corridors, route, 0.2)
    straight = np.hypot(*(network.points[network.target] - network.points[network.source]))
    drawn, driven = length_of(network.points[route]), length_of(poses[:, :2])
    assert drawn > 1.02 * straight and driven < 1.01 * straight


def test_a_tube_of_zero_gives_the_drawn_route():
    corridors = corridors_on(open_map(), (1.2, 1.3), (18.7, 18.4), tube=0.0)
    route = some_route(corridors.network, 3)
    poses = driven_path(corridors, route, 0.5)
    drawn = corridors.network.points[route]
    for point in drawn:
        assert np.hypot(*(poses[:, :2] - point).T).min() < 1e-9
    assert distance_to(poses[:, :2], drawn).max() < 1e-9


@pytest.mark.parametrize('radius', [0.2, 1.0])
def test_turns_have_the_requested_radius_if_the_tube_allows_it(radius):
    """A right angle between two legs of 10 m in a tube of 2 m allows turns of more than 1 m."""
    corridors = corridors_on(open_map(), (2.5, 2.5), (17.5, 17.5), spacing=10.0, tube=2.0)
    network = corridors.network
    corner = int(np.argmax(np.abs(between_line(network))[:-2]))
    edges = {tuple(edge) for edge in network.edges.tolist()}
    route = np.array([network.source, corner, network.target])
    assert all(pair in edges for pair in itertools.pairwise(route.tolist()))
    poses = driven_path(corridors, route, 0.02, radius)
    bend = np.abs(between(poses[1:, 2], poses[:-1, 2]))
    step = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    tightest = (step[bend > 1e-6] / bend[bend > 1e-6]).min()
    assert tightest > 0.98 * radius
    assert turn_radii(poses).min() == pytest.approx(tightest, rel=0.01)
    assert tight_turns(poses, radius) == 0 and tight_turns(poses, 20.0) > 0


def between_line(network):
    start, goal = network.points[[network.source, network.target]]
    along = goal - start
    return (network.points - start) @ (-along[1], along[0])


@examples(10)
@given(drives, st.sampled_from((0.0, 0.6)))
def test_paths_made_together_match_single_ones(drive, radius):
    corridors, route = drive[:2]
    routes = [route, *(some_route(corridors.network, seed) for seed in range(100, 104))]
    paths = driven_paths(corridors, routes, 0.3, radius)
    for path, route in zip(paths, routes, strict=True):
        np.testing.assert_allclose(path, driven_path(corridors, route, 0.3, radius), atol=1e-12)
