# SPDX-License-Identifier: Apache-2.0
"""Way points on roads: junctions by hand, and laws on a town; labels that cover nothing."""

from itertools import pairwise

import numpy as np
import pytest
from games import examples
from hypothesis import given
from hypothesis import strategies as st

from ambush_planner import GameOptions, PlanningOptions, RiskMap, plan_trip
from ambush_planner.labels import Labels
from ambush_planner.maps.road_file import RoadGraph
from ambush_planner.maps.road_tags import ROUNDABOUT
from ambush_planner.network.construction import NetworkOptions
from ambush_planner.routes.legs import distances_along
from ambush_planner.routes.way_points import MAX_ROWS, way_points

NONE = np.empty((0, 2))


def roads(*lines, one_way=()):
    """Roads of (name, points); the pieces of names in ``one_way`` lead along the line only."""
    points, pairs, speeds, names, name = [], [], [], [], []
    for label, line in lines:
        names.append(label)
        for a, b in pairwise(line):
            points += [each for each in (a, b) if each not in points]
            ends = [points.index(each) for each in (a, b)]
            there = (1.0, 0.0 if label in one_way else 1.0)
            speeds.append(there if ends[0] < ends[1] else there[::-1])
            pairs.append(sorted(ends))
            name.append(len(names) - 1)
    return RoadGraph(np.array(points, float), np.array(pairs), np.array(speeds),
                     names=tuple(names), name=np.array(name))


def told(graph, *line, stops=NONE):
    """The rows of a route's driver: number of metres and text, at each way point."""
    line = np.array(line, float)
    names = ['start', *(f'stop {k + 1}' for k in range(len(stops))), 'goal']
    return [(round(each.distance), each.label)
            for each in way_points(line, names, np.array(stops).reshape(-1, 2), line, graph)]


CROSS = roads(('Main', [(0, 0), (50, 10), (100, 0), (200, 0), (300, 80)]),
              ('Hill', [(100, -100), (100, 0), (100, 100)]))
FORK = roads(('Main', [(0, 0), (100, 0), (200, 30)]), ('Mill', [(100, 0), (200, -30)]))


@pytest.mark.parametrize(('graph', 'line', 'rows'), [
    # A bend is no way point, a junction is one, also where the route goes straight on.
    (CROSS, [(0, 0), (50, 10), (100, 0), (200, 0), (300, 80)],
     [(0, 'start, east: Main'), (102, 'straight on: Main'), (330, 'goal')]),
    (CROSS, [(0, 0), (50, 10), (100, 0), (100, 60), (100, 100)],
     [(0, 'start, east: Main'), (102, 'left: Hill'), (202, 'goal')]),
    (CROSS, [(200, 0), (150, 0), (100, 0), (100, 100)],
     [(0, 'start, west: Main'), (100, 'right: Hill'), (200, 'goal')]),
    (FORK, [(0, 0), (100, 0), (200, 30)],
     [(0, 'start, east: Main'), (100, 'keep left: Main'), (204, 'goal')]),
    (FORK, [(200, -30), (100, 0), (200, 30)],
     [(0, 'start, west: Mill'), (104, 'sharp right: Main'), (209, 'goal')]),
    # Start and goal 20 m beside the road; the route joins and leaves it between its vertices.
    (CROSS, [(150, 20), (150, 0), (100, 0), (100, 50), (80, 50)],
     [(0, 'start, south'), (20, 'right: Main'), (70, 'right: Hill'), (120, 'left'),
      (140, 'goal')]),
])
def test_the_driver_is_told_every_turn(graph, line, rows):
    assert told(graph, *line) == rows


@pytest.mark.parametrize(('leave', 'text'), [
    ('north', 'roundabout, 2nd exit: North'), ('east', 'roundabout, 1st exit: East'),
    ('west', 'roundabout, 3rd exit: West')])
def test_a_roundabout_is_one_way_point_with_the_number_of_its_exit(leave, text):
    """Anticlockwise, entered from the south."""
    circle = {'south': (0, -20), 'east': (20, 0), 'north': (0, 20), 'west': (-20, 0)}
    graph = roads((ROUNDABOUT, [*circle.values(), circle['south']]),
                  *((side.title(), [xy, (10 * xy[0], 10 * xy[1])]) for side, xy in circle.items()),
                  one_way=(ROUNDABOUT,))
    ring = [*circle.values()][:[*circle].index(leave) + 1]
    x, y = circle[leave]
    rows = told(graph, (0, -200), *ring, (10 * x, 10 * y))
    assert [label for _, label in rows] == ['start, north: South', text, 'goal']


def test_a_stop_is_a_way_point_and_the_convoy_may_turn_round_there():
    rows = told(CROSS, (0, 0), (50, 10), (100, 0), (100, 100), (100, 0), (200, 0),
                stops=[(100, 100)])
    assert rows == [(0, 'start, east: Main'), (102, 'left: Hill'),
                    (202, 'stop 1, turn round: Hill'), (302, 'left: Main'), (402, 'goal')]


def test_of_too_many_junctions_those_without_a_turn_are_counted():
    """A main road with many side roads; at the end of it, the route turns."""
    many = MAX_ROWS + 5
    side = [(f'Side {k}', [(100 * k, 0), (100 * k, 50)]) for k in range(1, many)]
    graph = roads(('Main', [(100 * k, 0) for k in range(many + 1)]), *side,
                  ('End', [(100 * many, -50), (100 * many, 0), (100 * many, 50)]))
    line = [*((100 * k, 0) for k in range(many + 1)), (100 * many, 50)]
    assert told(graph, *line) == [
        (0, f'start, east: Main, then pass {many - 1}'), (100 * many, 'left: End'),
        (100 * many + 50, 'goal')]
    assert len(told(graph, *line[:MAX_ROWS - 1])) == MAX_ROWS - 1


def test_every_turn_of_drawn_routes_is_on_the_card():
    """A grid of bent streets: wherever the way to go on is not the straightest, there is a row."""
    rng = np.random.default_rng(2)
    place = 100.0 * np.stack(np.mgrid[0:7, 0:7], axis=-1) + rng.uniform(-20, 20, (7, 7, 2))
    streets = [[tuple(map(float, each)) for each in line]
               for line in (*place, *place.transpose(1, 0, 2))]
    graph = roads(*((f'R{k}', line) for k, line in enumerate(streets)))
    ground = RiskMap(np.ones((80, 80)), np.zeros((80, 80), bool), 10.0, (-60.0, -60.0, 0.0))
    start, goal = streets[0][0], streets[6][6]
    plan = plan_trip(ground, start, goal, PlanningOptions(
        network=NetworkOptions(method='graph', graph=graph, spacing=40.0),
        game=GameOptions(ambush_radius=30.0, secured_radius=100.0)))
    junctions = {tuple(each) for line in streets[1:6] for each in line[1:-1]}
    rng = np.random.default_rng(1)
    for nodes in plan.strategy.sample_routes(20, rng):
        line = plan.network.points[nodes]
        rows = way_points(line, ('start', 'goal'), NONE, line, graph)
        distances = [each.distance for each in rows]
        assert distances == sorted(distances) and distances[-1] == pytest.approx(
            distances_along(line)[-1])
        at = {tuple(each.xy): each for each in rows}
        crossed = [k for k in range(1, len(line) - 1) if tuple(line[k]) in junctions]
        assert {tuple(line[k]) for k in crossed} <= set(at)
        for k in crossed:
            ahead, behind = line[k + 1] - line[k], line[k] - line[k - 1]
            turn = np.degrees(np.arctan2(behind[0] * ahead[1] - behind[1] * ahead[0],
                                         behind @ ahead))
            side = 'left' if turn > 0 else 'right'
            assert (side in at[tuple(line[k])].action) or abs(turn) < 30.0


@examples(25)
@given(st.lists(st.tuples(*4 * [st.floats(0.05, 0.95)]), min_size=1, max_size=12),
       st.integers(0, 2**32 - 1))
def test_labels_cover_neither_each_other_nor_what_is_taken(places, seed):
    rng, frame = np.random.default_rng(seed), np.array([(0.0, 0.0), (1.0, 1.0)])
    taken = np.array([(x - 0.01, y - 0.01, x + 0.01, y + 0.01) for x, y, *_ in places])
    labels, boxes = Labels(frame, rng.uniform(size=(50, 2)), taken), [*taken]
    for x, y, u, v in places:
        size = np.array((0.02 + 0.1 * u, 0.03))
        spot = labels.place(np.array((x, y)), size, 0.012)
        boxes.append(np.concatenate((spot - size / 2, spot + size / 2)))
        on = labels.choose(np.array([(u, v), (v, u)]), size)
        if on is not None:
            boxes.append(np.concatenate((on - size / 2, on + size / 2)))
    boxes = np.array(boxes)
    assert (boxes[len(taken):, :2] >= 0.0).all() and (boxes[len(taken):, 2:] <= 1.0).all()
    for k, (left, low, right, high) in enumerate(boxes[len(taken):], start=len(taken)):
        others = np.delete(boxes, k, axis=0)
        assert not ((others[:, 0] < right) & (others[:, 2] > left)
                    & (others[:, 1] < high) & (others[:, 3] > low)).any()
