"""``ambush_audit`` and ``ambush_report`` on real recordings: results, files, exit codes, fuzz."""

import csv
import json
import re
import shutil
import stat
from functools import partial

import numpy as np
import pytest

pytest.importorskip('matplotlib', reason='pictures need matplotlib')

from audit_samples import START, departure, drawn, parameters, record, sample_plan, source
from commands import run_here
from damage import flips, truncations
from matplotlib.image import imread
from scipy.stats import binom

from ambush_planner.commands import audit, report
from ambush_planner.commands.audit_figures import quantile
from ambush_planner.recordings.mcap_file import MAGIC, decode

RNG = np.random.default_rng(12)

pytestmark = pytest.mark.usefixtures('fewer_draws')


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


def told_by(tool, folder, out):
    """What a tool says that holds of recordings while it writes its results."""
    done = run_here(tool, folder, '-o', out)
    assert done.code == 0
    return done.out + done.err


@pytest.fixture(scope='module')
def audited(tmp_path_factory, good):
    """The results of the audit of good departures, and what it said."""
    out = tmp_path_factory.mktemp('audited') / 'out'
    return out, told_by(audit, good, out)


@pytest.fixture(scope='module')
def reported(tmp_path_factory, good):
    out = tmp_path_factory.mktemp('reported') / 'out'
    return out, told_by(report, good, out)


def mode(path):
    return stat.S_IMODE(path.stat().st_mode)


def node_numbers(text):
    """Whether a text holds something like a list of node indices."""
    return re.search(r'\d+, \d+, \d+, \d+', text)


# The audit


def test_good_departures_pass(good, audited):
    before = set(good.parent.rglob('*'))
    assert audit.main([str(good)]) == 0
    assert set(good.parent.rglob('*')) == before  # nothing is written unasked
    out, told = audited
    assert 'Nothing suspicious' in told and 'FINDING' not in told
    assert '12 departures of 1 strategy' in told and 'at most 1 %' in told
    assert 'reading 12 recordings' in told and 'Traceback' not in told
    assert sorted(path.name for path in out.iterdir()) == [
        'audit.png', 'audit.txt', 'audit_passages.csv'
    ]
    assert mode(out) == 0o700 and {mode(path) for path in out.iterdir()} == {0o600}
    assert (out / 'audit.txt').read_text().strip() in told
    assert max(map(len, told.splitlines())) < 100 + len(str(out))
    image = imread(out / 'audit.png')
    assert image.shape[1] > 1500 and np.std(image) > 0.05


def test_the_tables_hold_what_was_audited(audited, a_plan):
    out, _ = audited
    passages = list(csv.DictReader((out / 'audit_passages.csv').open()))
    assert sum(float(row['expected_passages']) for row in passages) == pytest.approx(
        12 * a_plan.strategy.edge_probability.sum(), rel=1e-4
    )
    steps = sum(len(route) - 1 for route in drawn(a_plan, 12, 2))
    assert sum(int(row['passages']) for row in passages) == steps


def as_json(capsys, *arguments):
    code = audit.main([*map(str, arguments), '--json'])
    return code, json.loads(capsys.readouterr().out)


def test_the_result_as_json(good, stuck, capsys):
    code, result = as_json(capsys, good)
    assert code == 0 and result['verdict'] == 'holds' and not result['findings']
    assert set(result['tests']) == {'frequency', 'surprise', 'order', 'repeats'}
    code, result = as_json(capsys, stuck)
    assert code == 1 and result['verdict'] == 'finding'
    assert {'frequency', 'repeats'} <= set(result['findings'])


def test_a_finding_is_said_and_exits_1(stuck, capsys):
    assert audit.main([str(stuck)]) == 1
    told, _ = capsys.readouterr()
    assert 'FINDING (frequency)' in told and 'FINDING (repeats)' in told
    assert 'Only 1 of 6 routes are different' in told and 'UNREADABLE' not in told
    assert audit.main([str(stuck), '--quiet']) == 1
    assert capsys.readouterr() == ('', '')


def test_the_terminal_shows_no_route(audited, reported, stuck, capfd):
    audit.main([str(stuck)])
    assert not node_numbers(audited[1] + reported[1] + ''.join(capfd.readouterr()))


def test_an_impossible_step_is_found_and_only_counted(tmp_path, a_plan, capsys):
    for count in (6, 4):  # also where there are too few to tell
        routes = drawn(a_plan, 6)[:count]
        routes[2] = np.delete(routes[2], 4)
        folder = tmp_path / str(count)
        record(folder, [departure(a_plan, r, k) for k, r in enumerate(routes)])
        assert audit.main([str(folder)]) == 1
        told = ' '.join(capsys.readouterr().out.split())
        assert 'FINDING (impossible)' in told
        assert 'cannot have been drawn: 1.' in told and not node_numbers(told)


def test_too_few_departures_are_not_passed(tmp_path, a_plan, capsys):
    record(tmp_path / 'in', [departure(a_plan, r, k) for k, r in enumerate(drawn(a_plan, 4))])
    code, result = as_json(capsys, tmp_path / 'in')
    assert (code, result['verdict'], result['needed']) == (4, 'too_few', 1)
    assert audit.main([str(tmp_path / 'in')]) == 4
    assert 'Not enough to tell: 5 departures are needed, 1 more' in capsys.readouterr().out


def moved(number):
    return START[0] + 0.01 * number, START[1] - 0.01 * number


def test_a_start_that_moves_does_not_keep_departures_apart(tmp_path, capsys):
    """Six strategies; with the random source stuck at one value it is found, else not."""
    plans = [sample_plan(start=moved(k)) for k in range(6)]
    for stuck in (True, False):
        rng = np.random.default_rng(3)
        rows = []
        for k, each in enumerate(plans):
            generator = np.random.default_rng(3) if stuck else rng
            route = each.strategy.sample_route(generator)
            rows.append(departure(each, route, k + 1, start=moved(k)))
        record(tmp_path / str(stuck), rows)
        code, result = as_json(capsys, tmp_path / str(stuck))
        assert (result['departures'], result['strategies']) == (6, 6)
        assert code == int(stuck)
        assert ('repeats' in result['findings']) == stuck


@pytest.mark.parametrize(('entry', 'said'), [
    (lambda k: [source(1)], 'the same as that'), (lambda k: [source(1) + k], 'nearly the same'),
    (lambda k: [k + 2**190], 'fewer than 192 bits'), (lambda k: [7], 'fewer than 192 bits'),
])
def test_a_random_source_that_is_short_or_repeats_is_found(tmp_path, a_plan, capsys, entry, said):
    record(tmp_path / 'in', [
        departure(a_plan, r, k, texts={'route_entropy_source': json.dumps(entry(k))})
        for k, r in enumerate(drawn(a_plan, 6))
    ])
    assert audit.main([str(tmp_path / 'in')]) == 1
    told = capsys.readouterr().out
    assert 'FINDING (random source)' in told and said in ' '.join(told.split())
    assert not re.search(r'\d{30}', told)


def test_a_fixed_seed_is_a_finding(tmp_path, a_plan, capsys):
    record(tmp_path / 'in', [
        departure(a_plan, r, k, texts={'parameters': json.dumps(parameters(seed=3)),
                                       'route_entropy_source': f'[3, {k}]'})
        for k, r in enumerate(drawn(a_plan, 6))
    ])
    assert audit.main([str(tmp_path / 'in')]) == 1
    assert 'drawn with a fixed seed' in capsys.readouterr().out


def test_departures_of_several_strategies_are_audited_together(tmp_path, a_plan, capsys):
    other = sample_plan(hill=90)
    mixed = [departure(a_plan, r, k) for k, r in enumerate(drawn(a_plan, 3))]
    mixed += [departure(other, r, k + 20, hill=90) for k, r in enumerate(drawn(other, 3, 9))]
    record(tmp_path / 'in', mixed)
    assert audit.main([str(tmp_path / 'in')]) == 0
    assert '6 departures of 2 strategies' in capsys.readouterr().out


def test_a_strategy_with_cycles_is_not_passed_as_good(tmp_path, capsys):
    cyclic = sample_plan('interior_point')
    record(tmp_path / 'in', [
        departure(cyclic, r, k, texts={'parameters': json.dumps(
            parameters(**{'strategy.solver': 'interior_point'}))})
        for k, r in enumerate(drawn(cyclic, 6))
    ])
    assert audit.main([str(tmp_path / 'in')]) == 4
    assert 'Not audited, as their strategies have cycles' in capsys.readouterr().out
    assert report.main([str(tmp_path / 'in'), '-o', str(tmp_path / 'out')]) == 0


def test_unreadable_files_are_told_from_findings(good, tmp_path, capsys):
    folder = tmp_path / 'in'
    folder.mkdir()
    for path in good.rglob('*.mcap'):
        (folder / path.name).write_bytes(path.read_bytes())
    (folder / 'broken\x1b[2J.mcap').write_bytes(MAGIC)
    assert audit.main([str(folder)]) == 3
    told, _ = capsys.readouterr()
    assert 'Nothing suspicious' in told and 'UNREADABLE' in told
    assert 'broken\\x1b[2J.mcap' in told and '\x1b' not in told


def test_earlier_results_are_replaced_only_when_asked(good, audited, reported, tmp_path, capsys):
    for tool, name, (made, _) in (
        (audit, 'audit.txt', audited), (report, 'report.html', reported),
    ):
        out = shutil.copytree(made, tmp_path / name)
        (out / name).write_text('mine')
        (out / 'other').write_text('mine')
        with pytest.raises(SystemExit) as stop:
            tool.main([str(good), '-o', str(out)])
        assert stop.value.code == 2
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
        assert tool.main([str(place), '-o', str(tmp_path / out)]) == 3
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


# Fuzz


def garbage(data, count):
    for _ in range(count):
        begin, end = sorted(RNG.integers(0, len(data), 2))
        changed = data[:begin] + RNG.bytes(RNG.integers(0, 200)) + data[end:]
        if changed != data:
            yield changed


@pytest.mark.parametrize(('damage', 'count'), [
    (truncations, 80), (partial(flips, rng=RNG), 200), (garbage, 60),
])
@pytest.mark.parametrize('tool', [audit, report])
def test_damaged_files_are_refused_with_a_message(good, tmp_path, capsys, tool, damage, count):
    path = tmp_path / 'one.mcap'
    data = next(good.rglob('*.mcap')).read_bytes()
    for changed in damage(data, count):
        path.write_bytes(changed)
        code = tool.main([str(path), '-o', str(tmp_path / 'out'), '--replace'])
        told, progress = capsys.readouterr()
        if code == 3:
            assert 'is not readable as a recording' in ' '.join((told + progress).split())
        else:  # a bit that no reader minds
            same = decode(changed)
            same.library = decode(data).library
            assert same == decode(data)
        assert 'Traceback' not in told + progress
        assert not node_numbers(told + progress)


@pytest.mark.parametrize('q', [0.005, 0.5, 0.995])
@pytest.mark.parametrize('n', [1, 6, 300])
def test_the_pictures_band_is_the_binomial_laws(n, q):
    probability = np.linspace(0.0, 1.0, 101)
    np.testing.assert_array_equal(quantile(q, n, probability), binom.ppf(q, n, probability))
