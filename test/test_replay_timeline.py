"""Files in one timeline."""

from dataclasses import replace

from mcap.writer import CompressionType
from recording_samples import METADATA, STRATEGY, recorded, small_departure, trigger_events

from ambush_planner.recording import Recorder
from ambush_planner.recording.encoding import encode_departure
from ambush_planner.tools.replay_timeline import messages, timeline

SECOND = 10**9


def write(folder, name, stamps):
    """A recording with a message at each of the times [s]."""
    sample = small_departure()[0]
    sent = [replace(sample, stamp_ns=round(stamp * SECOND)) for stamp in stamps]
    with Recorder(folder / name) as recorder:
        return recorder.record_departure(sent, METADATA, [STRATEGY])


def refuse(error):
    raise error


def places(parts, start=0.0):
    return [
        at / SECOND for _, placed in messages(parts, round(start * SECOND), refuse)
        for at, _ in placed
    ]


def test_pauses_between_files_are_kept(tmp_path):
    paths = [write(tmp_path, 'a', [100, 101]), write(tmp_path, 'b', [4000, 4002])]
    assert places(timeline(paths, refuse)) == [0, 1, 3900, 3902]


def test_a_clock_that_jumped_back_is_no_pause(tmp_path):
    paths = [write(tmp_path, str(k), stamps) for k, stamps in
             enumerate([[5000, 5001], [0, 2], [1, 4], [10, 10]])]
    assert places(timeline(paths, refuse)) == [0, 1, 1, 3, 3, 6, 12, 12]


def test_what_comes_before_the_start_is_left_out(tmp_path):
    paths = [write(tmp_path, 'a', [0, 1, 2]), write(tmp_path, 'b', [10, 11])]
    parts = timeline(paths, refuse)
    assert places(parts, 1.5) == [2, 10, 11]
    assert places(parts, 10.0) == [10, 11]
    # Files before the start are not even read.
    paths[0].unlink()
    assert places(parts, 5.0) == [10, 11]


def test_an_unknown_type_or_no_message_is_told(tmp_path):
    sent = recorded('/x', trigger_events()[0])
    with Recorder(tmp_path) as recorder:
        good = recorder.record_departure([sent], METADATA)
    errors = []
    rude = tmp_path / 'rude.mcap'
    rude.write_bytes(encode_departure([recorded('/\x1b[2J', trigger_events()[0])], METADATA, [],
                                      CompressionType.NONE))
    assert timeline([rude], errors.append) == [] and str(errors.pop()).isprintable()
    strange = tmp_path / 'strange.mcap'
    strange.write_bytes(good.read_bytes().replace(b'std_srvs/srv/Trigger_Event', b'x' * 26))
    assert len(timeline([good], errors.append)) == 1 and not errors
    assert timeline([strange, tmp_path, tmp_path / 'none'], errors.append) == []
    assert [error.path for error in errors] == [strange, tmp_path, tmp_path / 'none']
