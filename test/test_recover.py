"""What ``ambush_recover`` saves: all whole records up to the first fault, and never the input."""

import json
import shutil

import numpy as np
import pytest
from damage import flips, truncations
from recording_samples import file_of, read_with_rosbags, record, small_departure

from ambush_planner.commands import recover as tool
from ambush_planner.recordings import Recorder
from ambush_planner.recordings.mcap_file import decode

SENT = small_departure()


def recovered(capsys, *arguments):
    """The exit code, and the result as JSON."""
    code = tool.main([*map(str, arguments), '--json'])
    out, err = capsys.readouterr()
    assert 'Traceback' not in out + err
    return code, json.loads(out) if out else err


@pytest.mark.parametrize('compression', ['zstd', 'lz4', 'none'])
def test_what_is_cut_off_is_saved_up_to_there(tmp_path, capsys, compression):
    data = file_of(SENT, compression)
    saved = []
    for number, part in enumerate(truncations(data, 40)):
        path = tmp_path / f'cut_{number}.mcap'
        path.write_bytes(part)
        code, result = recovered(capsys, path)
        (file,) = result['files']
        assert code == 1 and file['lost']
        assert path.read_bytes() == part
        saved.append((file['metadata'], file['attachments'], file['messages']))
        if file['saved']:
            content = decode((tmp_path / f'cut_{number}.recovered.mcap').read_bytes())
            assert [m.data for m in content.messages] == [
                m.data for m in SENT[: file['messages']]
            ]
    # Metadata come first, then the strategy, then the messages, which stand in one chunk.
    assert sorted(saved) == saved
    assert saved[0] == (0, 0, 0) and saved[-1] == (1, 1, 4)


def test_changed_bits_never_lead_to_other_messages(tmp_path, capsys):
    data = file_of(SENT)
    for number, changed in enumerate(flips(data, 150, np.random.default_rng(3))):
        path = tmp_path / f'flip_{number}.mcap'
        path.write_bytes(changed)
        code, result = recovered(capsys, path)
        assert code in (0, 1)
        if result['files'][0]['saved']:
            content = decode((tmp_path / f'flip_{number}.recovered.mcap').read_bytes())
            assert [m.data for m in content.messages] in ([], [m.data for m in SENT])


def test_a_whole_file_needs_no_copy(tmp_path, capsys):
    path = tmp_path / 'x.mcap'
    path.write_bytes(file_of(SENT))
    code, result = recovered(capsys, path)
    assert (code, result['files'][0]['saved']) == (0, None)
    assert list(tmp_path.iterdir()) == [path]
    assert recovered(capsys, path, '-o', tmp_path / 'y.mcap')[0] == 0
    assert (tmp_path / 'y.mcap').read_bytes() == path.read_bytes()
    assert (tmp_path / 'y.mcap').stat().st_mode & 0o777 == 0o600


def test_a_folder_becomes_a_bag_with_all_that_is_whole(tmp_path, capsys):
    with Recorder(tmp_path / 'runs') as recorder:
        paths = [record(recorder, SENT) for _ in range(3)]
    session = paths[0].parent
    paths[1].write_bytes(paths[1].read_bytes()[:-100])
    shutil.copy(paths[2], session / f'{session.name}_3.mcap.tmp')
    before = {path: path.read_bytes() for path in session.iterdir()}
    code, result = recovered(capsys, tmp_path / 'runs')
    assert code == 1
    assert [bool(file['lost']) for file in result['files']] == [False, True, False, False]
    assert {path: path.read_bytes() for path in session.iterdir()} == before
    copy = tmp_path / 'runs.recovered' / session.name
    assert (copy / paths[0].name).read_bytes() == paths[0].read_bytes()
    assert len(read_with_rosbags(copy)) == 16
    with pytest.raises(SystemExit) as stop:
        tool.main([str(tmp_path / 'runs')])
    assert stop.value.code == 2


def test_nothing_is_overwritten(tmp_path, capsys):
    path = tmp_path / 'x.mcap'
    path.write_bytes(file_of(SENT)[:-5])
    taken = tmp_path / 'x.recovered.mcap'
    taken.write_text('mine')
    for arguments in ([path], [path, '-o', taken]):
        with pytest.raises(SystemExit) as stop:
            tool.main([*map(str, arguments)])
        assert stop.value.code == 2
    assert taken.read_text() == 'mine'


def test_what_is_no_recording(tmp_path, capsys):
    assert recovered(capsys, tmp_path / 'none')[0] == 3
    (tmp_path / 'x.mcap').write_text('hello')
    code, result = recovered(capsys, tmp_path / 'x.mcap')
    assert code == 1 and result['files'][0]['saved'] is None
    (tmp_path / 'empty').mkdir()
    assert recovered(capsys, tmp_path / 'empty')[0] == 3
