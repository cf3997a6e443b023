"""More than a hundred manipulations of real recordings, in valid files: each is found and named."""

from dataclasses import replace

import numpy as np
import pytest
from forgeries import FORGERIES
from forgeries_hidden import NOT_COVERED
from forging import AGAIN, NEW_ROUTE, TEXTS, Forger, one_verifier, record_runs

from ambush_planner.commands import verify as tool
from ambush_planner.recordings import read_departure
from ambush_planner.recordings.mcap_file import decode, encode


@pytest.fixture(scope='module')
def files(tmp_path_factory):
    return record_runs(tmp_path_factory)


def verified(path, capsys):
    code = tool.main([str(path)])
    out, err = capsys.readouterr()
    assert 'Traceback' not in out + err
    return code, out


@pytest.fixture(scope='module', autouse=True)
def verifier():
    with one_verifier() as verifier:
        yield verifier


def test_the_untouched_recordings_hold(files, verifier):
    """So that it is the change that is found below."""
    assert all(verifier.verify(path).holds for path in files)


@pytest.mark.parametrize('number', range(len(FORGERIES)))
def test_a_forgery_is_found_and_named(number, files, tmp_path, verifier):
    which, forge, corrected, named = FORGERIES[number]
    forger = Forger(files[which])
    forge(forger, np.random.default_rng(number))
    if corrected:
        forger.correct()
    verifier._seen.clear()
    verdict = verifier.verify(forger.save(tmp_path / 'forged.mcap'))
    assert not verdict.holds
    assert named in '; '.join(verdict.problems)


@pytest.mark.parametrize('number', range(len(NOT_COVERED)))
def test_what_is_not_covered_is_named_in_the_help(number, files, tmp_path, verifier):
    which, forge, named = NOT_COVERED[number]
    forger = Forger(files[which])
    forge(forger, np.random.default_rng(number))
    forger.correct()
    verifier._seen.clear()
    verdict = verifier.verify(forger.save(tmp_path / 'forged.mcap'))
    assert verdict.holds, verdict.problems
    assert named in ' '.join(tool.EPILOG.split())


def test_two_departures_of_one_id_are_found(files, tmp_path, capsys):
    forger = Forger(files[AGAIN])
    forger.metadata['departure_id'] = read_departure(files[NEW_ROUTE]).metadata.id
    (tmp_path / 'run_0.mcap').write_bytes(files[NEW_ROUTE].read_bytes())
    forger.save(tmp_path / 'run_1.mcap')
    code, out = verified(tmp_path, capsys)
    assert code == 1
    assert out.splitlines()[1].startswith('holds')
    assert 'departure_id: it is also that of run_0.mcap' in out


def test_other_definitions_and_a_second_strategy_are_found(files, tmp_path, capsys):
    content = decode(files[NEW_ROUTE].read_bytes())
    for schema in content.schemas.values():
        if schema.name == 'nav_msgs/msg/Path':
            schema.data += b'# more'
    content.attachments.insert(0, replace(content.attachments[0], data=b'another'))
    (tmp_path / 'forged.mcap').write_bytes(encode(content))
    code, out = verified(tmp_path / 'forged.mcap', capsys)
    assert code == 1 and 'file: it is not laid out' in out


@pytest.mark.parametrize('seed', range(2))
def test_garbage_behind_correct_hashes_is_no_traceback(seed, files, tmp_path, capsys):
    """Bytes changed at random in messages, metadata or strategy, in valid files."""
    rng = np.random.default_rng(seed)
    for _ in range(20):
        forger = Forger(files[int(rng.integers(len(files)))])
        for _ in range(int(rng.integers(1, 4))):
            spoil(forger, rng)
        try:
            forger.correct()
        except Exception:  # What it would hash is gone: not every forger is clever.
            pass
        code, out = verified(forger.save(tmp_path / 'garbage.mcap'), capsys)
        # What has no effect may hold: a cell between the nodes, a compression.
        assert code in (0, 1, 3) and out.splitlines()[1].startswith(('holds', 'FAILS'))


def spoil(forger, rng):
    if (where := rng.integers(3)) == 0:
        place = int(rng.integers(len(forger.messages)))
        data = bytearray(forger.messages[place].data)
        data[int(rng.integers(4, len(data)))] ^= 1 << int(rng.integers(8))
        forger.messages[place] = replace(forger.messages[place], data=bytes(data))
    elif where == 1:
        key = str(rng.choice([*TEXTS, 'inputs', 'versions', 'departure', 'sha256']))
        text = forger.metadata[key]
        at = int(rng.integers(len(text)))
        new = str(rng.choice([*'-.:[]{}"9e#&*!', '~', '.nan', '1e300', '\n', '[', '\u2028']))
        forger.metadata[key] = text[:at] + new + text[at + 1:]
    else:
        arrays = forger.arrays()
        name = str(rng.choice(sorted(name for name in arrays if arrays[name].size)))
        values = np.array(arrays[name])
        changed = rng.choice([0, -1, 2**31, 7]) if values.dtype.kind == 'i' else rng.choice(
            [np.nan, np.inf, -1.0, 1e300, 0.0]
        )
        values.reshape(-1)[int(rng.integers(values.size))] = changed
        forger.set_arrays(**{name: values})
