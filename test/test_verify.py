# SPDX-License-Identifier: Apache-2.0
"""Recordings of a real node are verified: as they are, and with contents that do not follow."""

import contextlib
import itertools
import math
import re
from dataclasses import replace
from threading import Event

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from forging import GET_PLAN, NEW_ROUTE, SEEDED, Forger
from games import two_pairs_of_gates
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.serialization import deserialize_message
from ros_harness import header, pose, risk_grid, stage
from waiting import TIMEOUT

from ambush_planner import plan_trip
from ambush_planner.commands import report_words
from ambush_planner.commands import verify as tool
from ambush_planner.game.certificate.certificate import Certificate
from ambush_planner.planning.solving import WarmStart
from ambush_planner.recordings.attachments import strategy_file, strategy_from_file
from ambush_planner.recordings.audit import audit
from ambush_planner.recordings.metadata import RecordedTrip
from ambush_planner.recordings.recorded_departure import read_departure
from ambush_planner.recordings.recorded_departures import recordings_in
from ambush_planner.recordings.recording_file import read_recording
from ambush_planner.recordings.report_data import sections_of
from ambush_planner.recordings.verify import network_problems, replan_problems
from ambush_planner.worker.process import WorkerProcess


def verified(place, capsys, *options):
    """The exit code of the tool for a file or folder, and its output."""
    code = tool.main([str(place), *options])
    out, err = capsys.readouterr()
    assert 'Traceback' not in out + err
    return code, out


def holds(place, capsys, *options):
    code, out = verified(place, capsys, *options)
    assert code == 0 and out.endswith(': all hold\n'), out
    return out


def test_what_a_node_records_holds(files, capsys):
    out = holds(files[0].parent.parent, capsys, '--replan')
    lines = [line for line in out.splitlines() if line.startswith('holds')]
    for path, line in zip(files, lines, strict=True):
        assert re.match(rf'holds +{re.escape(path.name)}: departure \d', line)
    assert out.count('fixed seed') == 2


def shift_path(message):
    message.poses[1].pose.position.x += 0.01


def other_route(forger):
    """A route that the strategy draws from another source."""
    (strategy,) = read_departure(forger.path).trip.legs
    routes = ([strategy.sample_route(np.random.default_rng(k)).tolist()]
              for k in itertools.count())
    forger.entries['route'] = next(each for each in routes if each != forger.entries['route'])


def other_probabilities(forger):
    """A strategy of one sure route: a flow, but of a larger value than the optimal one."""
    (strategy,) = read_departure(forger.path).trip.legs
    pairs = set(itertools.pairwise(forger.entries['route'][0]))
    used = [tuple(edge) in pairs for edge in strategy.network.edges.tolist()]
    forger.set_arrays(edge_probability=np.array(used, dtype=float))


def scaled(forger, name, factor):
    forger.set_arrays(**{name: forger.arrays()[name] * factor})


def other_parameter(name, value):
    return lambda forger: forger.entries['parameters'].update({name: value})


FORGERIES = {
    'another route': (NEW_ROUTE, other_route, 'route: the recorded entropy draws another'),
    'a short source': (NEW_ROUTE, lambda f: f.entries.update(route_entropy_source=[3]),
                       'fewer than 192 bits'),
    'another seed': (SEEDED, other_parameter('seed', 6), 'does not follow from the parameter seed'),
    'a path moved': (GET_PLAN, lambda f: f.edit('path', shift_path), 'path: it does not follow'),
    'other probabilities': (NEW_ROUTE, other_probabilities, 'strategy'),
    'a cheaper departure': (NEW_ROUTE, lambda f: f.entries.update(value=0.9 * f.entries['value']),
                            'value: the departure is stated to cost'),
    'another ambusher': (NEW_ROUTE, lambda f: f.set_arrays(
        ambush_probability=np.roll(f.arrays()['ambush_probability'], 1)), 'strategy'),
    'a wider budget': (NEW_ROUTE, lambda f: scaled(f, 'length_budget', 1.1),
                       'its length budget is'),
    'another reach': (NEW_ROUTE, lambda f: f.set_arrays(tube=np.array(0.3)),
                      'strategy: its reach or secured area'),
    'points moved': (GET_PLAN, lambda f: scaled(f, 'points', 1.0 + 1e-9), 'network: '),
    'another map': (NEW_ROUTE, lambda f: f.edit(
        'map', lambda m: m.data.__setitem__(slice(180, 230), m.data[170:220])), 'network: '),
    'endless ends': (GET_PLAN, lambda f: f.entries.update(ends=[[math.inf, 0.0], [8.5, 6.5]]),
                     'departure: a position of trip or ends is not finite'),
    'no place to start': (NEW_ROUTE, lambda f: f.entries['trip'].update(start=[99.0, 0.0]),
                          'no plan follows from'),
}


@pytest.mark.parametrize('name', FORGERIES)
def test_what_does_not_follow_is_found_and_named(name, files, tmp_path, capsys):
    which, forge, words = FORGERIES[name]
    forger = Forger(files[which])
    forge(forger)
    code, out = verified(forger.save(tmp_path / 'forged.mcap'), capsys)
    assert code == 1
    assert words in ' '.join(out.split())
    for secret in ('route', 'route_entropy_source'):
        assert str(forger.entries[secret]).strip('[]') not in out or len(forger.entries[secret]) < 2


def test_a_bound_that_the_time_limit_cut_short_holds(files, tmp_path, capsys):
    forger = Forger(files[NEW_ROUTE])
    scaled(forger, 'leg_bounds', 0.99)
    assert verified(forger.save(tmp_path / 'cut_short.mcap'), capsys)[0] == 0


def test_a_repeated_source_across_a_folder(files, tmp_path, capsys):
    (tmp_path / 'run_0.mcap').write_bytes(files[NEW_ROUTE].read_bytes())
    forger = Forger(files[NEW_ROUTE])
    forger.entries.update(departure_id='another', departure=4)
    forger.save(tmp_path / 'run_1.mcap')
    code, out = verified(tmp_path, capsys)
    said = ' '.join(out.split())
    assert code == 1 and 'each holds, but not together' in said
    assert 'run_1.mcap: its random source is the same as that of run_0.mcap' in said
    assert 'no recording of 2 departures between the first and the last' in said


def test_copies_and_deleted_files_are_found(files, tmp_path, capsys):
    for path in files[:4]:
        (tmp_path / path.name).write_bytes(path.read_bytes())
    holds(tmp_path, capsys)
    (tmp_path / 'another.mcap').write_bytes(files[1].read_bytes())
    code, out = verified(tmp_path, capsys)
    assert code == 1
    assert f'copy: another.mcap holds the same departure as {files[1].name}' in out
    (tmp_path / 'another.mcap').unlink()
    (tmp_path / files[1].name).unlink()
    assert 'no recording of 1 departure between the first and the last' in ' '.join(
        holds(tmp_path, capsys).split())


def test_names_and_texts_of_files_cannot_command_a_terminal(files, tmp_path, capsys):
    forger = Forger(files[NEW_ROUTE])
    forger.entries['topics']['map'] = forger.entries['frame'] = '\x1b]0;title\x07'
    path = forger.save(tmp_path / 'a\x1b[31m.mcap')
    for place in (path, tmp_path / '\x1b[2J'):
        with contextlib.suppress(SystemExit):  # a missing file is refused as an argument
            tool.main([str(place)])
        said = ''.join(capsys.readouterr())
        assert 'x1b[' in said and '\x1b' not in said and '\x07' not in said


def test_damaged_files_are_named_and_do_not_hide_others(files, tmp_path, capsys):
    for k, path in enumerate(files[:3]):
        data = bytearray(path.read_bytes())
        if k == 1:
            data[len(data) // 2] ^= 1
        (tmp_path / path.name).write_bytes(data[:-9] if k == 2 else data)
    code, out = verified(tmp_path, capsys)
    assert code == 3
    marks = [line[:5] for line in out.splitlines() if line.startswith(('holds', 'FAILS'))]
    assert marks == ['holds', 'FAILS', 'FAILS']
    assert '2 of 3 departures: not consistent' in out and 'mcap recover' in ' '.join(out.split())


def test_another_value_is_found_by_solving_again(files):
    departure = read_departure(files[NEW_ROUTE])
    trip, planning = departure.trip, departure.parameters.planning
    assert replan_problems(trip, planning) == []
    lower = Certificate(0.95 * trip.value, 0.95 * trip.lower_bound)
    (problem,) = replan_problems(replace(trip, certificate=lower), planning)
    assert 'solved again' in problem


@pytest.mark.parametrize('parameters', [
    {'strategy.solver': 'interior_point', 'strategy.length_weight': 0.01,
     'network.method': 'random_delaunay', 'route.path_spacing': 0.3,
     'game.secured_radius': 1.2, 'recording.compression': 'lz4'},
    {'game.ambush_radius': 1.2, 'route.tube': 0.9, 'strategy.max_detour': math.inf,
     'strategy.risk_slack': 0.1, 'max_planning_time': math.inf},
    {'game.ambush_in_obstacles': True, 'game.ambush_radius': 0.8},
], ids=['interior point', 'reach', 'exposure'])
def test_other_solvers_networks_and_games(parameters, tmp_path, capsys):
    with stage(tmp_path, parameters) as running:
        grid = risk_grid()
        grid.data[0] = -1
        answer = running.give(grid, (1.5, 5.5), (8.5, 5.5)).call('new_route')
        assert answer.success, answer.message
    holds(tmp_path, capsys, '--replan')


def test_a_start_from_initialpose_and_remapped_names(tmp_path, capsys):
    arguments = ['--ros-args', '-r', 'path:=way', '-r', 'goal_pose:=/there']
    with stage(tmp_path, namespace='convoy', cli_args=arguments) as running:
        client = running.client
        client.publish('alpha_map', risk_grid())
        estimate = PoseWithCovarianceStamped(header=header())
        estimate.pose.pose = pose(1.5, 5.5, 0.5).pose
        client.publish('initialpose', estimate)
        client.publish('/there', pose(8.5, 5.5, 2.0))
        client.diagnostics(state='ready')
        assert client.call('new_route').success
    (path,) = recordings_in(tmp_path)
    topics = read_recording(path).entries['topics']
    assert [topics[role] for role in ('start', 'path', 'goal')] == [
        '/convoy/start_pose', '/convoy/way', '/there']
    holds(path, capsys)


def published_value(path):
    """The value that the node's diagnostics had at a departure."""
    file = read_recording(path)
    (message,) = [each for each in file.messages if each.topic == '/diagnostics']
    status = deserialize_message(message.data, DiagnosticArray).status[0]
    return float(next(each.value for each in status.values if each.key == 'departure_value'))


def test_departures_near_their_plan_on_ground_that_has_changed(tmp_path, capsys, monkeypatch):
    """Start and goal move a little and an obstacle appears: routes are drawn until clear."""
    go_on, solve = Event(), WorkerProcess.solve

    def solve_again_later(worker, request, *rest):
        if request.warm is not None:
            go_on.wait(TIMEOUT)
        return solve(worker, request, *rest)

    monkeypatch.setattr(WorkerProcess, 'solve', solve_again_later)
    parameters = {'replan.tolerance': 1e9, 'strategy.max_gap': 1e9, 'network.spacing': 1.0}
    with stage(tmp_path, parameters) as running:
        client = running.give()
        assert client.get_plan(pose(1.5, 5.5), pose(8.5, 5.5)).poses
        grid = risk_grid()
        values = np.array(grid.data, dtype=np.int8).reshape(20, 20)
        values[12:16, 5:7] = 100
        values[7:12, 11:14] = 95
        grid.data = values.ravel().tolist()
        client.publish('alpha_map', grid)
        client.diagnostics(stale='yes')
        for k in range(5):
            assert client.get_plan(pose(1.5 + 0.04 * k, 5.4), pose(8.5, 5.5 + 0.05 * k)).poses
        go_on.set()
    files = recordings_in(tmp_path)
    departures = [read_departure(path) for path in files]
    assert [each.newest is each.planned_on for each in departures] == [True] + 5 * [False]
    for each in departures[1:]:
        assert np.array_equal(each.newest.values, values)
        lost = (each.drawn_from.legs[0].edge_probability
                < each.trip.legs[0].edge_probability)
        assert lost.any() and each.value > 1.05 * each.trip.value
    lines = [line for line in holds(tmp_path, capsys).splitlines() if 'value' in line]
    for path, each, line in zip(files, departures, lines, strict=True):
        published = published_value(path)
        assert (each.value, each.metadata.value) == pytest.approx([published] * 2, rel=1e-8)
        assert float(line.split('value ')[1]) == pytest.approx(published, rel=1e-5)
        section, = sections_of([each])
        assert report_words.tiles(section)[0][0] == f'{published:.3g}'
    # The observer's losses are those of that map, too, so he cannot cause more than this for long.
    assert audit(departures, resamples=49).value == pytest.approx(
        np.mean([each.value for each in departures[1:]]))
    forger = Forger(files[-1])
    other_route(forger)
    code, out = verified(forger.save(tmp_path / 'forged.mcap'), capsys)
    assert code == 1 and 'route: the recorded entropy draws another' in out


def test_networks_of_whole_routes_are_rebuilt_with_the_sites_of_a_warm_start():
    """Two pairs of gates with one pass between them: routes remember by which gate they came."""
    risk_map, start, goal, options = two_pairs_of_gates()
    warm = WarmStart(np.array([(25.3, 31.1)]), np.zeros((0, 3)))
    values: list[float] = []
    plan = plan_trip(risk_map, start, goal, options, warm=warm,
                     progress=lambda _, value: values.append(value))
    assert values == sorted(values, reverse=True), 'a finished plan stays in hand'
    assert plan.strategy.reason == 'complete' and plan.value < 2.1
    assert plan.strategy.mixture
    said = RecordedTrip(start, goal)
    assert network_problems(plan.trip, risk_map, options, said) == []
    again = strategy_from_file(strategy_file(plan.trip), options.game)
    assert again.value == plan.value
    assert network_problems(again, risk_map, options, said) == []
    assert np.array_equal(*(each.sample_route(3) for each in (*again.legs, *plan.legs)))
    moved = replace(plan.network, alpha=plan.network.alpha * 2.0)
    leg = replace(plan.strategy, game=replace(plan.strategy.game, network=moved))
    assert network_problems(replace(plan.trip, legs=(leg,)), risk_map, options, said)
