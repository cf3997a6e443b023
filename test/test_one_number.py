# SPDX-License-Identifier: Apache-2.0
"""The same question gives the same number at every door."""

import json
from concurrent.futures import ThreadPoolExecutor

import pytest
from commands import ROOT, run_here
from games import plain_options

from ambush_planner import GameOptions, PlanningOptions, Problem, plan_trip, solve_many
from ambush_planner.commands import frontier as frontier_command
from ambush_planner.commands import plan as plan_command
from ambush_planner.maps.map_file import read_map
from ambush_planner.maps.occupancy import OccupancyOptions
from ambush_planner.maps.risk_map_file import read_risk_map
from ambush_planner.planning.plan import PlanRequest
from ambush_planner.planning.trip import plan_from_request
from ambush_planner.recordings.attachments import strategy_file, strategy_from_file

YARD = ROOT / 'docs/yard.yaml'
START, GOAL = (4.0, 20.0), (56.0, 20.0)
OPTIONS = PlanningOptions(network=plain_options(target_nodes=120),
                          game=GameOptions(ambush_radius=2.0))
SET = ('--set', 'network.target_nodes=120', 'network.refine=0', 'game.ambush_radius=2')


@pytest.fixture(scope='module')
def numbers():
    """Value and lower bound of the plan."""
    plan = plan_trip(read_risk_map(YARD), START, GOAL, OPTIONS)
    return plan.value, plan.lower_bound


def same(number):
    return pytest.approx(number, rel=1e-9)


def test_python(numbers):
    risk_map = read_risk_map(YARD)
    (row,) = plan_trip(risk_map, START, GOAL, OPTIONS).frontier([1.2], [])
    with ThreadPoolExecutor(1) as pool:
        (solved,) = solve_many([Problem(risk_map, START, GOAL, OPTIONS)], pool)
    read = strategy_from_file(strategy_file(solved.answer.trip), OPTIONS.game)
    for each in (row, solved.answer, read):
        assert (each.value, each.lower_bound) == same(numbers)


def test_the_request_of_a_node(numbers):
    request = PlanRequest(read_map(YARD), OccupancyOptions(), START, GOAL, 0.0, OPTIONS)
    strategy = plan_from_request(request).strategy
    assert (strategy.value, strategy.lower_bound) == same(numbers)


def test_commands(numbers, tmp_path):
    ends = ('--start', *START, '--goal', *GOAL)
    done = run_here(plan_command, YARD, *ends, '-o', tmp_path / 'routes.csv', '--json', *SET)
    planned = json.loads(done.out)
    assert (planned['value'], planned['lower_bound']) == same(numbers)
    done = run_here(frontier_command, YARD, *ends, '-o', tmp_path / 'frontier.csv', '--json',
                    '--detours', 1.2, '--slacks', 0.01, *SET)
    for row in json.loads(done.out)['rows']:
        assert (row['value'], row['lower_bound']) == same(numbers)
