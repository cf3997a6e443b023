"""Files made to crash or to stall the tools, with checksums that hold."""

import os
import time

import numpy as np
import pytest
from forging import NEW_ROUTE, Forger, record_runs
from recording_samples import file_of, small_departure
from ros_harness import free_domain

from ambush_planner.commands import audit, recover, replay, report, verify
from ambush_planner.recordings import (
    UnreadableRecording,
    messages,
    read_departure,
    recordings_in,
    verify_plan,
)
from ambush_planner.recordings import repair as repairing
from ambush_planner.recordings.bag_folder import listed_files
from ambush_planner.recordings.mcap_file import whole_part
from ambush_planner.recordings.repair import repair
from ambush_planner.worker.process import WorkerProcess

PATIENCE = 30.0  # seconds of this process, for what takes a few at most
BOMB = 'a: &a [1, 1, 1]\n' + ''.join(
    f'{new}: &{new} [*{old}, *{old}, *{old}, *{old}, *{old}, *{old}, *{old}, *{old}]\n'
    for old, new in zip('abcdefghij', 'bcdefghijk', strict=True)
)
MERGES = 'a: &a {x: 1}\n' + ''.join(
    f'{new}: &{new} {{<<: [*{old}, *{old}, *{old}, *{old}, *{old}, *{old}, *{old}, *{old}]}}\n'
    for old, new in zip('abcdefghij', 'bcdefghijk', strict=True)
)
TEXTS_OF_ALL_KINDS = {
    'sexagesimal float': '1:' + ':'.join(['59'] * 200) + ':1.0',
    'sexagesimal number': '1' + ':59' * 300_000,
    'huge number': '0x' + 'f' * 10_000,
    'huge decimal': '9' * 1000,
    'aliases': BOMB,
    'merges': MERGES,
    'nested': '[' * 10_000,
    'nested mappings': '{"a":' * 10_000,
    'tagged': '!!int "' + '1: ' * 100_000 + '1"',
    'many entries': '{' + ','.join(f'k{i}' for i in range(100_000)) + '}',
    'long': 'a' * 2**21,
    'no date': '2001-99-99',
    'a key twice': 'a: 1\na: 2',
    'a key twice inside': '[{a: 1, a: 1}]',
}
HARMLESS = {'many numbers': '[' + '1, ' * 200_000 + '1]'}


class InTime:
    """Fails where what is in it takes long."""

    def __enter__(self):
        self._start = time.process_time()

    def __exit__(self, *error):
        assert time.process_time() - self._start < PATIENCE


def crafted(path, **metadata):
    """A recording whose metadata says other things."""
    path.write_bytes(file_of(small_departure(), **metadata))
    return path


def run(main, arguments):
    with InTime():
        try:
            return main([str(each) for each in arguments])
        except SystemExit as stop:
            return stop.code


@pytest.fixture(scope='module')
def whole(tmp_path_factory):
    """What a node recorded."""
    return record_runs(tmp_path_factory)[NEW_ROUTE]


@pytest.fixture(scope='module')
def folder(tmp_path_factory, whole):
    """A session of crafted recordings, with a metadata.yaml like them.

    All but one entry of each are as a node recorded them, and its checksums are corrected.
    """
    folder = tmp_path_factory.mktemp('runs')
    for number, text in enumerate({**TEXTS_OF_ALL_KINDS, **HARMLESS}.values()):
        for key in ('inputs', 'versions', 'trip', 'parameters', 'sha256', 'route', 'departure'):
            forger = Forger(whole)
            if key not in ('inputs', 'sha256'):
                forger.metadata[key] = text
                forger.correct()
            forger.metadata[key] = text
            forger.save(folder / f'run_{number}_{key}.mcap')
    (folder / 'metadata.yaml').write_text(BOMB)
    return folder


def test_verify(folder):
    assert run(verify.main, [folder]) == 1


@pytest.mark.parametrize(('spacing', 'skipped'), [
    (0.003, 'trip_network'), (0.01, 'trip_network'), (0.9, 'solve'), (1e-9, 'trip_network'),
])
def test_a_network_of_another_size_is_neither_built_nor_solved(
    whole, tmp_path, capsys, monkeypatch, spacing, skipped
):
    called = []
    if skipped == 'solve':
        monkeypatch.setattr(WorkerProcess, 'solve', lambda *_: called.append(skipped))
    else:
        monkeypatch.setattr(verify_plan, skipped, lambda *_: called.append(skipped))
    forger = Forger(whole)
    forger.edit_entry('parameters', **{'network.spacing': spacing})
    forger.correct()
    assert verify.main([str(forger.save(tmp_path / 'x.mcap'))]) == 1
    out = capsys.readouterr().out
    assert 'network: it does not follow' in out or 'asks for more than' in out
    assert not called


def test_an_attachment_that_unpacks_to_much_more_is_refused(whole, tmp_path, capsys):
    forger = Forger(whole)
    forger.set_arrays(points=np.zeros((2**21, 2)))
    forger.correct()
    path = forger.save(tmp_path / 'x.mcap')
    for tool, arguments in ((verify, []), (audit, ['-o', tmp_path / 'a']),
                            (report, ['-o', tmp_path / 'r'])):
        assert run(tool.main, [path, *arguments]) in (1, 3)
        assert 'claims to hold' in ''.join(capsys.readouterr())


def test_report(folder, tmp_path):
    assert run(report.main, [folder, '-o', tmp_path / 'report']) in (0, 1, 3, 4)


def test_audit(folder, tmp_path):
    assert run(audit.main, [folder, '-o', tmp_path / 'audit']) in (0, 1, 3, 4)


def test_recover(folder, tmp_path):
    assert run(recover.main, [folder, '-o', tmp_path / 'saved']) == 0


def test_replay(folder, monkeypatch):
    with free_domain() as domain:
        monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
        assert run(replay.main, [folder, '--rate', '1000']) in (0, 1, 3, 4)


@pytest.mark.parametrize('kind', TEXTS_OF_ALL_KINDS)
def test_crafted_quality_of_service(tmp_path, monkeypatch, kind):
    monkeypatch.setattr(messages, 'qos_to_yaml', lambda qos: TEXTS_OF_ALL_KINDS[kind])
    path = crafted(tmp_path / 'x.mcap')
    with InTime(), pytest.raises(UnreadableRecording):
        read_departure(path)


@pytest.mark.parametrize('kind', TEXTS_OF_ALL_KINDS)
def test_a_crafted_listing(tmp_path, kind):
    session = tmp_path / 'ambush_1'
    session.mkdir()
    path = crafted(session / 'run_0.mcap')
    (session / 'metadata.yaml').write_text(
        f'rosbag2_bagfile_information:\n  relative_file_paths: {TEXTS_OF_ALL_KINDS[kind]}\n'
    )
    with InTime():
        assert recordings_in(session) == [path]
        assert not listed_files(session)
        repair(tmp_path)


def test_fifos_are_not_waited_for(tmp_path):
    session = tmp_path / f'{repairing.SESSION_PREFIX}1'
    session.mkdir()
    path = crafted(session / 'run_0.mcap')
    os.mkfifo(session / 'metadata.yaml')
    with InTime():
        assert recordings_in(session) == [path]
        assert [each.action for each in repair(tmp_path)] == ['listed']
    os.mkfifo(session / 'run_1.mcap')
    with InTime():
        assert repair(tmp_path) == []
        with pytest.raises(UnreadableRecording, match='not a file'):
            read_departure(session / 'run_1.mcap')


def test_a_folder_on_which_repair_fails_stops_no_other_one(tmp_path, monkeypatch):
    for number in (1, 2):
        session = tmp_path / f'{repairing.SESSION_PREFIX}{number}'
        session.mkdir()
        crafted(session / 'run_0.mcap')
    listed = repairing.list_files

    def fails_on_the_first(folder):
        if folder.name.endswith('1'):
            raise RuntimeError
        return listed(folder)

    monkeypatch.setattr(repairing, 'list_files', fails_on_the_first)
    assert [each.action for each in repair(tmp_path)] == ['failed', 'listed']


def test_copies_that_were_recovered_are_not_counted_again(tmp_path):
    for name in ('run_1', 'run_1.recovered'):
        (tmp_path / name).mkdir()
        crafted(tmp_path / name / 'x.mcap')
    copy = tmp_path / 'run_1.recovered' / 'x.mcap'
    assert recordings_in(tmp_path) == [tmp_path / 'run_1' / 'x.mcap']
    assert recordings_in(copy.parent) == [copy]


@pytest.mark.parametrize('kind', [3, 6, 9, 12])
def test_headers_everywhere_take_no_time_of_the_square(kind):
    data = bytearray(b'\x89MCAP0\r\n' + b'\xff' * 50)
    while len(data) < 2**20:
        data += bytes([kind]) + max(0, 2**20 - len(data) - 100).to_bytes(8, 'little') + bytes(20)
    with InTime():
        assert whole_part(bytes(data))[1]
