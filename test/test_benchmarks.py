"""The benchmarks run, and their tables say what was measured; how fast is not tested here."""

import itertools
import re

import numpy as np
import pytest
from commands import BENCHMARKS, run_benchmark

from ambush_planner import RiskMap, solve

SECTIONS = (
    'How many times faster',
    'Targets',
    'Processor seconds (peak memory of the process in MB)',
    'Sizes and iterations',
    'The answers agree',
    'A reach of 4 spacings, and budgets that raise the value',
    'From ten thousand to a million nodes',
)


def run(script: str, *arguments) -> str:
    done = run_benchmark(script, *arguments)
    assert done.code == 0, done.err
    return done.out


def rows(text: str) -> dict[str, list[str]]:
    """First cell of each table row -> the other cells."""
    lines = [line.split('|')[1:-1] for line in text.splitlines() if line.startswith('|')]
    return {first.strip(): [cell.strip() for cell in cells] for first, *cells in lines}


@pytest.fixture
def tables(monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    import solver_tables

    return solver_tables


@pytest.fixture
def report(monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    import report

    return report


@pytest.mark.slow
def test_all_solvers_agree_on_the_smallest_size(tmp_path):
    results = tmp_path / 'results.md'
    text = run(
        'solver.py', '--sizes', 12, '--repeats', 1, '--repeat-for', 0, '--growth', 10, 14,
        '--problems', 'reach-hills:12', '--results', results,
    )
    assert re.findall('^### (.*)$', text, re.MULTILINE) == list(SECTIONS)
    assert text.strip() in results.read_text()
    assert 'to the power of' in text
    cells = {title: row[0] for title, row in rows(text).items()}
    assert int(cells['directed edges']) > 500
    value = float(cells['value by cut'])
    for who in ('HiGHS dual simplex', 'HiGHS interior point'):
        assert float(cells[f'value: {who}']) == pytest.approx(value, rel=1e-6)
    assert value <= float(cells['value of the strategy']) <= 1.01001 * value
    entropy = float(cells['route entropy of the strategy [nats]'])
    assert float(cells['route entropy: Clarabel [nats]']) == pytest.approx(entropy, rel=2e-3)


@pytest.mark.slow
def test_random_games_of_any_kind(tmp_path):
    # Small ones, which HiGHS judges.
    text = run(
        'random_games.py', '--first', 57, '--count', 3, '--results', tmp_path / 'results.md')
    found = rows(text)
    assert found['**failures**'] == ['**0**']
    assert found['games'] == ['3 (seeds from 57)']
    assert int(found['values held against HiGHS'][0]) > 0


def test_a_random_game_that_failed_once(monkeypatch):
    """Safe routes, no length to spare: the law alone never fits to the last digit."""
    monkeypatch.syspath_prepend(BENCHMARKS)
    import random_games

    case = random_games.draw_case(100436, random_games.available())
    strategy = solve(case.network, case.game, case.strategy)
    assert strategy.value == 0.0
    assert strategy.expected_length == pytest.approx(strategy.shortest_length, rel=1e-9)


@pytest.mark.slow
def test_ambush_radius_on_coarse_meshes(tmp_path):
    results = tmp_path / 'results.md'
    text = run('ambush_radius.py', '--sizes', 10, 14, '--results', results)
    assert re.findall('^### (.*)$', text, re.MULTILINE) == ['Map `hills`', 'Map `block`']
    assert text.count('Without a radius the value falls on every mesh') == 2
    assert text.strip() in results.read_text()


@pytest.mark.parametrize('script', ['solver.py', 'random_games.py', 'one_run.py'])
def test_help(script):
    assert 'usage' in run(script, '--help')


def test_the_kept_results_hold_every_block():
    text = (BENCHMARKS / 'results.md').read_text()
    for name in ('solver', 'ambush_radius'):
        block = re.search(rf'<!-- {name}: begin -->\n(.+)\n<!-- {name}: end -->', text, re.DOTALL)
        assert block and rows(block[1])


def test_a_block_is_replaced_and_the_rest_stays(tmp_path, report):
    path = tmp_path / 'results.md'
    path.write_text('above\n<!-- a: begin -->\nold\n<!-- a: end -->\nbelow\n')
    report.write_block(path, 'a', 'new')
    report.write_block(path, 'b', 'other')
    assert path.read_text() == (
        'above\n<!-- a: begin -->\nnew\n<!-- a: end -->\nbelow\n'
        '\n<!-- b: begin -->\nother\n<!-- b: end -->\n'
    )


def measured(seconds: float, interior_point: dict) -> dict:
    """200 across; all took ``seconds`` but HiGHS' interior point method."""
    others = ('build', 'value', 'strategy', 'simplex', 'conic')
    answers = dict.fromkeys(others, {'seconds': seconds, 'peak': 100.0})
    return {200: answers | {'interior_point': interior_point}}


def test_a_solver_over_its_limit_is_called_so(tables):
    cells = rows(tables.report(measured(2.0, {'limit': 120}), {}, [], 'here'))
    title = 'strategy : HiGHS interior point, value alone'
    assert cells[f'{title}, 200 across'] == ['30x', '> 60x', 'yes']
    assert cells['HiGHS interior point without crossover, value'] == ['> 120']
    cells = rows(tables.report(measured(20.0, {'limit': 120}), {}, [], 'here'))
    assert cells[f'{title}, 200 across'] == ['30x', '> 6.0x', 'not known: the other gave no answer']


def test_a_solver_that_fails_has_no_ratio(tables):
    failed = {'seconds': 200.0, 'peak': 1.0, 'iterations': 3, 'status': 'Unknown', 'failed': True}
    cells = rows(tables.report(measured(2.0, failed), {}, [], 'here'))
    title = 'strategy : HiGHS interior point, value alone'
    assert cells[title] == ['**failed**']
    assert cells[f'{title}, 200 across'] == ['30x', 'failed', 'not known: the other gave no answer']


def test_targets_that_are_missed_are_called_so(tables):
    hard = {'terrain:1.1': {'seconds': 1.0, 'nodes': 5, 'failed': True, 'peak': 1.0},
            'city:1.1': {'seconds': 2.0, 'nodes': 6}}
    growth = [{'seconds': 80.0, 'nodes': 950_000, 'peak': 5000.0}]
    cells = rows(tables.targets(measured(2.0, {'seconds': 4.0, 'peak': 1.0}), hard, growth))
    assert cells['strategy : HiGHS interior point, value alone, 200 across'][1:] == [
        '2.0x', '**no**'
    ]
    assert cells['`terrain:1.1`, 5 nodes'] == ['< 3 s', '1.0 s', '**no**']
    assert cells['`city:1.1`, 6 nodes'] == ['< 3 s', '2.0 s', 'yes']
    assert cells['950000 nodes, network to strategy'][-1] == '**no**'


def test_the_exponent_of_the_growth(tables):
    growth = [
        {'nodes': n, 'edges': 6 * n, 'seconds': (n / 1e4) ** 1.5, 'peak': 1.0, 'iterations': 9}
        for n in (10_000, 40_000, 1_000_000)
    ]
    assert 'to the power of 1.50' in tables.growth_table(growth)


@pytest.mark.slow
def test_routes_are_measured_and_drawn(tmp_path):
    results, pictures = tmp_path / 'results.md', tmp_path / 'pictures'
    text = run(
        'routes.py', '--maps', 'maze', '--departures', 8, '--nodes', 1000, '--across', 20,
        '--pictures', pictures, '--results', results,
    )
    found = rows(text)
    assert found["accepted by Nav2's rules"][-1] == '100%'
    assert float(found['mean length : any-angle A*'][-1].strip('*')) >= 1.0
    turning = found['turning [rad]: mean path, least in its corridors'][-1].split(', ')
    assert float(turning[0]) >= float(turning[1]) > 0.0
    assert text.split('|', 1)[1] in results.read_text().split('|', 1)[1] + '\n'
    assert sorted(path.name for path in pictures.iterdir()) == ['before_and_after.png', 'maze.png']


@pytest.fixture
def drives(monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    import drives

    return drives


def driven(*corners, step=0.1):
    """Poses along straight lines, turning on the spot."""
    poses = []
    for a, b in itertools.pairwise(np.array(corners, float)):
        share = np.arange(0.0, 1.0, step / np.hypot(*(b - a)))[:, None]
        poses.append(np.column_stack((a + share * (b - a), np.full(
            len(share), np.arctan2(*(b - a)[::-1])))))
    return np.concatenate([*poses, [[*corners[-1], poses[-1][-1, 2]]]])


def test_what_is_measured_on_a_path(drives):
    ground = RiskMap(np.ones((20, 20)), np.zeros((20, 20), bool), 1.0)
    straight = drives.measure(driven((2, 10), (18, 10)), ground, 1.0, 0.2)
    assert (straight.length, straight.turning, straight.hairpins) == (pytest.approx(16), 0, 0)
    assert straight.near_itself == straight.near_edge == 0.0 and straight.accepted
    back = drives.measure(driven((2, 10), (18, 10), (2, 11)), ground, 1.0, 0.2)
    assert back.hairpins == 1 and back.turning == pytest.approx(np.pi, abs=0.1)
    assert back.near_itself > 0.5 and not back.accepted  # yaw jumps
    border = drives.measure(driven((1, 1), (19, 1)), ground, 1.0, 0.2)
    assert border.near_edge > 0.9
    assert not drives.accepted(driven((1, 1), (21, 1)), ground, 0.2)
    assert not drives.accepted(driven((1, 1), (19, 1)), ground, 0.05)
    blocked = RiskMap(np.ones((20, 20)), np.eye(20, dtype=bool), 1.0)
    assert not drives.accepted(driven((2, 10), (18, 10)), blocked, 0.2)


def test_the_grid_planner_finds_octile_lengths_and_pulls_them_straight(monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    import grid_planner
    from grounds import Ground

    obstacles = np.zeros((20, 20), bool)
    cells = grid_planner.a_star(~obstacles, (0, 0), (6, 19))
    steps = np.abs(np.diff(np.array(cells), axis=0)).sum(axis=1)
    assert np.sqrt(steps).sum() == pytest.approx(13 + 6 * np.sqrt(2))
    obstacles[:15, 10] = True
    ground = Ground(RiskMap(np.ones((20, 20)), obstacles, 1.0), (2.5, 2.5), (17.5, 2.5))
    line = grid_planner.shortest_line(ground)
    length = np.hypot(*np.diff(line, axis=0).T).sum()
    taut = np.hypot(7.5, 12.5) * 2 + 1.0
    assert taut <= length <= 1.05 * taut
