# SPDX-License-Identifier: Apache-2.0
"""Plan once, draw each morning: plan files, ``ambush draw``, and readers of its recordings."""

import json
import re
import stat
import sys
import time
from dataclasses import replace
from io import BytesIO, StringIO

import numpy as np
import pytest
from commands import NO_ROS, documented_keys, run_here, run_python
from games import plain_options
from test_path_mixtures import GOAL, START, ground

from ambush_planner import GameOptions, InvalidOption, NetworkOptions, PlanningOptions, plan_trip
from ambush_planner.commands import audit, card, draw, export, report, verify
from ambush_planner.maps.road_file import RoadGraph
from ambush_planner.operations.slots import Slots
from ambush_planner.planning.concerns import concerns, plan_numbers
from ambush_planner.planning.evaluation import evaluate
from ambush_planner.recordings.encoding import encode
from ambush_planner.recordings.plan_departures import departure_bytes, draw_departure
from ambush_planner.recordings.plan_file import plan_bytes, read_plan, saved_plan
from ambush_planner.recordings.recorded_departure import read_departure
from ambush_planner.recordings.recorded_departures import read_departures
from ambush_planner.recordings.recording_file import read_recording
from ambush_planner.recordings.verify import Verifier
from ambush_planner.route_files import Drawn

pytest.importorskip('matplotlib', reason='cards and reports have pictures')

OPTIONS = PlanningOptions(network=plain_options(spacing=3.0), game=GameOptions(ambush_radius=2.5))
SLOTS = Slots(('08:00', '09:30', '11:00'), (0.5, 0.3, 0.2), 1)


def roads():
    """A ladder of roads with speeds."""
    xs = np.linspace(START[0], GOAL[0], 5)
    points = np.array([(x, START[1] + dy) for dy in (-8.0, 0.0, 8.0) for x in xs])
    pairs = [(5 * row + k, 5 * row + k + 1) for row in range(3) for k in range(4)]
    pairs += [(k, k + 5) for k in range(10)]
    return RoadGraph(points, np.array(pairs), np.full((len(pairs), 2), 10.0), True)


def floats():
    """A map whose losses no occupancy grid can hold, with a coordinate system."""
    return replace(ground(), alpha=ground().alpha * np.pi, crs='EPSG:32616')


PLANS = {
    'routes': lambda: plan_trip(ground(), START, GOAL, OPTIONS),
    'floats': lambda: plan_trip(floats(), START, GOAL, OPTIONS),
    'refined': lambda: plan_trip(ground(), START, GOAL, replace(OPTIONS, network=NetworkOptions(
        spacing=3.0, refine=None))),
    'stops': lambda: plan_trip(ground(), START, GOAL, OPTIONS,
                               stops=[(12.0, 4.0), (28.0, 16.0)]),
    'roads': lambda: plan_trip(ground(), START, GOAL, replace(OPTIONS, network=plain_options(
        method='graph', graph=roads(), spacing=3.0))),
    'held': lambda: plan_trip(ground(), START, GOAL, replace(OPTIONS, game=GameOptions(
        ambush_radius=2.5, held_places=[(25.0, 15.0, 3.0)]))),
}


class Plans(dict):
    """Plan files by name, each with what was planned; made when they are first asked for."""

    def __init__(self, folder):
        self.folder = folder

    def __missing__(self, name):
        plan, file = PLANS[name](), self.folder / f'{name}.plan'
        file.write_bytes(plan_bytes(saved_plan(plan, slots=SLOTS)))
        self[name] = plan, file
        return self[name]


@pytest.fixture(scope='module')
def plans(tmp_path_factory):
    return Plans(tmp_path_factory.mktemp('plans'))


def copy_of(plans, name, folder):
    file = folder / 'week.plan'
    file.write_bytes(plans[name][1].read_bytes())
    return file


@pytest.mark.parametrize('name', PLANS)
def test_a_plan_comes_back_and_all_that_is_drawn_from_it_holds(plans, name, tmp_path):
    plan, file = plans[name][0], copy_of(plans, name, tmp_path)
    read = read_plan(file)
    numbers = (plan.value, plan.lower_bound)
    assert (read.plan.value, read.plan.lower_bound) == pytest.approx(numbers, rel=1e-12)
    assert read.parameters.planning == plan.options or name == 'roads'
    # The same entropy draws the same from the plan and from its file.
    one, other = (draw_departure(each, source=2**255 + 7) for each in (
        saved_plan(plan, slots=SLOTS), read))
    assert all(map(np.array_equal, one.route, other.route)) and one.slot == other.slot
    assert one.poses == pytest.approx(other.poses, abs=1e-9)
    done = run_here(draw, file, '--days', 6, '--date', '2030-01-01')
    assert done.code == 0, done.err
    folder, verifier = tmp_path / 'week.departures', Verifier(replan=name == 'routes')
    found = sorted(folder.iterdir())
    assert [path.name for path in found] == [f'000{k}_2030-01-0{k}.mcap' for k in range(1, 7)]
    for path in found:
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        assert verifier.verify(path).problems == []
        departure = read_departure(path)
        assert departure.drawn_from.value == pytest.approx(plan.value)
        assert departure.path_poses[0, :2] == pytest.approx(START, abs=1e-9)
    if name in ('routes', 'refined', 'held'):
        return  # what the commands read of these, the others have, too
    for command, more in ((audit, ()), (report, ('-o', tmp_path / 'out', '--verify')),
                          (export, ('-o', tmp_path / 'all.csv'))):
        done = run_here(command, folder, *more)
        assert done.code == 0, (command, done.out, done.err)
    assert '2030-01-06 ' in (tmp_path / 'all.csv').read_text(), 'the day that it is for'
    said = ' '.join(run_here(audit, folder).out.split())
    assert f'at most the value, {plan.value / 2:.3g}, on average' in said, 'one number everywhere'
    page = (tmp_path / 'out' / 'report.html').read_text()
    assert f'<b>{plan.value / 2:.3g}</b>' in page, 'the value that the plan was printed with'
    assert 'one time of departure only' in page and '2030-01-01 ' in page
    assert 'Verified: all 6 recordings' in page
    last = read_departures(found, pytest.fail)[-1]
    picture = Drawn(last.departed_on, last.risk_map, [], [], covered=last.covered).picture()
    for text in (page, picture.axes[0].get_title('left')):
        assert f'mean loss of at most {plan.value / 2:.3g} ' in text or (
            f'mean loss of {plan.value / 2:#.3g}\n' in text)
    measures = page.split('these random routes and times</th>')[1].split('</tr>')[0]
    assert f'<td>{plan.value / 2:.3g}</td>' in measures, 'the table of planners, too'


@pytest.mark.parametrize(('name', 'words'), [
    ('routes', ''), ('stops', 'drawn as a whole instead of leg by leg; plan again')])
def test_recordings_of_the_format_before_are_read_if_they_have_one_leg(plans, name, words, tmp_path,
                                                                       monkeypatch):
    saved = saved_plan(plans[name][0])
    path, drawn = tmp_path / '1.mcap', draw_departure(saved)
    path.write_bytes(departure_bytes(saved, drawn, 1, '2031-01-01', time.time_ns()))
    now, entries = read_recording(path), {**read_recording(path).entries}
    entries['route'] = [node for nodes in entries['route'] for node in nodes]
    del entries['value'], entries['format']
    entries['parameters'] = {name: value for name, value in entries['parameters'].items()
                             if name not in ('network.two_way', 'trip.max_idle')}
    with np.load(BytesIO(now.attachments['strategy.npz'])) as archive:
        before = {key: archive[key] for key in archive if key != 'legs'}
    before['lower_bound'] = before.pop('leg_bounds').sum()
    before['edges'] = before['edges'].cumsum(axis=0)
    stream = BytesIO()
    np.savez_compressed(stream, **before, leg=np.zeros(9), places=np.arange(9))
    monkeypatch.setattr('ambush_planner.recordings.encoding.FORMAT', '10')
    path.write_bytes(encode(now.messages, entries, {
        **now.attachments, 'strategy.npz': stream.getvalue()}, 'zstd'))
    monkeypatch.undo()
    found = Verifier().verify(path)
    assert (found.problems == [] if not words else words in found.problems[0]), found.problems
    if not words:
        assert read_departure(path).value == pytest.approx(plans[name][0].value)


def test_every_number_of_a_plan_of_few_routes_is_of_these():
    """And so are its concerns: here one route is the best mixture, and one place hits it."""
    plan = plan_trip(ground(), START, GOAL, OPTIONS, routes=3, rng=1)
    numbers, row = plan_numbers(plan), evaluate(plan)['stochastic']
    assert plan._summary()['value'] == f'{plan.few.value:.4g}'
    assert float(numbers['value']) == pytest.approx(plan.few.value)
    assert float(numbers['expected_length']) == pytest.approx(plan.driven_length)
    assert (row.v_repeated, row.expected_length) == pytest.approx((plan.value, plan.driven_length))
    best = plan.drawn_from.game.network.points[plan.bottleneck.sites]
    np.testing.assert_allclose(best, [plan.few.worst_xy])
    one = replace(plan, few=plan_trip(ground(), START, GOAL, OPTIONS, routes=1, rng=1).few)
    # The place that is found is on the way, or near an end.
    assert 'every ' in ' '.join(concerns(one)) and 'every ' not in ' '.join(concerns(plan))
    with pytest.raises(InvalidOption, match='few routes is not saved'):
        saved_plan(plan)


def test_the_week_needs_no_ros(plans, tmp_path):
    file = copy_of(plans, 'routes', tmp_path)
    lines = [f'draw {file} -o {tmp_path}/card.html --speed 20',
             f'verify {tmp_path}/week.departures',
             f'draw {file} --days 2 --date 2031-05-01 -o {tmp_path}/sheet.html']
    done = run_python(NO_ROS + 'from ambush_planner.commands import cli\n' + ''.join(
        f'assert cli.main({line.split()!r}) == 0\n' for line in lines))
    assert done.returncode == 0, done.stderr
    assert {path.name for path in tmp_path.glob('*.html')} == {
        'card.html', 'sheet_2031-05-01.html', 'sheet_2031-05-02.html'}
    # Of several days, the console tells nothing but the files.
    assert re.search(r'(?m)^\d{4}-\d\d-\d\d, (08:00|09:30|11:00): [\d.]+ m$', done.stdout)
    assert '2031-05-01:' not in done.stdout and '2031-05-01,' not in done.stdout


def test_a_second_draw_asks_and_one_that_was_not_driven_does_not_count(plans, tmp_path,
                                                                       monkeypatch):
    file = copy_of(plans, 'routes', tmp_path)
    folder = tmp_path / 'week.departures'
    day = ('--date', '2030-03-04')
    said = run_here(draw, file, *day, '--slot', '8:00').err
    assert 'time of departure is not drawn' in said and 'is not one of' not in said
    other = run_here(draw, file, '--dry-run', '--slot', '8:10').err
    assert "08:10 is not one of the plan's slots 08:00, 09:30, 11:00" in other
    assert run_here(draw, file, *day, '--slot', '11:00').code == 0  # another slot is another trip
    again = run_here(draw, file, *day, '--slot', '08:00')
    assert again.code == 2
    assert 'Was it driven? Add --earlier driven, or --earlier unused' in again.err
    assert len(list(folder.iterdir())) == 2
    assert run_here(draw, file, *day, '--slot', '08:00', '--earlier', 'unused').code == 0
    counted = json.loads(run_here(export, folder, '-o', tmp_path / 'x.csv', '--json').out)
    assert counted['departures'] == 2
    assert run_here(draw, file, *day, '--slot', '08:00', '--earlier', 'driven').code == 0
    counted = json.loads(run_here(export, folder, '-o', tmp_path / 'x.csv', '--json').out)
    assert counted['departures'] == 3
    for answer, code in (('y\n', 0), ('n\n', 0), ('\n', 2)):
        monkeypatch.setattr('sys.stdin', StringIO(answer))
        monkeypatch.setattr(sys.stdin, 'isatty', lambda: True, raising=False)
        done = run_here(draw, file, *day, '--slot', '08:00')
        assert done.code == code and 'Was it driven? [y/n]' in done.err
    counted = json.loads(run_here(export, folder, '-o', tmp_path / 'x.csv', '--json').out)
    assert counted['departures'] == 4
    struck = '0001_2030-03-04, 0005_2030-03-04 (2 of 6)'
    said = [run_here(verify, folder).out, run_here(audit, folder).out]
    assert run_here(report, folder, '-o', tmp_path / 'out').code == 0
    for text in (*said, (tmp_path / 'out' / 'report.html').read_text()):
        assert f'Struck as unused: {struck}. A planner who draws until' in ' '.join(text.split())
    for command, more in ((verify, ()), (audit, ()), (report, ('-o', tmp_path / 'json'))):
        result = json.loads(run_here(command, folder, *more, '--json').out)
        assert [name[-20:] for name in result['struck']] == [
            '0001_2030-03-04.mcap', '0005_2030-03-04.mcap']


def test_verify_says_which_plan_each_departure_is_of(plans, tmp_path):
    folder = tmp_path / 'week.departures'
    assert run_here(draw, copy_of(plans, 'routes', tmp_path), '--days', 2).code == 0
    lines = run_here(verify, folder).out
    value = plans['routes'][0].value
    assert lines.count(f'value {value / 2:.4g} ({value:.4g} if he knows the time)') == 2
    assert 'plans' not in lines
    assert run_here(draw, copy_of(plans, 'held', tmp_path), '--date', '2040-01-01').code == 0
    others = run_here(verify, folder, '--json')
    result = json.loads(others.out)
    assert set(result) == documented_keys(verify)
    held = plans['held'][0].value
    assert [(each['departures'], each['value']) for each in result['plans']] == [
        (2, pytest.approx(value / 2)), (1, pytest.approx(held / 2))]
    said = ' '.join(run_here(verify, folder).out.split())
    assert '3 departures of 2 plans: 2 of ' in said and f'UTC (value {held / 2:.3g})' in said


def test_slots_follow_their_shares(plans):
    saved = read_plan(plans['routes'][1])
    drawn = [draw_departure(saved) for _ in range(3000)]
    for slot, share in zip(SLOTS.times, SLOTS.shares, strict=True):
        assert abs(np.mean([each.slot == slot for each in drawn]) - share) < 0.05


def test_a_full_disk_leaves_nothing_and_nothing_has_been_drawn(plans, tmp_path):
    """A limit on the size of files stands for the disk: the card fits, the recording does not."""
    file = copy_of(plans, 'routes', tmp_path)
    (tmp_path / 'card.html').write_text('yesterday')
    script = (f'import resource\nfrom ambush_planner.commands import cli, draw\n'
              'from ambush_planner.commands import card_page\n'
              'card_page.card_page = lambda *_: "a card"\n'
              'resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))\n'
              f'raise SystemExit(cli.main(["draw", "{file}", "-o", "{tmp_path}/card.html"]))')
    done = run_python(script)
    assert done.returncode == 3 and '.mcap: File too large' in done.stderr, done.stderr
    assert 'Nothing was written, so nothing was drawn.' in done.stderr
    assert (tmp_path / 'card.html').read_text() == 'yesterday'
    assert list((tmp_path / 'week.departures').iterdir()) == []
    assert run_here(draw, file).code == 0  # and nobody is asked about an earlier one


def test_files_that_are_no_plans_are_named(plans, tmp_path, monkeypatch):
    file = copy_of(plans, 'routes', tmp_path)
    whole = file.read_bytes()
    assert run_here(draw, file).code == 0
    (recording,) = (tmp_path / 'week.departures').iterdir()
    for path, words in ((recording, 'it is a recorded departure, not a plan'),
                        (tmp_path / 'none.plan', 'none.plan: No such file or directory'),
                        (tmp_path, 'Is a directory')):
        done = run_here(draw, path)
        assert done.code == 3 and words in done.err and done.err.count('\n') == 1
    done = run_here(audit, file)
    assert 'it is a plan: ambush draw makes a departure of it' in ' '.join(done.out.split())
    done = run_here(card, file, '-o', tmp_path / 'c.html')
    assert done.code == 2 and 'is a plan, not a departure: draw one with' in done.err
    done = run_here(card, recording, '-o', tmp_path / 'c.html', '--route', 1)
    assert done.code == 2 and '--route was removed: leave it out' in done.err
    flipped = bytes([whole[5000] ^ 1])
    for content in (whole[:5000] + flipped + whole[5001:], b'not a plan'):
        file.write_bytes(content)
        done = run_here(draw, file)
        assert done.code == 3 and 'it is damaged or not an MCAP file: use your copy' in done.err
    file.write_bytes(whole)
    monkeypatch.setattr('ambush_planner.recordings.recording_file.FORMAT', '1')
    done = run_here(draw, file)
    assert done.code == 3 and "this version reads '1'" in done.err


def test_a_clock_that_went_back_and_a_day_before_others_are_named(plans, tmp_path, monkeypatch):
    file = copy_of(plans, 'routes', tmp_path)
    done = run_here(draw, file, '--date', '2020-01-01')
    assert done.code == 0 and '2020-01-01 has passed: today is 20' in done.err
    assert run_here(draw, file).code == 0
    now = time.time_ns()
    monkeypatch.setattr(time, 'time_ns', lambda: now - 2 * 86_400 * 10**9)
    done = run_here(draw, file)
    assert done.code == 2 and 'set the clock, or name the day with --date' in done.err
    assert run_here(draw, file, '--date', '2040-01-01').code == 0
    late = (file, '--date', '2020-01-02')
    done = run_here(draw, *late)
    assert done.code == 2 and 'departures after it were drawn, up to 0003_2040-01-01' in done.err
    assert run_here(draw, *late, '--late-entry').code == 0
