# SPDX-License-Identifier: Apache-2.0
"""Options of game and route change the node's answers as geometry says."""

from dataclasses import replace

import pytest
from nav_msgs.srv import GetPlan
from ros_harness import GOAL, START, stage

from ambush_planner import GameOptions, PlanningOptions
from ambush_planner.planning import trip
from ambush_planner.planning.options import tube as default_tube
from ambush_planner.planning.solving import Ground
from ambush_planner.planning.trip import plan_from_request
from ambush_planner.worker.process import WorkerProcess


class ShortOfTime(Ground):
    """Its solves end at the time limit, with a strategy that is up to 5 % over the best."""

    def solve(self, networks, end, warm=None):
        rough = replace(self.options.strategy, risk_slack=0.05)
        found = Ground(self.risk_map, replace(self.options, strategy=rough), self.cells)
        return replace(found.solve(networks, end, warm), reason='time')


@pytest.mark.parametrize('max_gap', [0.1, 0.01])
def test_what_was_reached_in_time_departs_with_a_warning_or_not_at_all(monkeypatch, max_gap):
    monkeypatch.setattr(WorkerProcess, 'solve',
                        lambda _, request: plan_from_request(request))
    monkeypatch.setattr(trip, 'Ground', ShortOfTime)
    with stage(parameters={'strategy.max_gap': max_gap}) as running:
        client = running.give()
        path = client.call('get_plan', GetPlan.Request(start=START, goal=GOAL)).plan
        if max_gap == 0.1:
            assert path.poses
            report = client.diagnostics(departures='1', code='NONE', level=b'\1')
            assert 'max_planning_time' in report['message']
            gap, value = float(report['gap']), float(report['value'])
            assert 0.01 * value < gap < 0.06 * value
        else:
            assert not path.poses
            report = client.diagnostics(departures='0', code='TIMEOUT', level=b'\2')
            assert 'more than max_gap 0.01' in report['message']


@pytest.mark.parametrize(('reach', 'spacing', 'tube'), [
    (10.0, 2.0, 0.7), (10.0, 6.0, 1.0), (0.0, 2.0, None)])
def test_the_default_tube_is_small_against_the_reach_and_the_spacing(reach, spacing, tube):
    options = PlanningOptions(game=GameOptions(ambush_radius=reach))
    assert default_tube(options, spacing) == (tube and pytest.approx(tube))
