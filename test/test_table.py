"""``ambush_table`` as a user starts it: the table, going on after an interruption, bad input."""

import csv
import os
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from commands import run_here

from ambush_planner import GameOptions, NetworkOptions, StrategyOptions, build_network, solve
from ambush_planner.commands import table
from ambush_planner.commands.table_file import COLUMNS, BadTable, TableFile, read_places
from ambush_planner.commands.table_options import options_from
from ambush_planner.errors import InvalidOption
from ambush_planner.maps.map_file import read_map, write_map
from ambush_planner.maps.occupancy import OccupancyMap, risk_map_from_occupancy

DEPOTS = 'name,x,y\nnorth,15,185\nsouth,15,15\n'
CUSTOMERS = 'name, x, y, remark\nmill,185,95,steep\n"the old, bridge",175,25,\nblocked,95,95,\n'
OPTIONS = ('--set', 'network.spacing=20', 'strategy.max_detour=1.4')


def given(folder, *arguments):
    files = (folder / 'depots.csv', folder / 'customers.csv', '--map', folder / 'map.yaml',
             '-o', folder / 'table.csv')
    return [*map(str, files), *(arguments or (*OPTIONS, '--jobs', '1'))]


def run(folder, *arguments):
    return run_here(table, *given(folder, *arguments))


def rows_of(path):
    with path.open(newline='') as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope='module')
def first(tmp_path_factory):
    """A folder with places, map and the table, and what the command said."""
    folder = prepared(tmp_path_factory.mktemp('first'))
    return folder, run(folder)


@pytest.fixture
def folder(tmp_path):
    """Places and a map, no table yet."""
    return prepared(tmp_path)


@pytest.fixture
def made(first, tmp_path):
    """A copy of the folder with the table."""
    return shutil.copytree(first[0], tmp_path / 'made')


def prepared(tmp_path):
    values = np.random.default_rng(0).integers(0, 90, (20, 20)).astype(np.int8)
    values[8:12, 8:12] = 100
    write_map(tmp_path / 'map.yaml', OccupancyMap(values, 10.0))
    (tmp_path / 'depots.csv').write_text(DEPOTS)
    (tmp_path / 'customers.csv').write_text(CUSTOMERS)
    return tmp_path


def test_a_row_for_each_pair_with_the_numbers_of_solve(first):
    folder, done = first
    assert done.code == 1  # two pairs end in an obstacle
    assert '6 pairs, 6 of them solved now, 2 without a strategy' in done.out, done.err
    rows = rows_of(folder / 'table.csv')
    assert [(row['depot'], row['customer']) for row in rows] == [
        (depot, customer) for depot in ('north', 'south')
        for customer in ('mill', 'the old, bridge', 'blocked')
    ]
    assert [row['error'].partition(':')[0] for row in rows] == ['', '', 'GoalBlocked'] * 2
    risk_map = risk_map_from_occupancy(read_map(folder / 'map.yaml').values, 10.0)
    network = build_network(risk_map, (15, 15), (175, 25), NetworkOptions(spacing=20.0))
    strategy = solve(network, GameOptions(), StrategyOptions(max_detour=1.4))
    for name in ('value', 'lower_bound', 'expected_length', 'shortest_length', 'route_entropy'):
        assert float(rows[4][name]) == pytest.approx(getattr(strategy, name), rel=1e-8)
    assert not (folder / 'table.csv.part').exists()
    assert (folder / 'table.csv').stat().st_mode & 0o777 == 0o600


def test_only_what_is_missing_or_failed_is_solved_again(made):
    folder = made
    before = rows_of(folder / 'table.csv')
    done = run(folder)
    assert '6 pairs, 2 of them solved now' in done.out
    assert rows_of(folder / 'table.csv') == before
    (folder / 'customers.csv').write_text(CUSTOMERS.replace('185,95', '185,105'))
    done = run(folder)
    assert '6 pairs, 4 of them solved now' in done.out
    assert rows_of(folder / 'table.csv')[0]['inputs'] != before[0]['inputs']
    assert rows_of(folder / 'table.csv')[1] == before[1]
    done = run(folder, '--set', 'network.spacing=20', 'strategy.max_detour=1.5')
    assert '6 pairs, 6 of them solved now' in done.out


def interrupted(folder, how):
    """What is kept of a table of 200 pairs that is ended by a signal."""
    places = ''.join(f'c{k},185,{15 + k % 17 * 10}.{k}\n' for k in range(100))
    (folder / 'customers.csv').write_text('name,x,y\n' + places)
    process = subprocess.Popen(
        [sys.executable, '-m', 'ambush_planner.commands.cli', 'table',
         *given(folder, '--set', 'network.spacing=7', '--jobs', '1')],
        stderr=subprocess.PIPE, text=True,
    )
    part = folder / 'table.csv.part'
    end = time.monotonic() + 60.0
    while time.monotonic() < end and not (part.exists() and part.read_text().count('\n') > 4):
        time.sleep(0.02)
    process.send_signal(how)
    _, errors = process.communicate(timeout=60.0)
    assert 'Traceback' not in errors
    assert process.returncode == (130 if how == signal.SIGINT else -how)
    assert not (folder / 'table.csv').exists()
    kept = part.read_text().count('\n') - 1
    assert 4 <= kept < 200
    return part


@pytest.mark.slow
def test_a_table_is_kept_at_ctrl_c(folder):
    interrupted(folder, signal.SIGINT)


@pytest.mark.slow
def test_a_killed_table_goes_on_where_it_stopped(folder):
    part = interrupted(folder, signal.SIGKILL)
    places = (folder / 'customers.csv').read_text().splitlines()[:6]
    (folder / 'customers.csv').write_text('\n'.join(places) + '\n')  # five are enough
    kept = sum(int(row['customer'][1:]) < 5 for row in rows_of(part))
    with part.open('a') as file:
        file.write('north,c9,0.5,0.')  # what a kill may leave
    done = run(folder, '--set', 'network.spacing=7', '--jobs', '2')
    assert done.code == 0, done.err
    assert f'10 pairs, {10 - kept} of them solved now, 0 without' in done.out
    assert len(rows_of(folder / 'table.csv')) == 10 and not part.exists()


@pytest.mark.slow
def test_a_cluster_makes_the_same_table(made):
    distributed = pytest.importorskip('distributed', reason='dask takes the extra "dask"')
    here = (made / 'table.csv').read_text()
    (made / 'table.csv').unlink()
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=2, processes=False, protocol='tcp',
        dashboard_address=None, local_directory=str(made / 'dask'),
    ) as cluster:
        done = run(made, *OPTIONS, '--scheduler', cluster.scheduler_address)
    assert '6 pairs, 6 of them solved now, 2 without' in done.out, done.err
    assert (made / 'table.csv').read_text() == here


def test_what_is_wrong_is_said(folder):
    (folder / 'table.csv').write_text('something,else\n1,2\n')
    done = run(folder)
    assert done.code == 3 and 'no column depot' in done.err
    assert (folder / 'table.csv').read_text() == 'something,else\n1,2\n'
    done = run(folder, '--set', 'network.spaccing=3')
    assert done.code == 3 and "no option 'network.spaccing'" in done.err
    (folder / 'map.yaml').unlink()
    done = run(folder)
    assert done.code == 3 and 'map.yaml' in done.err and 'Traceback' not in done.err


@pytest.mark.parametrize(
    ('text', 'reason'),
    [
        ('name,x\na,1\n', 'no column y'),
        ('', 'no column name'),
        ('name,x,y\n', 'no places'),
        ('name,x,y\na,1,nan\n', 'line 2: x and y'),
        ('name,x,y\na,1,2\na,3,4\n', 'line 3: each place needs a name'),
        ('name,x,y\n,3,4\n', 'needs a name'),
        ('name,x,y\na,1\n', 'line 2: x and y'),
    ],
)
def test_places_that_cannot_be_used_are_refused(tmp_path, text, reason):
    (tmp_path / 'p.csv').write_text(text)
    with pytest.raises(BadTable, match=reason):
        read_places(tmp_path / 'p.csv')


def test_places_from_a_spreadsheet(tmp_path):
    (tmp_path / 'p.csv').write_bytes('\ufeffname,x,y\r\nMühle,1e3,-2\r\n'.encode())
    (place,) = read_places(tmp_path / 'p.csv')
    assert (place.name, place.xy) == ('Mühle', (1000.0, -2.0))


def test_options_have_the_names_of_parameters():
    options = options_from(['map.alpha_max=5', 'strategy.max_detour=.inf', 'network.spacing=1e1',
                            'network.method=uniform_grid8', 'network.target_nodes=99'])
    assert options.map.alpha_max == 5.0 and options.strategy.max_detour == np.inf
    assert options.network == NetworkOptions('uniform_grid8', 10.0, target_nodes=99)
    assert options_from([]).game == GameOptions()


@pytest.mark.parametrize(
    ('assignment', 'reason'),
    [
        ('network.spacing', 'NAME=VALUE'),
        ('spacing=3', 'no option'),
        ('network.spacing=wide', 'of type float'),
        ('network.target_nodes=2.5', 'of type int'),
        ('strategy.max_detour=0.5', 'max_detour'),
    ],
)
def test_options_that_cannot_be_are_refused(assignment, reason):
    with pytest.raises(InvalidOption, match=reason):
        options_from([assignment])


def test_a_table_that_is_not_finished_is_left_for_the_next_run(tmp_path):
    row = dict.fromkeys(COLUMNS, '') | {'depot': 'a', 'inputs': 'a'}
    with TableFile(tmp_path / 't.csv') as table:
        table.add(row)
        table.add(row | {'inputs': 'b', 'error': 'no'})
    assert os.listdir(tmp_path) == ['t.csv.part']
    with TableFile(tmp_path / 't.csv') as table:
        assert table.has('a') and not table.has('b')
        table.add(row | {'inputs': 'b'})
        table.finish(['b', 'a'])
    assert [row['inputs'] for row in rows_of(tmp_path / 't.csv')] == ['b', 'a']
    assert os.listdir(tmp_path) == ['t.csv']
