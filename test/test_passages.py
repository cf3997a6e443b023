# SPDX-License-Identifier: Apache-2.0
"""Doors and corridors narrower than the node spacing, and maps divided by obstacles."""

import itertools

import numpy as np
import pytest

from ambush_planner import NetworkOptions, NoRoute, RiskMap, build_network
from ambush_planner.maps import risk_map as risk_maps
from ambush_planner.maps.obstacles import ObstacleField
from ambush_planner.network.passages import widest_cell_path
from ambush_planner.network.shortest_paths import reachable_from

CELLS, SPACING = 24, 6.0
DELAUNAY = ('uniform_delaunay', 'lattice_delaunay', 'random_delaunay')


def walled(row: int, column: int, thickness: int, door: int = 1) -> RiskMap:
    """A wall across the map, with a door ``door`` cells wide."""
    obstacles = np.zeros((CELLS, CELLS), bool)
    obstacles[:, column : column + thickness] = True
    obstacles[row : row + door] = False
    return RiskMap(np.ones((CELLS, CELLS)), obstacles, 1.0)


def crossing(risk_map, method='uniform_delaunay', **options):
    """A network from left to right, and that it leads through on free ground."""
    ends = (1.3, 12.2), (22.4, 11.7)
    network = build_network(risk_map, *ends,
                            NetworkOptions(method=method, spacing=SPACING, **options))
    reached = reachable_from(network.edges, len(network.points), network.source)
    assert reached[network.target]
    a, b = network.points[network.tails], network.points[network.heads]
    field = ObstacleField(risk_map, clear_of_edge=False)
    assert field.clear_segments(a, b, max(options.get('clearance', 0.0) - 1e-9, 0.0)).all()
    return network


@pytest.mark.parametrize('method', DELAUNAY)
@pytest.mark.parametrize('thickness', [1, 5])
def test_finds_a_door_of_one_cell_anywhere(method, thickness):
    for row in range(6, 13, 2):
        for column in range(7 + row % 4 // 2, 14, 2):  # as on a chessboard
            crossing(walled(row, column, thickness), method)


def test_finds_a_corridor_slightly_wider_than_the_clearance():
    for row, column in itertools.product(range(6, 13), (7, 11)):
        crossing(walled(row, column, 5, 3), clearance=1.49, clear_of_edge=False)


def test_finds_a_bent_corridor():
    obstacles = np.ones((CELLS, CELLS), bool)
    obstacles[:, :6] = obstacles[:, -6:] = False
    obstacles[3, 5:12] = obstacles[3:20, 12] = obstacles[19, 12:19] = False
    crossing(RiskMap(np.ones(obstacles.shape), obstacles, 1.0))


def test_a_grid_suggests_a_spacing_for_the_door():
    risk_map = walled(7, 9, 1)
    with pytest.raises(NoRoute, match=r'at a spacing of 6 m; the map has one, .* of 0\.5 m'):
        build_network(risk_map, (1.3, 12.2), (22.4, 11.7),
                      NetworkOptions(method='uniform_grid8', spacing=6.0))
    build_network(risk_map, (1.3, 12.2), (22.4, 11.7),
                  NetworkOptions(method='uniform_grid8', spacing=0.5))


@pytest.mark.parametrize('method', [*DELAUNAY, 'uniform_grid8'])
def test_reports_a_map_divided_by_obstacles(method):
    with pytest.raises(NoRoute, match='obstacles separate them; a spacing other than 6 m'):
        crossing(walled(0, 9, 2, 0), method)
    with pytest.raises(NoRoute, match=r'separate them at a clearance of 1\.5 m'):
        crossing(walled(7, 9, 2, 3), method, clearance=1.5, clear_of_edge=False)


def test_free_cells_that_meet_at_a_corner_are_not_connected():
    obstacles = np.zeros((CELLS, CELLS), bool)
    obstacles[:12, 11] = obstacles[12:, 12] = True
    with pytest.raises(NoRoute, match='obstacles separate them'):
        crossing(RiskMap(np.ones(obstacles.shape), obstacles, 1.0))


@pytest.mark.parametrize('block', [3, 5])
def test_blocks_of_cells_lead_where_cells_lead(block, monkeypatch):
    rng, ends, found = np.random.default_rng(block), np.array([(1.3, 12.2), (22.4, 11.7)]), []
    for clearance in (0.0, 0.2, 0.8) * 20:
        obstacles = rng.random((CELLS, CELLS)) < rng.choice([0.1, 0.2, 0.4])
        obstacles[11:13, :3] = obstacles[11:13, -3:] = obstacles[:, 9:12] = False
        maps = [RiskMap(np.ones(obstacles.shape), obstacles, 1.0) for _ in range(2)]
        field = ObstacleField(maps[0])
        one, _ = widest_cell_path(maps[0], field, ends, clearance)
        with monkeypatch.context() as patch:
            patch.setattr(risk_maps, '_MAX_CELLS', obstacles.size / block**2)
            assert maps[1].obstacle_blocks[1] == block
            other, margin = widest_cell_path(maps[1], field, ends, clearance)
        assert (len(one) > 0) == (len(other) > 0)
        found.append(len(other) > 0)
        if clearance == 0.0:
            assert field.clear_segments(other[:-1], other[1:], 0.0).all()
        steps = np.abs(np.diff(other, axis=0)).max(axis=1) if len(other) else np.zeros(1)
        assert steps.max() <= block and (margin > -clearance).all()
    assert 5 < sum(found) < 55
