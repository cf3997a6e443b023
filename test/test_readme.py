"""README.md is short, its commands work, and they print the numbers that it names."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip('matplotlib', reason='the picture of routes needs matplotlib')

from audit_samples import departure, drawn, record, sample_plan
from test_tutorial import SECONDS, run_in_shell

ROOT = Path(__file__).resolve().parent.parent
TEXT = (ROOT / 'README.md').read_text()
BLOCKS = re.findall(r'(?ms)^```(\w+)\n(.*?)^```$', TEXT)
COMMANDS, PYTHON, _, ROS = (text for _, text in BLOCKS)


def test_it_is_short():
    assert len(TEXT.splitlines()) <= 90


@pytest.mark.slow
def test_the_commands_and_the_python_plan_with_the_values_that_are_named(tmp_path):
    (tmp_path / 'docs').symlink_to(ROOT / 'docs')
    *_, plan = COMMANDS.splitlines()  # after `make demo` and `make test`
    programs = (plan.replace('.venv/bin', str(Path(sys.executable).parent)).split(),
                [sys.executable, '-c', PYTHON])
    planned, printed = (subprocess.run(program, cwd=tmp_path, capture_output=True, text=True,
                                       check=True, timeout=240).stdout for program in programs)
    assert (tmp_path / 'routes.png').stat().st_size > 50_000
    value, known = re.search(r'mean loss of\s(\S+); .*?, (\d\.\d)', TEXT).groups()
    found = re.search(r'(?m)^value +([\d.]+):', planned)[1], printed.split()[0]
    assert [float(each) for each in found] == pytest.approx([float(value)] * 2, abs=0.005)
    assert f'would cost {known} once' in planned


@pytest.mark.slow
@pytest.mark.timeout(SECONDS + 60)
def test_the_quick_start_publishes_a_path(tmp_path):
    (tmp_path / 'ws/src').mkdir(parents=True)
    (tmp_path / 'ws/src/ambush_planner').symlink_to(ROOT)
    said = run_in_shell(f'set -m\n{ROS}kill %1\nwait', tmp_path)
    assert 'success=True' in said and 'nav_msgs.msg.Path(' in said


@pytest.mark.slow
def test_the_python_of_its_page_runs(tmp_path):
    a_plan = sample_plan()
    routes = enumerate(drawn(a_plan, 6))
    record(tmp_path / 'runs', [departure(a_plan, each, number=k) for k, each in routes])
    text = (ROOT / 'docs/python.md').read_text()
    page = '\n'.join(re.findall(r'(?ms)^```python\n(.*?)^```$', text))
    coarse = 'PlanningOptions(NetworkOptions(spacing=40.0))'  # as the page, but sooner
    page = page.replace('PlanningOptions()', coarse)
    page = page.replace('start, goal)', f'start, goal, {coarse})')
    given = 'pairs = [((15.0, 150.0), (385.0, 150.0)), ((385.0, 150.0), (15.0, 150.0))]\n'
    (tmp_path / 'page.py').write_text(given + page)
    done = subprocess.run([sys.executable, 'page.py'], cwd=tmp_path, capture_output=True, text=True,
                          timeout=240, check=False)
    assert done.returncode == 0, done.stderr
