"""What nobody sees in one recording: the chain of all of them, their folder, their sources."""

import json
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from forging import GET_PLAN, NEW_ROUTE, Forger, one_verifier, record_runs
from mcap.records import Channel, Schema
from ros_harness import pose, stage
from two_faced import assembled, encoded, split

from ambush_planner.commands import verify as tool
from ambush_planner.recordings import read_departure, reader, recorder, recordings_in
from ambush_planner.recordings import recorded_case as case
from ambush_planner.recordings.chain import together
from ambush_planner.recordings.mcap_file import decode, encode
from ambush_planner.recordings.metadata import Link


@pytest.fixture(scope='module')
def recorded(tmp_path_factory):
    return record_runs(tmp_path_factory)


@pytest.fixture(scope='module', autouse=True)
def verifier():
    with one_verifier() as verifier:
        yield verifier


@pytest.fixture
def runs(recorded, tmp_path):
    """A copy of the recording.directory with its two sessions, of four and two departures."""
    return shutil.copytree(recorded[0].parent.parent, tmp_path / 'runs')


@pytest.fixture
def check(capsys):
    """The command's exit code and its result as JSON; solves are kept between calls."""
    def result(*arguments):
        code = tool.main([*map(str, arguments), '--json'])
        out, err = capsys.readouterr()
        assert 'Traceback' not in out + err
        return code, json.loads(out)

    return result


def test_each_file_states_the_hash_of_the_one_before_it(runs):
    files = [read_departure(path) for path in recordings_in(runs)]
    assert len(files) == 6
    before = ''
    for each in files:
        link = each.metadata.link
        assert (link.file, link.sha256) == (each.path.name, before)
        before = each.sha256
    assert files[4].metadata.link.follows == files[3].path.name  # of the session before


def test_the_untouched_folders_hold(runs, check):
    code, found = check(runs)
    assert (code, found['findings'], found['notes']) == (0, [], [])
    assert len(found['departures']) == 6
    assert found['newest_sha256'] == read_departure(recordings_in(runs)[-1]).sha256


def delete(files):
    files[1].unlink()
    return files[1].name, 'is missing'


def delete_the_last_of_a_session(files):
    files[3].unlink()
    return files[3].name, 'is missing'


def delete_the_first(files):
    files[0].unlink()
    return files[0].name, 'is missing'


def exchange(files):
    forger = Forger(files[1])
    forger.metadata['versions'] = '{"python": "3.0"}'
    forger.correct()
    forger.save(files[1])
    return files[1].name, 'is exchanged'


def swap(files):
    one, two = files[1].read_bytes(), files[2].read_bytes()
    files[1].write_bytes(two)
    files[2].write_bytes(one)
    return files[1].name, 'is moved'


def rename(files):
    files[3].rename(files[3].with_name(files[3].name.replace('_3.mcap', '_7.mcap')))
    return files[3].name.replace('_3.mcap', '_7.mcap'), 'is moved'


def insert(files):
    """Another departure after the same one, under a number of its own."""
    new = files[1].with_name(files[1].name.replace('_1.mcap', '_9.mcap'))
    forger = Forger(files[1])
    forger.metadata['departure_id'] = '0' * 36
    forger.set_entry('chain', {**forger.entry('chain'), 'file': new.name})
    forger.save(new)
    return new.name, 'follow the same file: one of them is inserted'


def insert_without_a_predecessor(files):
    new = files[1].with_name(files[1].name.replace('_1.mcap', '_1a.mcap'))
    forger = Forger(files[1])
    forger.set_entry('chain', {'file': new.name, 'follows': '', 'sha256': ''})
    forger.save(new)
    return new.name, 'is inserted'


def renumber(files):
    """The second one taken away, and those behind it named as if it had never been."""
    files[1].unlink()
    files[2].rename(files[1])
    files[3].rename(files[2])
    return files[1].name, 'is moved'


def copy(files):
    shutil.copy(files[1], files[1].with_name('copy_1.mcap'))
    return 'copy_1.mcap', 'is moved'


def break_the_middle(files):
    data = bytearray(files[1].read_bytes())
    data[len(data) // 2] ^= 4
    files[1].write_bytes(data)
    return files[1].name, 'is exchanged'


def another_name_of_the_one_before(files):
    """In the newest file, whose hash no later one states."""
    forger = Forger(files[-1])
    forger.set_entry('chain', {**forger.entry('chain'), 'follows': files[0].name})
    forger.save(files[-1])
    return files[-1].name, 'states another name of the file before it'


def number_of_another(files):
    """The newest departure under the number of the one before it, in all that tells it."""
    forger = Forger(files[-1])
    forger.metadata['departure'] = '1'
    forger.save(files[-1])
    return files[-1].name, 'has the number of'


@pytest.mark.parametrize('manipulate', [
    another_name_of_the_one_before, number_of_another,
    delete, delete_the_last_of_a_session, delete_the_first, exchange, swap, rename, insert,
    insert_without_a_predecessor, renumber, copy, break_the_middle,
], ids=lambda each: each.__name__)
def test_what_is_done_to_the_files_is_found_and_named(runs, check, manipulate):
    name, said = manipulate(recordings_in(runs))
    code, found = check(runs)
    assert code == 1
    assert any(name in each and said in each for each in found['findings']), found['findings']


def test_a_session_whose_predecessor_is_elsewhere_is_told_so(runs, check):
    files = recordings_in(runs)
    shutil.rmtree(files[0].parent)
    code, found = check(runs)
    assert (code, found['findings']) == (0, [])
    assert f'follows {files[3].name}, which is not here' in found['notes'][0]


def test_the_last_file_is_missed_by_a_hash_noted_elsewhere(runs, check):
    files = recordings_in(runs)
    noted = check(runs)[1]['newest_sha256']
    assert check(runs, '--expect', noted)[0] == 0
    early = read_departure(files[2]).sha256
    code, found = check(runs, '--expect', early.upper())
    assert code == 0 and '3 recordings are newer' in found['notes'][0]
    files[-1].unlink()
    (files[-1].parent / 'metadata.yaml').unlink()
    assert check(runs)[0] == 0  # as --help says
    code, found = check(runs, '--expect', noted)
    assert code == 1 and 'expected hash is not here' in found['findings'][0]


@pytest.mark.skipif(not shutil.which('ssh-keygen'), reason='ssh-keygen is not installed')
def test_the_commands_of_the_readme_sign_the_newest_hash(runs, tmp_path):
    """As they stand there, but for the names of the folder, of the key and of who signs."""
    root = Path(__file__).resolve().parent.parent
    texts = [path.read_text() for path in (root / 'README.md', *sorted(root.glob('docs/*.md')))]
    (block,) = [
        each for text in texts for each in re.findall(r'```sh\n(.*?)```', text, re.DOTALL)
        if 'ssh-keygen -Y sign' in each
    ]
    shutil.rmtree(recordings_in(runs)[0].parent)  # the two of the other session are enough
    key = tmp_path / 'key'
    subprocess.run(['ssh-keygen', '-q', '-t', 'ed25519', '-N', '', '-f', key], check=True)
    (tmp_path / 'signers').write_text(f'me {key.with_suffix(".pub").read_text()}')
    for name, real in (('RUNS', runs), ('~/.ssh/id_ed25519', key), ('-I NAME', '-I me')):
        assert name in block
        block = block.replace(name, str(real))
    shell = f'ambush() {{ "{sys.executable}" -m ambush_planner.commands.cli "$@"; }}\n{block}'

    def run():
        return subprocess.run(['sh', '-e', '-c', shell], cwd=tmp_path, capture_output=True,
                              text=True, timeout=110, check=False)

    done = run()
    assert done.returncode == 0, done.stderr
    assert 'Good "ambush_planner" signature for me' in done.stdout
    assert '2 departures: all hold' in done.stdout
    (tmp_path / 'newest').write_text('0' * 64)  # another hash than was signed
    shell = shell[shell.index('ssh-keygen -Y verify'):]
    assert run().returncode != 0


def test_sessions_of_two_nodes_may_have_chains_of_their_own(tmp_path, check, monkeypatch):
    class Frozen(datetime):
        """Both nodes start in the same second."""

        @classmethod
        def now(cls, tz=None):
            return cls(2026, 1, 2, 3, 4, 5, tzinfo=tz)

    monkeypatch.setattr(recorder, 'datetime', Frozen)
    for folder in ('first', 'second'):
        with stage(tmp_path / folder) as running:
            assert running.give().call('new_route').success
    one, two = (recordings_in(tmp_path / folder)[0] for folder in ('first', 'second'))
    joined = tmp_path / 'runs'
    joined.mkdir()
    for name, path in (('first', one), ('second', two)):
        shutil.copytree(path.parent, joined / name)
    code, found = check(joined)
    assert code == 0, found
    assert 'begins a chain of its own' in found['notes'][0]


@pytest.mark.parametrize(('change', 'said'), [
    (lambda names: names[:-1], 'is there, but metadata.yaml does not name it'),
    (lambda names: [*names, 'gone_1.mcap'], 'is not there, but metadata.yaml names it'),
    (lambda names: [*names, names[0]], 'names a file twice'),
    (lambda names: 3, 'lists no files'),
])
def test_metadata_yaml_names_just_the_files_that_are_there(runs, check, change, said):
    path = recordings_in(runs)[0].parent / 'metadata.yaml'
    document = json.loads(path.read_text())
    root = document['rosbag2_bagfile_information']
    root['relative_file_paths'] = change(root['relative_file_paths'])
    path.write_text(json.dumps(document))
    code, found = check(runs)
    assert code == 1 and said in found['findings'][0]


@pytest.mark.parametrize(('key', 'value'), [
    ('message_count', 7), ('custom_data', {'by': 'me'}), ('duration', {'nanoseconds': 1}),
    ('topics_with_message_count', []), ('approved', 'yes'),
])
def test_metadata_yaml_says_what_is_in_the_files(runs, check, key, value):
    path = recordings_in(runs)[0].parent / 'metadata.yaml'
    document = json.loads(path.read_text())
    document['rosbag2_bagfile_information'][key] = value
    path.write_text(json.dumps(document))
    code, found = check(runs)
    assert code == 1 and f'{key} is not that of the files' in found['findings'][0]


def test_a_folder_that_rosbag2_listed_anew_holds(runs, check):
    folder = recordings_in(runs)[0].parent
    names = ''.join(f'    - {path.name}\n' for path in recordings_in(folder))
    (folder / 'metadata.yaml').write_text(
        f'rosbag2_bagfile_information:\n  version: 9\n  relative_file_paths:\n{names}  files: []\n'
    )
    assert check(runs)[0] == 0


def test_a_stuck_random_source_is_found_though_each_file_holds(tmp_path, check, monkeypatch):
    """The operating system's entropy at one value, the start moving: all follows from it."""
    monkeypatch.setattr('secrets.randbits', lambda bits: 2**255 + 7)
    with stage(tmp_path) as running:
        client = running.give()
        for k in range(3):
            assert client.get_plan(pose(1.5 + 0.01 * k, 5.5), pose(8.5, 5.5)).poses
    code, found = check(tmp_path)
    assert code == 1 and all(each['holds'] for each in found['departures'])
    assert sum('random source is the same' in each for each in found['findings']) == 2


# Manipulations of one file that leave the departure as it is


def content_of(path, change):
    """Write a file with another content, with valid checksums and indexes."""
    content = decode(path.read_bytes())
    change(content)
    path.write_bytes(encode(content))


def channel_of_another(content):
    content.schemas[99] = Schema(99, b'string text', 'ros2msg', 'a/msg/B')
    content.channels[99] = Channel(99, '/other', 'cdr', {}, 99)
    content.messages.append(replace(content.messages[0], channel_id=99))


def channel_metadata(content):
    next(iter(content.channels.values())).metadata['approved'] = 'yes'


def quality_of_service_text(content):
    metadata = next(iter(content.channels.values())).metadata
    metadata['offered_qos_profiles'] = '# approved\n' + metadata['offered_qos_profiles']


def publish_time(content):
    content.messages[2] = replace(content.messages[2], publish_time=5)


def sequence(content):
    content.messages[2] = replace(content.messages[2], sequence=7)


def attachment_created(content):
    content.attachments[0] = replace(content.attachments[0], create_time=10**18)


def attachment_logged(content):
    content.attachments[0] = replace(content.attachments[0], log_time=1)


def attachment_kind(content):
    content.attachments[0] = replace(content.attachments[0], media_type='text/plain')


def more_metadata(content):
    content.metadata.append(replace(content.metadata[0], name='notes', metadata={'by': 'me'}))


def other_profile(content):
    content.profile = 'ros2 approved'


def order_of_messages(content):
    content.messages[0], content.messages[-1] = content.messages[-1], content.messages[0]


def type_hash(content):
    next(iter(content.channels.values())).metadata['topic_type_hash'] = 'RIHS01_' + '0' * 64


MANIPULATIONS = {
    channel_of_another: 'quality-of-service',
    channel_metadata: 'file: it is not laid out',
    quality_of_service_text: "quality of service's text",
    publish_time: 'file: it is not laid out',
    sequence: 'file: it is not laid out',
    attachment_created: 'file: it is not laid out',
    attachment_logged: 'file: it is not laid out',
    attachment_kind: 'file: it is not laid out',
    more_metadata: 'file: it is not laid out',
    other_profile: 'file: it is not laid out',
    order_of_messages: 'file: it is not laid out',
    type_hash: 'file: it is not laid out',
}


@pytest.mark.parametrize('change', MANIPULATIONS, ids=lambda each: each.__name__)
def test_what_stands_around_a_departure_is_checked(recorded, tmp_path, verifier, change):
    path = shutil.copy(recorded[GET_PLAN], tmp_path / 'x.mcap')
    content_of(path, change)
    verdict = verifier.verify(path)
    assert any(MANIPULATIONS[change] in each for each in verdict.problems), verdict.problems


def test_a_channel_without_messages_is_found(recorded, tmp_path, verifier):
    section, summary = split(recorded[NEW_ROUTE].read_bytes())
    extra = encoded(Channel(77, '/hidden', 'cdr', {'note': 'x'}, 1))
    path = tmp_path / 'x.mcap'
    path.write_bytes(assembled(
        [*(raw for _, raw, _ in section), extra], [*(raw for _, raw, _ in summary), extra]
    ))
    assert not verifier.verify(path).holds


def short_source(forger):
    forger.set_entry('route_entropy_source', [3])


def test_a_short_random_source_is_found(recorded, tmp_path, verifier):
    forger = Forger(recorded[NEW_ROUTE])
    short_source(forger)
    forger.correct()
    problems = verifier.verify(forger.save(tmp_path / 'x.mcap')).problems
    assert 'route_entropy_source: it has fewer than 192 bits' in problems


def test_names_of_files_cannot_write_to_the_terminal(recorded, tmp_path, capsys):
    path = tmp_path / 'a\x1b[2Jb\n.mcap'
    path.write_bytes(recorded[NEW_ROUTE].read_bytes()[:-9])
    assert tool.main([str(path)]) == 3
    out, err = capsys.readouterr()
    assert '\x1b' not in out + err and 'a\\x1b[2Jb\\n.mcap' in out


def test_cells_that_the_network_was_built_from_are_covered(recorded, tmp_path, verifier):
    """Any change that alters an edge or a node's loss is found; what does not is no matter."""
    rng = np.random.default_rng(4)
    found = 0
    for number in range(12):
        forger = Forger(recorded[NEW_ROUTE])
        grid = forger.message(forger.place('map'))
        cell = int(rng.integers(len(grid.data)))
        new = 100 if grid.data[cell] != 100 else 0
        forger.edit(forger.place('map'), lambda m, c=cell, v=new: m.data.__setitem__(c, v))
        forger.correct()
        verdict = verifier.verify(forger.save(tmp_path / f'{number}.mcap'))
        found += not verdict.holds
        verifier._seen.clear()
    assert found > 2


def test_each_file_and_each_message_is_decoded_once(runs, verifier, monkeypatch):
    files, messages = [], []
    for module, name, calls in ((reader, 'decode', files), (case, '_deserialised', messages)):
        original = getattr(module, name)
        monkeypatch.setattr(
            module, name, lambda each, of=original, to=calls: (to.append(each), of(each))[1]
        )
    paths = recordings_in(runs)
    verdicts = [verifier.verify(path) for path in paths]
    together(verdicts)
    assert files == [path.read_bytes() for path in paths]
    assert 0 < len(messages) == len(set(map(id, messages)))


def test_names_are_relative_to_where_the_command_is_run(runs, check, monkeypatch):
    monkeypatch.chdir(runs.parent)
    code, found = check('runs')
    assert code == 0
    assert [each['file'] for each in found['departures']] == [
        str(path.relative_to(runs.parent)) for path in recordings_in(runs)
    ]


def test_departures_that_were_not_recorded_are_noted_also_before_the_first():
    def recorded(session, number, follows=''):
        place = Path(session, f'{session}_{number}.mcap')
        metadata = SimpleNamespace(link=Link(follows=follows, sha256=follows))
        return SimpleNamespace(path=place, sha256=place.name, number=number, metadata=metadata)

    verdicts = [recorded('a', 3), recorded('a', 5, 'a_3.mcap'), recorded('b', 6, 'a_5.mcap'),
                recorded('c', 1, 'b_6.mcap'), recorded('d', 2, 'c_1.mcap'), recorded('e', 4)]
    told = [note.partition(';')[0] for note in tool._gaps(verdicts)]
    assert told == [
        'a: no recording of departures before 3',
        'a: no recording of departures after 3 and before 5',
        'e: no recording of departures before 4',
    ]
