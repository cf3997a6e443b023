# SPDX-License-Identifier: Apache-2.0
"""A costmap's obstacles on a risk map: the pure rule, and the node with both topics and TF."""

import math

import numpy as np
from games import examples
from hypothesis import given
from hypothesis import strategies as st
from nav_msgs.msg import OccupancyGrid
from robots import ROBOT, Robot
from ros_harness import FLAT, LATCHED, risk_grid, stage, wait_until

from ambush_planner.maps.occupancy import OccupancyMap
from ambush_planner.maps.overlay import with_obstacles_of
from ambush_planner.maps.risk_map import to_map_axes, to_world
from ambush_planner.ros import subscriptions

BOTH = {'map.costmap': True}


@examples(15)
@given(seed=st.integers(0, 2**31), scale=st.sampled_from([0.3, 0.5, 1.0, 1.7, 3.0]),
       turn=st.sampled_from([0.0, 0.3, math.pi / 2]), unknown=st.booleans())
def test_a_cell_is_an_obstacle_if_one_lies_on_it(seed, scale, turn, unknown):
    rng = np.random.default_rng(seed)
    risk = OccupancyMap(rng.integers(0, 90, (12, 15), dtype=np.int8), 0.5,
                        (*rng.uniform(-2.0, 2.0, 2), turn))
    values = np.where(rng.random((9, 11)) < 0.08, rng.choice([-1, 99, 100], (9, 11)), 98)
    other = OccupancyMap(values.astype(np.int8), 0.5 * scale, (*rng.uniform(-2.0, 2.0, 2), 0.0))
    joined = with_obstacles_of(risk, other, 99, unknown)
    kept = joined.values != 100
    assert (joined.values[kept] == risk.values[kept]).all()
    # Dense points of each risk cell, and the costmap's cells that they lie in.
    share = np.linspace(0.02, 0.98, 33)
    v, u = np.meshgrid(*(np.add.outer(np.arange(n), share).ravel() * 0.5
                         for n in risk.values.shape), indexing='ij')
    at = to_map_axes(other.origin, to_world(risk.origin, np.stack((u, v), axis=-1)))
    column, row = np.floor(at / other.resolution).astype(int).transpose(2, 0, 1)
    inside = (row >= 0) & (row < 9) & (column >= 0) & (column < 11)
    found = values[row.clip(0, 8), column.clip(0, 10)]
    hit = inside & ((found >= 99) | (unknown & (found == -1)))
    hit = hit.reshape(12, 33, 15, 33).any(axis=(1, 3))
    assert (joined.values[hit] == 100).all()
    if turn in (0.0, math.pi / 2):  # else the rectangle around the cell counts
        sure = ~hit & ~kept
        # Obstacles that only graze a cell between the points are rare.
        assert sure.mean() < 0.1


def test_the_node_waits_for_the_costmap_and_joins_it(monkeypatch):
    monkeypatch.setattr(subscriptions, '_STOPPED', 0.3)
    with stage(parameters=BOTH) as running:
        client = running.client
        client.give(risk_grid(FLAT), message='waiting for /costmap')
        wait_until(lambda: 'no costmap yet' in client.call('new_route').message, 'the reason')
        wall = np.zeros((40, 4), np.int8)
        wall[:36] = 99
        costmap = risk_grid(wall, 0.25, (4.5, 0.0, 0.0))
        costs = client.node.create_publisher(OccupancyGrid, 'costmap', LATCHED)
        costs.publish(costmap)
        client.call_until('new_route', lambda answer: answer.success)
        path = client.last('path').poses
        assert max(each.pose.position.y for each in path) > 9.0, 'around the wall'
        wait_until(lambda: 's old, so newer' in client.diagnostics()['message'], 'the age')
        elsewhere = risk_grid(wall, 0.25, (4.5, 0.0, 0.0), frame='odom')
        costs.publish(elsewhere)
        report = client.diagnostics(code='TF_ERROR')
        assert "the costmap is given in the frame 'odom'" in report['message']
        costs.publish(costmap)
        client.diagnostics(code='NONE')


def test_a_costmap_that_comes_once_is_used_when_its_transform_comes(capfd):
    with stage(parameters={**BOTH, **ROBOT}) as running:
        client, robot = running.client, Robot(running, 'odom')
        client.give(risk_grid(FLAT), message='waiting for /costmap')
        wall = np.zeros((40, 4), np.int8)
        wall[:36] = 99
        client.publish('costmap', risk_grid(wall, 0.25, (4.5, 0.0, 0.0), frame='odom'))
        client.diagnostics(code='TF_ERROR')
        client.last('/diagnostics', len(client.received['/diagnostics']) + 2)
        client.diagnostics(code='TF_ERROR')
        assert capfd.readouterr().err.count("is given in the frame 'odom'") == 1
        robot.is_at(0.0, 0.0)
        client.diagnostics(code='NONE', state='ready')
        client.call_until('new_route', lambda answer: answer.success)
        path = client.last('path').poses
        assert max(each.pose.position.y for each in path) > 9.0, 'around the wall'
        planned = client.diagnostics(stale='no')['nodes']
        # The transform moves the wall: the plan is judged, and solved again.
        robot.is_at(-2.0, 0.0)
        wait_until(lambda: client.diagnostics()['nodes'] != planned, 'another plan')


def test_every_map_without_risk_is_warned_of_as_long_as_it_is_used():
    with stage() as running:
        client = running.client
        for values, warned in ((None, False), (FLAT, True), (None, False), (FLAT + 1, True)):
            client.publish('alpha_map', risk_grid(values))
            wait_until(lambda warned=warned: warned == (
                'carries no risk' in client.diagnostics()['message']), 'the report')
        values = FLAT.copy()
        values[:, 10:] = 50
        for threshold, warned in ((100, False), (50, True), (100, False)):
            client.publish('alpha_map', risk_grid(values))
            running.use({'map.obstacle_threshold': threshold})
            wait_until(lambda warned=warned: warned == (
                'carries no risk' in client.diagnostics()['message']), 'the report')
