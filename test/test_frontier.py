# SPDX-License-Identifier: Apache-2.0
"""The frontier of budgets: laws of its rows, and the command."""

import csv
from dataclasses import fields
from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from commands import run_here
from games import examples, random_map, terrain_networks
from hypothesis import given

from ambush_planner import GameOptions, InvalidOption, NetworkOptions, build_network, frontier
from ambush_planner.commands import frontier as command
from ambush_planner.maps.map_file import write_map
from ambush_planner.maps.occupancy import OccupancyMap
from ambush_planner.operations.frontier import FrontierRow


@examples(4)
@given(terrain_networks)
def test_each_row_is_certified_and_looser_budgets_cost_no_value(network):
    rows = frontier(network, detours=(1.3, 1.0, 1.1), slacks=(0.0, 0.3, 0.05))
    assert [row.max_detour for row in rows] == [1.3, 1.0, 1.1] + [1.2] * 3
    assert [row.risk_slack for row in rows] == [0.01] * 3 + [0.0, 0.3, 0.05]
    for row in rows:
        assert not row.error
        assert row.lower_bound <= row.value * (1 + 1e-9)
        assert row.value <= row.lower_bound * (1 + row.risk_slack + 1e-5)
        assert row.expected_length <= row.max_detour * row.shortest_length * (1 + 1e-6)
    by_detour = sorted(rows[:3], key=lambda row: row.max_detour)
    bounds = [row.lower_bound for row in by_detour]
    assert all(loose <= tight * (1 + 1e-5) for tight, loose in pairwise(bounds))


@pytest.fixture(scope='module')
def network():
    return build_network(random_map(3), (4.5, -0.5), (13.5, 8.5), NetworkOptions(spacing=1.0))


def test_infeasible_budget_has_a_row_with_the_reason(network):
    threshold = np.quantile(network.alpha, 0.75)
    game = GameOptions(alpha_threshold=float(threshold))
    rows = frontier(network, game, (1.0, 3.0), ())
    tight, loose = rows
    assert 'raise max_detour' in tight.error and np.isnan(tight.value)
    assert not loose.error and loose.value > 0.0


def test_bad_budgets_are_refused_before_the_first_solve(network):
    reported = []
    with pytest.raises(InvalidOption, match='max_detour'):
        frontier(network, detours=(1.1, 0.5), on_row=reported.append)
    assert not reported


run = partial(run_here, command)
ENDS = ('--start', 15, 15, '--goal', 185, 185)


@pytest.fixture
def map_file(tmp_path):
    values = np.random.default_rng(0).integers(0, 90, (20, 20)).astype(np.int8)
    values[8:12, 8:12] = 100
    write_map(tmp_path / 'map.yaml', OccupancyMap(values, 10.0))
    return tmp_path / 'map.yaml'


def test_command_writes_a_table(map_file, tmp_path):
    done = run(
        map_file, *ENDS, '-o', tmp_path / 'f.csv', '--detours', 1.1, 1.4,
        '--slacks', 0.2,
        '--set', 'network.spacing=15', 'network.refine=0', 'game.ambush_radius=20',
    )
    assert done.code == 0, done.err
    with (tmp_path / 'f.csv').open(newline='') as file:
        rows = list(csv.DictReader(file))
    assert [*rows[0]] == [each.name for each in fields(FrontierRow)]
    assert [(row['swept'], row['max_detour'], row['risk_slack']) for row in rows] == [
        ('max_detour', '1.1', '0.01'), ('max_detour', '1.4', '0.01'), ('risk_slack', '1.2', '0.2'),
    ]
    assert done.out.count('\n') == 6 and 'f.csv' in done.out
