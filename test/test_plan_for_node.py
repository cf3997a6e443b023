# SPDX-License-Identifier: Apache-2.0
"""A node that starts from a plan file: it departs without a solve, and its recordings hold."""

from dataclasses import replace

import numpy as np
import pytest
from games import plain_options
from ros_harness import stage

from ambush_planner import GameOptions, InvalidOption, PlanningOptions, plan_trip
from ambush_planner.maps.occupancy import risk_from_occupancy
from ambush_planner.maps.ros_messages import path_from_ros
from ambush_planner.recordings.plan_file import plan_bytes, saved_plan
from ambush_planner.recordings.recorded_departures import recordings_in
from ambush_planner.recordings.verify import Verifier
from ambush_planner.ros.plan_cache import PlanCache
from ambush_planner.ros.plan_from_file import read_plan_for_node

START, GOAL, STOP = (3.0, 10.0), (33.0, 10.0), (12.0, 4.0)
OPTIONS = PlanningOptions(
    network=plain_options(spacing=3.0, seed=3),
    game=GameOptions(ambush_radius=2.5, held_places=[(25.0, 15.0, 2.0)]))


def ground():
    values = np.random.default_rng(0).integers(0, 60, (20, 40)).astype(np.int8)
    values[6:14, 18:22] = 100
    return risk_from_occupancy(values, 0.9)  # a resolution that single precision does not hold


@pytest.mark.parametrize('stops', [(), (STOP,)])
def test_a_node_departs_on_a_plan_file(tmp_path, monkeypatch, stops):
    plan = plan_trip(ground(), START, GOAL, OPTIONS, stops=stops)
    file = tmp_path / 'week.plan'
    file.write_bytes(plan_bytes(saved_plan(plan)))
    solved = []
    monkeypatch.setattr(PlanCache, 'solve', lambda *_, **__: solved.append(1))
    with stage(tmp_path / 'runs', {'plan': str(file)}) as running:
        client = running.client
        report = client.diagnostics(state='ready')
        assert float(report['value']) == pytest.approx(plan.value)
        for number in range(1, 4):
            assert client.call('new_route').success
            path = path_from_ros(client.last('path', number))
            assert path[0, :2] == pytest.approx(START) and path[-1, :2] == pytest.approx(GOAL)
    assert not solved
    found = recordings_in(tmp_path / 'runs')
    assert len(found) == 3
    for each in found:
        assert Verifier().verify(each).problems == []


def test_plans_that_a_node_cannot_draw_from_are_refused(tmp_path):
    floats = plan_trip(replace(ground(), alpha=ground().alpha * np.pi), START, GOAL, OPTIONS)
    for plan, words in ((floats, 'losses an occupancy grid cannot hold'),
                        (None, 'or plan: it is damaged or not an MCAP file')):
        file = tmp_path / 'week.plan'
        file.write_bytes(plan_bytes(saved_plan(plan)) if plan else b'no plan')
        with pytest.raises(InvalidOption, match=words):
            read_plan_for_node(str(file))
