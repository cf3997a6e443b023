"""``ambush_audit`` and ``ambush_report`` on real recordings: results, files, exit codes, fuzz."""

import csv
import re
import stat
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('matplotlib', reason='pictures need matplotlib')

import yaml
from audit_samples import departure, drawn, parameters, record, sample_plan
from damage import flips, truncations
from matplotlib.image import imread

from ambush_planner.recording.mcap_records import MAGIC
from ambush_planner.tools import audit, report

ROOT = Path(__file__).resolve().parent.parent
RNG = np.random.default_rng(12)


@pytest.fixture(scope='module')
def a_plan():
    return sample_plan()


@pytest.fixture(scope='module')
def good(tmp_path_factory, a_plan):
    folder = tmp_path_factory.mktemp('good') / 'recordings'
    record(folder, [departure(a_plan, r, k + 1) for k, r in enumerate(drawn(a_plan, 12, 2))])
    return folder


@pytest.fixture(scope='module')
def stuck(tmp_path_factory, a_plan):
    folder = tmp_path_factory.mktemp('stuck') / 'recordings'
    (route,) = drawn(a_plan, 1)
    record(folder, [departure(a_plan, route, k + 1) for k in range(6)])
    return folder


def mode(path):
    return stat.S_IMODE(path.stat().st_mode)


def node_numbers(text):
    """Whether a text holds something like a list of node indices."""
    return re.search(r'\d+, \d+, \d+, \d+', text)


# The audit


def test_good_departures_pass(good, tmp_path, capsys):
    out = tmp_path / 'out'
    assert audit.main([str(good), '-o', str(out)]) == 0
    told, progress = capsys.readouterr()
    assert 'Nothing suspicious' in told and 'FINDING' not in told
    assert '12 departures' in told and 'at most 1 %' in told
    assert 'reading 12 recordings' in progress and 'Traceback' not in progress
    names = sorted(path.name for path in out.iterdir())
    assert [re.sub('_[0-9a-f]{8}', '', name) for name in names] == [
        'audit.csv', 'audit.txt', 'audit.png', 'audit_passages.csv'
    ]
    assert mode(out) == 0o700 and {mode(path) for path in out.iterdir()} == {0o600}
    assert (out / 'audit.txt').read_text().strip() in told
    image = imread(next(out.glob('*.png')))
    assert image.shape[1] > 1500 and np.std(image) > 0.05


def test_the_tables_hold_what_was_audited(good, a_plan, tmp_path):
    out = tmp_path / 'out'
    audit.main([str(good), '-o', str(out)])
    rows = list(csv.DictReader((out / 'audit.csv').open()))
    assert [row['check'] for row in rows] == [
        'impossible', 'frequency', 'surprise', 'order', 'repeats'
    ]
    assert {row['departures'] for row in rows} == {'12'}
    assert {row['finding'] for row in rows} == {'False'}
    assert all(0.0 < float(row['p_value']) <= 1.0 for row in rows[1:])
    passages = list(csv.DictReader(next(out.glob('*_passages.csv')).open()))
    assert sum(float(row['probability']) for row in passages) == pytest.approx(
        a_plan.strategy.edge_probability.sum(), rel=1e-6
    )
    steps = sum(len(route) - 1 for route in drawn(a_plan, 12, 2))
    assert sum(int(row['passages']) for row in passages) == steps


def test_a_finding_is_said_and_exits_1(stuck, tmp_path, capsys):
    assert audit.main([str(stuck), '-o', str(tmp_path / 'out')]) == 1
    told, _ = capsys.readouterr()
    assert 'FINDING (frequency)' in told and 'FINDING (repeats)' in told
    assert 'Only 1 of 6 routes are different' in told and 'UNREADABLE' not in told


def test_the_terminal_shows_no_route(good, stuck, tmp_path, capfd):
    for k, folder in enumerate((good, stuck)):
        audit.main([str(folder), '-o', str(tmp_path / f'audit{k}')])
        report.main([str(folder), '-o', str(tmp_path / f'report{k}')])
    out, err = capfd.readouterr()
    assert not node_numbers(out + err)


def test_an_impossible_step_is_found_and_only_counted(tmp_path, a_plan, capsys):
    routes = drawn(a_plan, 6)
    routes[2] = np.delete(routes[2], 4)
    record(tmp_path / 'in', [departure(a_plan, r, k) for k, r in enumerate(routes)])
    assert audit.main([str(tmp_path / 'in')]) == 1
    told, _ = capsys.readouterr()
    assert 'FINDING (impossible)' in told
    assert 'cannot have been drawn: 1.' in told and not node_numbers(told)
    assert (tmp_path / 'in_audit' / 'audit.txt').exists()


def test_too_few_departures_are_said_to_be(tmp_path, a_plan, capsys):
    record(tmp_path / 'in', [departure(a_plan, r, k) for k, r in enumerate(drawn(a_plan, 4))])
    assert audit.main([str(tmp_path / 'in')]) == 0
    assert 'Too few to tell: at least 5' in capsys.readouterr().out


def test_a_step_that_cannot_have_been_drawn_is_found_in_few_departures_too(
        tmp_path, a_plan, capsys):
    routes = drawn(a_plan, 6)[:4]
    routes[2] = np.delete(routes[2], 4)
    record(tmp_path / 'in', [departure(a_plan, r, k) for k, r in enumerate(routes)])
    assert audit.main([str(tmp_path / 'in')]) == 1
    told, _ = capsys.readouterr()
    assert 'FINDING (impossible)' in told and 'Too few to tell' in told


def test_strategies_are_audited_each_on_its_own(tmp_path, a_plan, capsys):
    other = sample_plan(hill=90)
    mixed = [departure(a_plan, r, k) for k, r in enumerate(drawn(a_plan, 6))]
    mixed += [departure(other, r, k + 20, hill=90) for k, r in enumerate(drawn(other, 7))]
    record(tmp_path / 'in', mixed)
    assert audit.main([str(tmp_path / 'in')]) == 0
    told, _ = capsys.readouterr()
    assert told.count('Nothing suspicious') == 2 and '6 departures' in told
    # The rate is shared among them.
    assert told.count('0.5 %') == 2 and 'All strategies together: at most 1 %' in told
    assert len(list((tmp_path / 'in_audit').glob('audit_*.png'))) == 2


def test_a_strategy_with_cycles_is_not_passed_as_good(tmp_path, capsys):
    cyclic = sample_plan('interior_point')
    record(tmp_path / 'in', [
        departure(cyclic, r, k, texts={'parameters': yaml.safe_dump(
            parameters(**{'strategy.solver': 'interior_point'}))})
        for k, r in enumerate(drawn(cyclic, 6))
    ])
    assert audit.main([str(tmp_path / 'in')]) == 1
    assert 'Not audited: the strategy has cycles' in capsys.readouterr().out
    assert report.main([str(tmp_path / 'in'), '-o', str(tmp_path / 'out')]) == 0


def test_unreadable_files_are_told_from_findings(good, tmp_path, capsys):
    folder = tmp_path / 'in'
    folder.mkdir()
    for path in good.rglob('*.mcap'):
        (folder / path.name).write_bytes(path.read_bytes())
    (folder / 'broken.mcap').write_bytes(MAGIC)
    assert audit.main([str(folder)]) == 1
    told, _ = capsys.readouterr()
    assert 'Nothing suspicious' in told and 'UNREADABLE' in told and 'broken.mcap' in told


def test_earlier_results_are_replaced_only_when_asked(good, tmp_path, capsys):
    for tool, name in ((audit, 'audit.txt'), (report, 'report.html')):
        out = tmp_path / name
        assert tool.main([str(good), '-o', str(out)]) == 0
        (out / name).write_text('mine')
        (out / 'other').write_text('mine')
        assert tool.main([str(good), '-o', str(out)]) == 1
        assert (out / name).read_text() == 'mine'
        assert '--replace' in capsys.readouterr().err
        assert tool.main([str(good), '-o', str(out), '--replace']) == 0
        assert (out / name).read_text() != 'mine' and (out / 'other').read_text() == 'mine'
        assert mode(out / name) == 0o600


@pytest.mark.parametrize('tool', [audit, report])
def test_a_folder_that_cannot_be_used_is_named(good, tmp_path, capsys, tool):
    empty = tmp_path / 'empty'
    empty.mkdir()
    (tmp_path / 'file').write_text('')
    for place, out in ((empty, 'out'), (tmp_path / 'nowhere', 'out'), (good, 'file')):
        assert tool.main([str(place), '-o', str(tmp_path / out)]) == 1
        told, progress = capsys.readouterr()
        assert 'Traceback' not in told + progress
        assert str(place if out == 'out' else tmp_path / out) in progress


@pytest.mark.parametrize('arguments', [
    [], ['in', '--false-alarm-rate', '2'], ['in', '--false-alarm-rate', 'x'], ['in', '--unheard'],
])
def test_wrong_usage_exits_2(arguments, capsys):
    for tool in (audit, report):
        with pytest.raises(SystemExit) as ended:
            tool.main(arguments)
        assert ended.value.code == 2
    assert 'usage' in capsys.readouterr().err


@pytest.mark.parametrize('name', ['audit', 'report'])
def test_help_needs_neither_ros_nor_matplotlib(name):
    code = (
        'import sys\n'
        'for m in ("rclpy", "matplotlib", "mcap", "yaml"): sys.modules[m] = None\n'
        f'from ambush_planner.tools import {name}\n'
        f'try: {name}.main(["--help"])\n'
        'except SystemExit as e: assert e.code == 0\n'
        f'assert {name}.main(["x", "-o", "y"]) == 1\n'
    )
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, cwd=ROOT,
                          timeout=60)
    assert done.returncode == 0, done.stderr
    assert 'Exit code' in done.stdout and 'is not installed' in done.stderr


# Fuzz


def garbage(data, count):
    for _ in range(count):
        begin, end = sorted(RNG.integers(0, len(data), 2))
        changed = data[:begin] + RNG.bytes(RNG.integers(0, 200)) + data[end:]
        if changed != data:
            yield changed


@pytest.mark.parametrize(('damage', 'count'), [
    (truncations, 200), (partial(flips, rng=RNG), 500), (garbage, 100),
])
@pytest.mark.parametrize('tool', [audit, report])
def test_damaged_files_are_refused_with_a_message(good, tmp_path, capsys, tool, damage, count):
    path = tmp_path / 'one.mcap'
    data = next(good.rglob('*.mcap')).read_bytes()
    # Every byte of a recording is covered by a checksum or stands there twice.
    for changed in damage(data, count):
        path.write_bytes(changed)
        assert tool.main([str(path), '-o', str(tmp_path / 'out'), '--replace']) == 1
        told, progress = capsys.readouterr()
        assert f'{path} is not readable as a recording' in told + progress
        assert 'Traceback' not in told + progress
        assert not node_numbers(told + progress)


def test_one_strategy_with_two_sets_of_options_gets_files_of_its_own(tmp_path, a_plan, capsys):
    other = {'parameters': yaml.safe_dump(parameters(**{'map.alpha_max': 20.0}))}
    record(tmp_path / 'in', [
        departure(a_plan, route, k, texts=other if k > 5 else ())
        for k, route in enumerate(drawn(a_plan, 12))
    ])
    out = tmp_path / 'out'
    audit.main([str(tmp_path / 'in'), '-o', str(out)])
    names = [path.name for path in out.glob('*.png')]
    assert len(names) == 2 and any(name.endswith('_2.png') for name in names)
    assert all(name.removesuffix('.png') in capsys.readouterr().out for name in names[:1])


def test_what_cannot_be_held_to_the_rate_is_no_pass(tmp_path, good, monkeypatch, capsys):
    monkeypatch.setattr('ambush_planner.core.audit.MOST_RESAMPLES', 300)
    monkeypatch.setattr('ambush_planner.core.audit.LEAST_RESAMPLES', 99)
    assert audit.main([str(good), '-o', str(tmp_path / 'out')]) == 1
    assert 'UNTESTED: 301 resamples' in capsys.readouterr().out
