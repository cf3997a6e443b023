# SPDX-License-Identifier: Apache-2.0
"""README.md is short, its commands work, and they print the numbers that it names."""

import re
import subprocess
import sys

import pytest

pytest.importorskip('matplotlib', reason='the picture of routes needs matplotlib')

from audit_samples import record_drawn
from commands import ROOT, blocks, run_python
from test_tutorial import run_in_shell

TEXT = (ROOT / 'README.md').read_text()
COMMANDS, PYTHON = (blocks('README.md', kind)[0] for kind in ('sh', 'python'))
ROS = blocks('docs/ros_interface.md', 'sh')[0]


def named_value():
    return float(re.search(r'(?m)^value +([\d.]+):', TEXT)[1])


@pytest.mark.slow
def test_the_commands_and_the_python_plan_with_the_values_that_are_named(tmp_path):
    (tmp_path / 'docs').symlink_to(ROOT / 'docs')
    *_, plan, draw = COMMANDS.splitlines()  # after the installation
    ambush = [sys.executable, '-m', 'ambush_planner.commands.cli']
    # With more time, for a machine that does other things.
    patient = PYTHON.replace('(game=', '(strategy=StrategyOptions(time_limit=1e3), game=').replace(
        'import GameOptions', 'import StrategyOptions, GameOptions')
    programs = ([*ambush, *plan.split()[1:], '--set', 'strategy.time_limit=1e3'],
                [*ambush, *draw.split()[1:]], [sys.executable, '-c', patient])
    planned, drawn, printed = (subprocess.run(program, cwd=tmp_path, capture_output=True, text=True,
                                          check=True).stdout for program in programs)
    assert (tmp_path / 'out/routes.png').stat().st_size > 50_000
    for name in ('week.plan', 'card.html', 'week.departures/0001_*.mcap'):
        (file,) = (tmp_path / 'out').glob(name)
        assert file.stat().st_mode & 0o777 == 0o600
    assert re.search(r'(?m)^\d{4}-\d\d-\d\d: [\d.]+ m$', drawn)
    for pattern in (r'(?m)^value +([\d.]+):', r'(?m)^shortest route +([\d.]+),'):
        named, found = (float(re.search(pattern, text)[1]) for text in (TEXT, planned))
        assert named == pytest.approx(found, abs=0.02)
    assert float(printed.split()[0]) == pytest.approx(named_value(), abs=0.005)


@pytest.mark.slow
def test_the_quick_start_publishes_a_path(tmp_path):
    (tmp_path / 'ws/src').mkdir(parents=True)
    (tmp_path / 'ws/src/ambush_planner').symlink_to(ROOT)
    said = run_in_shell(f'set -m\n{ROS}kill %1\nwait', tmp_path)
    assert 'success=True' in said and 'nav_msgs.msg.Path(' in said


@pytest.mark.slow
def test_the_python_of_its_page_runs(tmp_path):
    record_drawn(tmp_path / 'runs', 6)
    page = '\n'.join(blocks('docs/python.md', 'python'))
    given = 'pairs = [((15.0, 150.0), (385.0, 150.0)), ((385.0, 150.0), (15.0, 150.0))]\n'
    done = run_python(given + page, tmp_path)
    assert done.returncode == 0, done.stderr
