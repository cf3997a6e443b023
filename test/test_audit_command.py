# SPDX-License-Identifier: Apache-2.0
"""``ambush audit`` on recordings: verdicts, exit codes, JSON, the picture, bad input."""

import re
import shutil

import numpy as np
import pytest

pytest.importorskip('matplotlib', reason='pictures need matplotlib')

from audit_samples import departure, drawn, parameters, record, record_drawn, sample_plan

from ambush_planner.commands import audit


@pytest.fixture(scope='module')
def a_plan():
    return sample_plan()


@pytest.fixture(scope='module')
def good(tmp_path_factory):
    folder = tmp_path_factory.mktemp('good')
    record_drawn(folder, 12, seed=2)
    return folder


def recorded(folder, a_plan, routes, entries=lambda k: ()):
    record(folder, [departure(a_plan, r, k, entries=entries(k)) for k, r in enumerate(routes)])
    return folder


def run(capsys, *arguments):
    """Exit code, and the output as one line; no route and no traceback is ever printed."""
    code = audit.main([*map(str, arguments)])
    output, errors = capsys.readouterr()
    assert not re.search(r'\d+, \d+, \d+, \d+|\d{30}', output + errors)
    assert 'Traceback' not in output + errors and '\x1b' not in output + errors
    return code, ' '.join(output.split())


def test_good_departures_pass(good, capsys):
    before = set(good.iterdir())
    code, text = run(capsys, good)
    assert code == 0 and 'Nothing suspicious' in text and 'FINDING' not in text
    assert '12 departures, 2023-11-15 22:13:20 UTC to 2023-11-26 22:13:20 UTC' in text
    assert re.search(r'caused [\d.]+ per departure\. Honest draws of 12 departures give .* in nine '
                     r'cases of ten, so this is normal\. .* the value, 0\.373, on', text)
    assert 'the times' not in text
    assert set(good.iterdir()) == before
    assert audit.main([str(good), '--quiet']) == 0
    assert capsys.readouterr() == ('', '')
    with pytest.raises(SystemExit):
        audit.main([str(good), '-o', 'out'])
    assert 'audit -o was removed: the console says what it finds' in capsys.readouterr().err


def test_a_finding_exits_1(tmp_path, a_plan, capsys):
    routes = [*drawn(a_plan, 1) * 6, np.delete(drawn(a_plan, 1)[0], 4)]
    code, text = run(capsys, recorded(tmp_path / 'in', a_plan, routes))
    assert code == 1 and 'Nothing suspicious' not in text
    assert 'FINDING: 1 steps or ends of routes cannot have been drawn' in text


def test_too_few_departures_and_strategies_with_cycles_exit_4(tmp_path, a_plan, capsys):
    few = recorded(tmp_path / 'few', a_plan, drawn(a_plan, 4))
    code, text = run(capsys, few)
    assert code == 4 and 'Not enough data: at least 5 departures' in text
    cyclic = sample_plan('interior_point')
    entries = {'parameters': parameters(**{'strategy.solver': 'interior_point'})}
    record(tmp_path / 'mixed', [
        *(departure(a_plan, r, k) for k, r in enumerate(drawn(a_plan, 6))),
        departure(cyclic, drawn(cyclic, 1)[0], 30, entries=entries),
    ])
    code, text = run(capsys, tmp_path / 'mixed')
    assert code == 4 and 'because their strategies have cycles: 1 departure.' in text


def test_unreadable_files_exit_3_unless_there_is_a_finding(good, tmp_path, a_plan, capsys):
    folder = shutil.copytree(good, tmp_path / 'in')
    (folder / 'broken\x1b[2J.mcap').write_bytes(b'nothing')
    code, text = run(capsys, folder)
    assert code == 3 and 'Nothing suspicious' in text
    assert 'UNREADABLE and not audited' in text and 'broken\\x1b[2J.mcap' in text
    stuck = recorded(tmp_path / 'stuck', a_plan, drawn(a_plan, 1) * 6)
    (stuck / 'broken.mcap').write_bytes(b'nothing')
    assert run(capsys, stuck)[0] == 1
