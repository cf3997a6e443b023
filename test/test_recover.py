"""ambush_recover: what is whole in broken recordings is saved, and what is lost is said."""

import os
import random
import re
import shutil
import subprocess
import sys
from io import BytesIO
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.writer import IndexType, Writer
from recording_samples import (
    METADATA,
    START_NS,
    STRATEGY,
    assert_departure,
    read_with_mcap_ros2,
    read_with_rosbags,
    small_departure,
)

from ambush_planner.recording import Recorder, read_departure
from ambush_planner.recording.encoding import encode_departure
from ambush_planner.recording.mcap_content import read_content
from ambush_planner.recording.mcap_records import MAGIC
from ambush_planner.recording.recorder import COMPRESSIONS
from ambush_planner.recording.recovery import default_target
from ambush_planner.recording.salvage import salvage
from ambush_planner.tools import recover
from ambush_planner.tools.recover import main

SENT = small_departure()


def encoded(compression='zstd'):
    return encode_departure(SENT, METADATA, [STRATEGY], COMPRESSIONS[compression])


@pytest.fixture
def broken(tmp_path):
    """Writes bytes as a recording and returns its path."""

    def write(data, name='run_0.mcap'):
        path = tmp_path / name
        path.write_bytes(data)
        return path

    return write


def mode(path):
    return path.stat().st_mode & 0o777


def contents(data):
    """What a reader of its own finds: messages, metadata, attachments."""
    content = read_content(data)
    messages = [
        (content.channels[m.channel_id].topic, m.log_time, m.data) for m in content.messages
    ]
    return messages, content.metadata, content.attachments


def test_a_file_without_its_index_is_rebuilt_and_nothing_is_lost(broken, capsys):
    path = broken(encoded()[:-50])
    assert main([str(path)]) == 0
    recovered = path.with_name('run_0.recovered.mcap')
    assert_departure(SENT, read_with_mcap_ros2(recovered))
    assert_departure(SENT, read_with_rosbags(recovered))
    read = read_departure(recovered)
    assert read.metadata == METADATA
    assert read.attachments == {STRATEGY.name: STRATEGY.data}
    assert mode(recovered) == 0o600
    out = capsys.readouterr().out
    assert 'messages 4, metadata records 1, attachments 1' in out
    assert 'rebuilt: the index' in out


@pytest.mark.parametrize('name', ['run_0.mcap.tmp', 'run_0.mcap.broken', 'run_0.mcap.broken-2'])
def test_a_whole_temporary_file_is_copied(broken, name):
    path = broken(encoded(), name)
    assert main([str(path)]) == 0
    assert path.with_name('run_0.recovered.mcap').read_bytes() == encoded()


def test_a_whole_recording_needs_no_copy(broken, tmp_path, capsys):
    path = broken(encoded())
    assert main([str(path)]) == 0
    assert list(tmp_path.iterdir()) == [path]
    assert 'the file is whole' in capsys.readouterr().out
    assert main([str(path), '-o', str(tmp_path / 'copy.mcap')]) == 0
    assert (tmp_path / 'copy.mcap').read_bytes() == encoded()


def chunk_range(data):
    """Where the only chunk lies."""
    (index,) = make_reader(BytesIO(data)).get_summary().chunk_indexes
    return index.chunk_start_offset, index.chunk_start_offset + index.chunk_length


def test_of_a_damaged_chunk_what_unpacks_is_saved_and_said_to_be_unverified(broken, capsys):
    data = bytearray(encoded('none'))
    place = data.index(SENT[1].data) + 8
    data[place] ^= 1
    path = broken(data)
    assert main([str(path)]) == 1
    read = [m.data for m in read_departure(path.with_name('run_0.recovered.mcap')).messages]
    assert [one == m.data for one, m in zip(read, SENT, strict=True)] == [True, False, True, True]
    out = capsys.readouterr().out
    start, end = chunk_range(encoded('none'))
    assert 'messages 4 of 4' in out
    assert 'unverified: 4 of the messages' in out
    assert f'lost: bytes {start} to {end}: a damaged chunk; messages saved from it' in out


def test_a_file_cut_within_a_chunk_keeps_the_whole_messages_before(broken):
    data = encoded('none')
    cut = data.index(SENT[3].data) + 20
    assert main([str(broken(data[:cut]))]) == 1
    found = salvage(data[:cut])
    assert [message.data for message in found.content.messages] == [m.data for m in SENT[:3]]
    assert str(found.losses[-1]).endswith('the end is missing')


@pytest.mark.parametrize('compression', ['zstd', 'lz4', 'none'])
def test_any_truncation_ends_in_a_valid_file_or_a_clear_message(broken, capsys, compression):
    data = encoded(compression)
    generator = random.Random(11)
    for number in range(70):
        _recover_any(broken, capsys, data, data[: generator.randrange(len(data))], number)


@pytest.mark.parametrize('compression', ['zstd', 'lz4', 'none'])
def test_any_flipped_bit_ends_in_a_valid_file_or_a_clear_message(broken, capsys, compression):
    data = encoded(compression)
    generator = random.Random(12)
    for number in range(170):
        place = generator.randrange(8 * len(data))
        changed = bytearray(data)
        changed[place // 8] ^= 1 << place % 8
        _recover_any(broken, capsys, data, changed, number)


def _recover_any(broken, capsys, original, changed, number):
    path = broken(changed, f'run_{number}.mcap')
    code = main([str(path)])
    out, err = capsys.readouterr()
    assert code in (0, 1)
    assert err == ''
    assert ('lost: bytes' in out) == (code == 1)
    recovered = path.with_name(f'run_{number}.recovered.mcap')
    if not recovered.exists():
        assert 'nothing could be saved' in out
        return
    if code == 0:
        assert contents(recovered.read_bytes()) == contents(original)
    elif 'unverified' not in out and 'may be wrong' not in out:
        messages, _, attachments = contents(recovered.read_bytes())
        assert set(messages) <= set(contents(original)[0])
        assert all(each in contents(original)[2] for each in attachments)


@pytest.mark.parametrize('data', [
    b'', b'hello', MAGIC, MAGIC * 2, bytes(3000), os.urandom(3000), MAGIC + bytes(3000),
    MAGIC + os.urandom(3000) + MAGIC, b'\x06' * 3000, MAGIC + b'\x05\x16' + bytes(3000),
])
def test_garbage(broken, capsys, data):
    path = broken(data)
    assert main([str(path)]) == 1
    assert list(path.parent.iterdir()) == [path]
    assert 'nothing could be saved' in capsys.readouterr().out


def test_nothing_of_the_content_is_printed(broken, capsys):
    data = bytearray(encoded('none'))
    data[data.index(SENT[1].data) + 30] ^= 1
    main([str(broken(data))])
    out, err = capsys.readouterr()
    numbers = {int(number) for number in re.findall(r'\d+', out)}
    assert START_NS not in numbers
    assert not any(word in out + err for word in ('alpha_map', '/path', 'abab', 'PoseStamped'))


def test_nothing_is_overwritten(broken, tmp_path, capsys):
    path = broken(encoded()[:-50])
    target = tmp_path / 'run_0.recovered.mcap'
    target.write_text('mine')
    assert main([str(path)]) == 1
    assert 'already there' in capsys.readouterr().err
    with pytest.raises(SystemExit) as caught:
        main([str(path), '-o', str(target)])
    assert caught.value.code == 2
    assert target.read_text() == 'mine'
    assert path.read_bytes() == encoded()[:-50]


def test_inputs_and_outputs_that_are_not_there(broken, tmp_path, capsys):
    (tmp_path / 'empty').mkdir()
    path, nowhere = broken(encoded()[:-50]), tmp_path / 'none' / 'x.mcap'
    for arguments in ([str(nowhere)], ['/proc/self/mem'], [str(tmp_path / 'empty')],
                      [str(path), '-o', str(nowhere)]):
        assert main(arguments) == 1
        assert capsys.readouterr().err.startswith('ambush_recover: ')


def test_wrong_command_lines():
    for arguments in ([], ['a', 'b'], ['--fast', 'a']):
        with pytest.raises(SystemExit) as caught:
            main(arguments)
        assert caught.value.code == 2


@pytest.fixture
def session(tmp_path):
    """A session with two whole files, a damaged one, and two temporary ones."""
    with Recorder(tmp_path / 'runs') as recorder:
        paths = [recorder.record_departure(SENT, METADATA, [STRATEGY]) for _ in range(3)]
    folder = paths[0].parent
    data = bytearray(paths[2].read_bytes())
    (folder / f'{folder.name}_3.mcap.tmp').write_bytes(data[:-50])
    (folder / f'{folder.name}_4.mcap.tmp').write_bytes(data[:10])
    data[chunk_range(bytes(data))[0] + 60] ^= 255
    paths[2].write_bytes(data)
    return folder


def test_a_session_folder(session, capsys):
    before = {path: path.read_bytes() for path in session.iterdir()}
    assert main([str(session)]) == 1
    assert {path: path.read_bytes() for path in session.iterdir()} == before
    target = session.with_name(f'{session.name}.recovered')
    assert mode(target) == 0o700
    assert {mode(path) for path in target.iterdir()} == {0o600}
    names = {path.name for path in target.iterdir()}
    whole = {f'{session.name}_{number}.mcap' for number in (0, 1, 3)}
    assert whole | {'metadata.yaml'} <= names
    assert f'{session.name}_4.mcap' not in names
    for name in whole:
        assert read_departure(target / name).metadata == METADATA
    assert len(read_with_rosbags(target)) >= 12
    out = capsys.readouterr().out
    assert out.count('saved in') == len(names) - 1
    assert 'nothing could be saved' in out


def test_a_folder_of_sessions(session, tmp_path):
    shutil.copytree(session, session.with_name('other'))
    (session.parent / 'empty').mkdir()
    assert main([str(session.parent), '--output', str(tmp_path / 'out')]) == 1
    assert sorted(path.name for path in (tmp_path / 'out').iterdir()) == [session.name, 'other']
    for folder in (tmp_path / 'out').iterdir():
        assert len(read_with_rosbags(folder)) >= 12
        assert mode(folder) == 0o700


def test_a_loose_recording_hides_no_session(session, tmp_path):
    loose = session.parent / 'one.mcap'
    shutil.copy(session / f'{session.name}_1.mcap', loose)
    main([str(session.parent), '--output', str(tmp_path / 'out')])
    assert read_departure(tmp_path / 'out' / 'one.mcap').metadata == METADATA
    assert len(read_with_rosbags(tmp_path / 'out' / session.name)) >= 12


def test_two_files_of_one_name_are_both_kept(session):
    shutil.copy(session / f'{session.name}_1.mcap', session / f'{session.name}_1.mcap.tmp')
    main([str(session)])
    target = session.with_name(f'{session.name}.recovered')
    for name in (f'{session.name}_1.mcap', f'{session.name}_1-2.mcap'):
        assert read_departure(target / name).metadata == METADATA


def test_progress_goes_to_stderr(broken, capsys, monkeypatch):
    monkeypatch.setattr(recover, '_PROGRESS_SECONDS', 0.0)
    assert main([str(broken(encoded()[:-50]))]) == 0
    out, err = capsys.readouterr()
    assert re.search(r'^ambush_recover: run_0.mcap: \d+%$', err, re.MULTILINE)
    assert '%' not in out


def test_as_a_command(broken):
    path = broken(encoded()[:-50])
    environment = {**os.environ, 'PYTHONPATH': os.pathsep.join([
        str(Path(__file__).parents[1]), os.environ.get('PYTHONPATH', '')])}
    done = subprocess.run([sys.executable, '-m', 'ambush_planner.tools.recover', str(path)],
                          env=environment, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (0, '')
    assert 'run_0.recovered.mcap' in done.stdout


def without_summary(data):
    """The same valid file, but with no summary section."""
    stream = BytesIO()
    writer = Writer(stream, repeat_channels=False, repeat_schemas=False, use_statistics=False,
                    use_summary_offsets=False, index_types=IndexType.NONE)
    content = read_content(data)
    writer.start('ros2')
    for each in content.metadata:
        writer.add_metadata(each.name, each.metadata)
    for each in content.attachments:
        writer.add_attachment(0, each.log_time, each.name, each.media_type, each.data)
    for message in content.messages:
        channel = content.channels[message.channel_id]
        schema = content.schemas[channel.schema_id]
        schema = writer.register_schema(schema.name, schema.encoding, schema.data)
        number = writer.register_channel(channel.topic, 'cdr', schema, channel.metadata)
        writer.add_message(number, message.log_time, message.data, message.publish_time)
    none = writer.register_channel('/none', 'json', 0)
    writer.add_message(none, START_NS, b'{}', START_NS)
    writer.finish()
    return stream.getvalue()


def test_a_valid_file_without_a_summary_gets_one(session):
    path = session / f'{session.name}_0.mcap'
    path.write_bytes(without_summary(path.read_bytes()))
    assert main([str(session)]) == 1
    target = session.with_name(f'{session.name}.recovered')
    assert_departure(SENT, read_with_mcap_ros2(target / path.name))
    assert len(read_with_rosbags(target)) >= 12


def test_dots_name_folders_too(session, monkeypatch):
    monkeypatch.chdir(session)
    assert default_target(Path('.')) == session.with_name(f'{session.name}.recovered')
    above = session.parent
    assert default_target(Path('..')) == above.with_name(f'{above.name}.recovered')
    assert default_target(Path('/')) == Path('/.recovered')
