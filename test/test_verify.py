"""Recordings of a real node are verified: as they are, damaged, and by somebody elsewhere."""

import hashlib
import itertools
import math
import os
import re
import subprocess
import sys
from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
from forging import GET_PLAN, MOVED_GOAL, NEW_ROUTE, SEEDED, Forger, one_verifier, record_runs
from geometry_msgs.msg import PoseWithCovarianceStamped
from ros_harness import header, pose, risk_grid, stage

from ambush_planner.commands import verify as tool
from ambush_planner.network.construction import build_network
from ambush_planner.planning.plan import Route, departure_path, make_plan, solve_on_network
from ambush_planner.recordings import read_departure, recordings_in
from ambush_planner.recordings.metadata import KEYS
from ambush_planner.recordings.recorded_case import Case
from ambush_planner.recordings.verify import Verifier
from ambush_planner.recordings.verify_plan import strategy_faults
from ambush_planner.ros.departure_path import path_between
from ambush_planner.ros.dispatcher import Dispatcher
from ambush_planner.ros.displayed_plan import DisplayedPlan

SECRET_KEYS = ('route', 'route_entropy_source')


@pytest.fixture(scope='module')
def files(tmp_path_factory):
    return record_runs(tmp_path_factory)


@pytest.fixture(scope='module', autouse=True)
def verifier():
    with one_verifier() as verifier:
        yield verifier


def verified(place, capsys):
    """The exit code of the tool for a file or folder, and its lines on standard output."""
    code = tool.main([str(place)])
    out, err = capsys.readouterr()
    assert 'Traceback' not in out + err
    assert max(map(len, out.splitlines())) < 100 + len(str(place))
    return code, out.splitlines()


def test_what_a_node_records_holds(files, capsys):
    code, lines = verified(files[0].parent.parent, capsys)
    assert code == 0
    assert lines[-2] == '6 departures: all hold'
    newest = hashlib.sha256(files[-1].read_bytes()).hexdigest()
    assert lines[-1] == f'SHA-256 of the newest: {newest}'
    told = [line for line in lines if line.startswith('holds')]
    for path, line in zip(files, told, strict=True):
        assert re.fullmatch(
            rf'holds  {re.escape(path.name)}: departure \d, \d+ nodes, value [\d.]+', line
        )


def test_each_strategy_is_planned_once(files):
    planned = []
    with Verifier(planned.append) as verifier:
        assert all(verifier.verify(path).holds for path in files)
    # The second node planned the trip of the first one's first departure, with another seed.
    assert planned == [files[NEW_ROUTE], files[MOVED_GOAL], files[GET_PLAN]]


def test_another_strategy_of_a_solve_without_time_is_told_with_its_proof(files):
    strategy = Case(read_departure(files[NEW_ROUTE])).strategy()
    p = strategy.edge_probability.copy()
    p[np.argmax(p > 0.0)] += 1e-3
    other = replace(strategy, edge_probability=p, route_entropy=strategy.route_entropy - 1.0)
    assert strategy_faults(other, strategy, hurried=False)[0]
    faults, (note,) = strategy_faults(other, strategy, hurried=True)
    assert faults == []
    for number in (f'{other.value:.6g}', f'{other.lower_bound:.6g}', f'{other.route_entropy:.2f}'):
        assert number in note


def test_neither_routes_nor_seeds_are_printed(files, capsys, tmp_path):
    forger = Forger(files[SEEDED])
    forger.set_entry('route_entropy_source', [123456789])
    forger.correct()
    bad = forger.save(tmp_path / 'bad.mcap')
    for path in (*files, bad):
        tool.main([str(path)])
        printed = ''.join(capsys.readouterr())
        assert '123456789' not in printed
        metadata = read_departure(path).metadata.texts
        for key in SECRET_KEYS:
            assert metadata[key].strip('[]') not in printed


@pytest.mark.parametrize('solver', ['interior_point', 'simplex'])
def test_the_other_solvers_and_networks(solver, tmp_path, capsys):
    parameters = {
        'strategy.solver': solver, 'network.method': 'random_delaunay', 'route.path_spacing': 0.3,
        'strategy.length_weight': 0.01, 'game.secured_radius': 1.2, 'map.unknown_alpha': 4.0,
        'recording.compression': 'lz4',
    }
    with stage(tmp_path, parameters) as running:
        grid = risk_grid(origin=(-2.0, 3.0, 0.0))
        grid.data[0] = -1
        client = running.give(grid, (-0.5, 8.5), (6.5, 8.5))
        assert client.call('new_route').success
    code, lines = verified(tmp_path, capsys)
    assert (code, lines[-2]) == (0, '1 departure: all hold')


def test_ambush_radius_budget_and_slack(tmp_path, capsys):
    parameters = {
        'game.ambush_radius': 1.2, 'strategy.max_detour': math.inf, 'strategy.risk_slack': 0.1,
        'max_planning_time': math.inf,
    }
    with stage(tmp_path, parameters) as running:
        assert running.give().call('new_route').success
    assert verified(tmp_path, capsys)[0] == 0


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
    topics = {message.topic for message in read_departure(path).messages}
    assert {'/convoy/initialpose', '/convoy/way', '/there'} <= topics
    assert verified(path, capsys)[0] == 0


def in_another_frame(forger):
    """Give start and goal in a frame that only TF could bring into the map's."""
    def change(message):
        message.header.frame_id = 'odom'
        message.pose.position.x += 100.0

    for role in ('start', 'goal'):
        forger.edit(forger.place(role), change)
    if request := forger.entry('call')['request']:
        for asked in request.values():
            if isinstance(asked, dict):
                asked['header']['frame_id'] = 'odom'
                asked['pose']['position']['x'] += 100.0
        forger.edit_entry('call', request=request)
    forger.correct()


@pytest.mark.parametrize('which', [NEW_ROUTE, MOVED_GOAL])
def test_poses_in_another_frame_are_said_not_to_be_checked(which, files, tmp_path, capsys):
    forger = Forger(files[which])
    in_another_frame(forger)
    code, lines = verified(forger.save(tmp_path / 'tf.mcap'), capsys)
    assert code == 0
    for name in ('start', 'goal'):
        said = f"not checked: the {name} pose is in the frame 'odom', the map in 'map'"
        assert said in ' '.join(lines)


@pytest.mark.parametrize('name', ['ambush_planner', 'python', 'numpy', 'scipy', 'rclpy'])
def test_other_versions_are_told(name, files, tmp_path, capsys):
    forger = Forger(files[NEW_ROUTE])
    if name == 'ambush_planner':
        forger.metadata['planner_version'] = '0.0.1'
    else:
        forger.edit_entry('versions', **{name: '0.0.1'})
    code, lines = verified(forger.save(tmp_path / 'old.mcap'), capsys)
    assert code == 0
    assert f"(recorded with {name} '0.0.1', verified with {name} '" in ' '.join(lines)


def test_the_node_records_all_entries_of_the_metadata_that_are_known(files):
    for path in files:
        assert read_departure(path).metadata.texts.keys() == KEYS


def test_an_answer_that_tells_of_trouble_with_the_recording(tmp_path, capsys):
    runs = tmp_path / 'runs'
    runs.write_text('in the way of the folder')
    with stage(runs) as running:
        client = running.give()
        assert client.call('new_route').success
        client.diagnostics(recording='failed')
        runs.unlink()
        answer = client.call('new_route')
        client.diagnostics(recording='on')
    assert '; recording failed at' in answer.message
    assert verified(runs, capsys)[0] == 0
    forger = Forger(recordings_in(runs)[0])
    forger.edit_call('response', message=f'{answer.message} again')
    code, lines = verified(forger.save(tmp_path / 'x.mcap'), capsys)
    assert code == 1 and 'response: its message' in ' '.join(lines)


def test_a_clock_at_zero_or_set_back_on_the_way(tmp_path, capsys, monkeypatch):
    with stage(tmp_path / 'zero', {'use_sim_time': True}) as running:
        assert running.give().call('new_route').success
    (path,) = recordings_in(tmp_path / 'zero')
    assert {message.stamp_ns for message in read_departure(path).messages} == {0}
    with stage(tmp_path / 'back') as running:
        client = running.give()
        times = Dispatcher._now

        for set_back in (1, 2, 3):  # before the path is stamped, before it leaves, and after
            calls = itertools.count(1)
            monkeypatch.setattr(
                Dispatcher, '_now',
                lambda self, calls=calls, k=set_back: times(self) - 10**12 * (next(calls) > k),
            )
            assert client.call('new_route').success
    assert verified(tmp_path / 'zero', capsys)[0] == 0
    code, lines = verified(tmp_path / 'back', capsys)
    assert (code, lines[-2]) == (0, '3 departures: all hold')


def test_departures_beside_their_plan_on_ground_that_has_changed(tmp_path, capsys, monkeypatch):
    """Start and goal moved a little, an obstacle that is new: routes are drawn until clear."""
    monkeypatch.setattr(DisplayedPlan, '_resolve', lambda *_: None)
    parameters = {'replan.tolerance': 1e9, 'strategy.max_gap': 1e9, 'network.spacing': 1.0}
    with stage(tmp_path, parameters) as running:
        client = running.give()
        assert client.get_plan(pose(1.5, 5.5), pose(8.5, 5.5)).poses
        grid = risk_grid()
        values = np.array(grid.data, dtype=np.int8).reshape(20, 20)
        values[12:16, 5:7] = 100
        values[0, 0] = 77
        grid.data = values.ravel().tolist()
        client.publish('alpha_map', grid)
        client.diagnostics(stale='yes')
        for k in range(6):
            assert client.get_plan(pose(1.5 + 0.04 * k, 5.4), pose(8.5, 5.5 + 0.05 * k)).poses
    recorded = [read_departure(path) for path in recordings_in(tmp_path)]
    assert len(recorded) == 7 and all(each.map_changes for each in recorded[1:])
    strategy = Case(recorded[1]).strategy()
    drawn_again = [
        np.array_equal(strategy.sample_route(np.random.default_rng(
            each.metadata.route_entropy_source)), each.metadata.route)
        for each in recorded
    ]
    assert drawn_again[0]
    code, lines = verified(tmp_path, capsys)
    assert (code, lines[-2]) == (0, '7 departures: all hold')
    forger = Forger(recordings_in(tmp_path)[-1])
    changes = np.load(BytesIO(forger.attachments['map_changes.npz']))
    stream = BytesIO()
    np.savez_compressed(stream, cells=changes['cells'][:1], values=changes['cells'][:1])
    forger.attachments['map_changes.npz'] = stream.getvalue()
    forger.correct()
    code, lines = verified(forger.save(tmp_path / 'forged.mcap'), capsys)
    assert code == 1 and 'map_changes' in ' '.join(lines)


def test_a_consistent_forgery_holds(files, tmp_path, capsys):
    """What --help says cannot be found: another draw with all that follows from it."""
    forger, recorded = Forger(files[GET_PLAN]), read_departure(files[GET_PLAN])
    case = Case(recorded)
    strategy = case.strategy()
    for source in itertools.count(2**255):
        route = strategy.sample_route(np.random.default_rng([source]))
        if not np.array_equal(route, recorded.metadata.route):
            break
    old = case.message('path')
    planning, risk_map = case.parameters.planning, case.risk_map()
    network = build_network(risk_map, *case.metadata.ends, planning.network)
    made = make_plan(risk_map, solve_on_network(risk_map, network, planning), planning, 0.0)
    again = path_between(
        departure_path(made, Route(route, network.points[route]), made.spacing),
        case.message('start').pose, case.message('goal').pose, old.header,
    )
    forger.put(forger.place('path'), again.to_message())
    forger.set_entry('route', route.tolist())
    forger.set_entry('route_entropy_source', [source])
    forger.correct()
    assert verified(forger.save(tmp_path / 'forged.mcap'), capsys)[0] == 0


def run(*arguments):
    return subprocess.run(
        [sys.executable, '-m', 'ambush_planner.commands.cli', 'verify', *map(str, arguments)],
        env={**os.environ, 'ROS_PYTHON_CHECK_FIELDS': '1'},
        capture_output=True, text=True, timeout=60, check=False,
    )


def test_as_a_user_starts_it(files):
    process = run(files[0].parent)
    assert process.returncode == 0, process.stderr
    assert process.stdout.splitlines()[-2] == '4 departures: all hold'
    assert 'planned 3 times' in process.stderr


def test_what_is_not_there_is_said(tmp_path, capsys):
    assert tool.main([str(tmp_path / 'none')]) == 3
    out, err = capsys.readouterr()
    assert out == '' and err.startswith('ambush_verify: ') and 'No such file' in err


def test_one_bad_file_in_a_folder_does_not_hide_the_others(files, tmp_path, capsys):
    for k, path in enumerate(files[:3]):
        data = path.read_bytes()
        (tmp_path / path.name).write_bytes(data[: len(data) // 2] if k == 1 else data)
    code, lines = verified(tmp_path, capsys)
    assert code == 1  # it is not as it was when the next one was recorded
    told = [line for line in lines if line.startswith(('holds', 'FAILS'))]
    assert [line[:5] for line in told] == ['holds', 'FAILS', 'holds', 'FAILS']
    assert 'ambush_recover' in ' '.join(lines)
    assert f'{files[1].name} is exchanged' in ' '.join(lines)
    assert '1 of 3 departures: not consistent' in lines


def damaged(files):
    """Recordings cut off at 100 places from the first byte to the last, or with one bit changed."""
    whole = [path.read_bytes() for path in files]
    for k in range(100):
        data = whole[k % len(whole)]
        yield data[: (len(data) - 1) * k // 99]
    rng = np.random.default_rng(0)
    for k in range(200):
        data = bytearray(whole[k % len(whole)])
        data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
        yield bytes(data)


def test_damaged_files_are_refused_without_a_traceback(files, tmp_path, capsys):
    path = tmp_path / 'damaged.mcap'
    for data in damaged(files):
        path.write_bytes(data)
        code, lines = verified(path, capsys)
        assert code in (1, 3) and lines[1].startswith(f'FAILS  {path.name}')
