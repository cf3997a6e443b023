# SPDX-License-Identifier: Apache-2.0
"""``ambush table``: the table, its inputs, bad input."""

import csv

import numpy as np
import pytest
from commands import run_here

from ambush_planner import GameOptions, NetworkOptions, StrategyOptions, build_network, solve
from ambush_planner.commands import table
from ambush_planner.commands.inputs import options_of
from ambush_planner.errors import InvalidOption
from ambush_planner.maps.map_file import read_map, write_map
from ambush_planner.maps.occupancy import OccupancyMap, risk_from_occupancy

DEPOTS = 'name,x,y\nnorth,15,185\nsouth,15,15\n'
CUSTOMERS = 'name, x, y, remark\nmill,185,95,steep\n"the old, bridge",175,25,\nblocked,95,95,\n'


def run(folder, *options):
    return run_here(table, folder / 'depots.csv', folder / 'customers.csv', '--map',
                    folder / 'map.yaml', '-o', folder / 'table.csv', '--jobs', 1, *options)


@pytest.fixture
def folder(tmp_path):
    """Places and a map."""
    values = np.random.default_rng(0).integers(0, 90, (20, 20)).astype(np.int8)
    values[8:12, 8:12] = 100
    write_map(tmp_path / 'map.yaml', OccupancyMap(values, 10.0))
    (tmp_path / 'depots.csv').write_text(DEPOTS)
    (tmp_path / 'customers.csv').write_text(CUSTOMERS)
    return tmp_path


def test_rows_have_the_numbers_of_solve(folder):
    done = run(folder, '--set', 'network.spacing=20', 'strategy.max_detour=1.4')
    assert done.code == 1  # two pairs end in an obstacle
    assert 'table.csv: 6 pairs, 2 without a strategy' in done.out, done.err
    with (folder / 'table.csv').open(newline='') as file:
        rows = list(csv.DictReader(file))
    assert [(row['depot'], row['customer']) for row in rows] == [
        (depot, customer) for depot in ('north', 'south')
        for customer in ('mill', 'the old, bridge', 'blocked')
    ]
    assert [row['error'].partition(':')[0] for row in rows] == ['', '', 'GoalBlocked'] * 2
    risk_map = risk_from_occupancy(read_map(folder / 'map.yaml').values, 10.0)
    network = build_network(risk_map, (15, 15), (175, 25), NetworkOptions(spacing=20.0))
    strategy = solve(network, GameOptions(), StrategyOptions(max_detour=1.4))
    for name in table.NUMBERS:
        assert float(rows[4][name]) == pytest.approx(getattr(strategy, name), rel=1e-8)
    assert (folder / 'table.csv').stat().st_mode & 0o777 == 0o600


def test_bad_input_has_a_reason(folder):
    done = run(folder, '--set', 'network.spaccing=3')
    assert done.code == 2 and "no option 'network.spaccing'" in done.err
    (folder / 'map.yaml').unlink()
    done = run(folder)
    assert done.code == 3 and 'map.yaml' in done.err and 'Traceback' not in done.err


@pytest.mark.parametrize(('text', 'reason'), [
    ('name,x\na,1\n', "no column 'y'"),
    ('name,x,y\n', 'no places'),
    ('name,x,y\na,1,nan\n', 'line 2: x and y'),
    ('name,x,y\na,1,2\na,3,4\n', 'line 3: each place needs its own name'),
    ('name,x,y\na,1\n', 'line 2'),
])
def test_unusable_places_are_refused(tmp_path, text, reason):
    (tmp_path / 'p.csv').write_text(text)
    with pytest.raises(table.InvalidPlaces, match=reason):
        table.read_places(tmp_path / 'p.csv')


def test_options_have_the_names_of_parameters():
    options = options_of(['map.alpha_max=5', 'strategy.max_detour=.inf', 'network.spacing=1e1',
                            'network.method=uniform_grid8', 'network.target_nodes=99'])
    assert options.map.alpha_max == 5.0 and options.strategy.max_detour == np.inf
    assert options.network == NetworkOptions(method='uniform_grid8', spacing=10.0, target_nodes=99)
    for assignment, reason in (('network.spacing', 'network.spacing=VALUE'),
                               ('spacing=3', 'did you mean'),
                               ('network.target_nodes=2.5', 'a whole number'),
                               ('strategy.max_detour=0.5', 'max_detour')):
        with pytest.raises(InvalidOption, match=reason):
            options_of([assignment])
