# SPDX-License-Identifier: Apache-2.0
"""Plans and maps that the node no longer needs are freed at once.

Objects that refer to each other are freed by the next full garbage collection only, of which there
may be one a minute; a plan takes megabytes.
"""

import gc
from weakref import ref

import pytest
from robots import ROBOT
from ros_harness import FLAT, pose, stage, wait_until
from test_one_draw_a_trip import Drive

from ambush_planner.ros import plan_cache


@pytest.fixture
def no_collection():
    gc.collect()
    gc.disable()
    yield
    gc.enable()


def test_trips_keep_neither_plans_nor_maps(monkeypatch, no_collection):
    monkeypatch.setattr(plan_cache, '_MAX_PLANS', 1)
    with stage(parameters=ROBOT) as running:
        maps, values = [], FLAT.copy()
        for number in range(5):
            values[0, 0] = number
            robot = Drive(running, f'robot_{number}')
            robot.robot.is_at(1.5, 2.5 + number)
            running.know(values)
            goal = pose(8.5, 2.5 + number)
            robot.ask('new', goal)
            maps.append(ref(running.planner._dispatcher.inputs.map))
        wait_until(lambda: all(each() is None for each in maps[:-1]), 'the maps being freed')
        assert len(running.planner._dispatcher._departures.trips._trips) == 5
        robot.ask('continued', goal)
