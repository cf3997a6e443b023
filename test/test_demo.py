# SPDX-License-Identifier: Apache-2.0
"""``ambush demo``: its recordings, pictures and numbers, and the node that it starts and stops."""

import os
import signal
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('matplotlib', reason='the demo draws pictures')

from commands import ROOT, documented_keys
from matplotlib.image import imread

from ambush_planner import StrategyOptions
from ambush_planner.commands import cli
from examples.demo import __main__ as demo
from examples.demo.client import DemoClient
from examples.demo.ground import GOAL, START
from examples.demo.node_process import NodeFailed, NodeProcess, free_domain

DEPARTURES = 3
pytestmark = pytest.mark.slow


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp('demo') / 'new folder: 1'


@pytest.fixture(scope='module')
def done(folder):
    """The demo's output and result, on a quarter of its nodes and with two budgets for five."""
    out, err = StringIO(), StringIO()
    options = demo.parser().parse_args(['-o', str(folder), '-n', str(DEPARTURES)])
    before = signal.getsignal(signal.SIGTERM)
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
        for name, value in {'NETWORK': {'network.spacing': 1000.0, 'network.refine': 0},
                            'DETOURS': (1.2,), 'SLACKS': (0.01,)}.items():
            patch.setattr(demo, name, value)
        console = cli.Console('demo', as_json=False, quiet=False)
        assert demo._work(options, console) == cli.Exit.HOLDS
    signal.signal(signal.SIGTERM, before)
    return out.getvalue(), err.getvalue(), console.result


def test_files_are_private_and_the_picture_is_not_blank(done, folder):
    files = sorted(folder.rglob('*.mcap'))
    assert len(files) == DEPARTURES  # the demo has verified them
    for file in (*files, *folder.glob('*.png'), folder / 'report.html'):
        assert file.stat().st_mode & 0o777 == 0o600
    picture = imread(folder / 'routes.png')
    assert picture.shape[0] > 700 and picture.shape[1] > 1350
    assert picture.std() > 0.1


def test_table_frontier_and_progress_agree_with_the_result(done, folder):
    out, err, result = done
    rows = {line[:37].strip(): line[38:] for line in out.splitlines() if line}
    value, bound = result['value'], result['lower_bound']
    assert 0.0 < bound <= value <= bound * (1.0 + StrategyOptions().risk_slack + 1e-5)
    assert float(rows['mean loss, at most (value)']) == pytest.approx(value, rel=1e-3)
    assert result['departures'] == DEPARTURES
    assert {'verdict', *result} == documented_keys(demo)
    times = [float(line.split()[0]) for line in err.splitlines() if line[5:9] == ' s  ']
    assert len(times) >= DEPARTURES + 4 and times == sorted(times)
    assert value < float(rows['always the route of least risk'].split()[2])
    different, total = map(int, rows['different routes'].split(' of '))
    assert DEPARTURES - 1 <= different <= total == DEPARTURES
    assert (folder / 'frontier.csv').read_text().startswith('swept,')


def test_error_of_a_node_that_cannot_start_has_its_last_lines(tmp_path):
    with free_domain() as domain:
        node = NodeProcess({'network.spacing': -1.0}, domain, tmp_path / 'log')
        with pytest.raises(NodeFailed, match=r'(?s)exit code 1.*network\.spacing'):
            with node, DemoClient(domain, node.check) as client:
                client.publish_inputs(np.zeros((2, 2), np.int8), 1.0, START, GOAL)


def test_interrupted_demo_stops_its_node(tmp_path):
    process = subprocess.Popen(
        [sys.executable, '-m', 'examples.demo', '-o', str(tmp_path)], cwd=ROOT,
        env={**os.environ, 'ROS_LOG_DIR': str(tmp_path)}, stderr=subprocess.PIPE, text=True,
    )
    while 'departure 1 of 8' not in process.stderr.readline():
        assert process.poll() is None
    assert nodes_of(tmp_path)
    process.send_signal(signal.SIGTERM)
    _, errors = process.communicate()
    assert (process.returncode, errors.splitlines()[-1]) == (130, 'ambush demo: interrupted')
    assert not nodes_of(tmp_path)


def nodes_of(folder):
    """Return the process ids of nodes that record into ``folder``."""
    found = []
    for entry in Path('/proc').glob('[0-9]*/cmdline'):
        try:
            words = entry.read_bytes()
        except OSError:  # the process has just ended
            continue
        if b'ros.program' in words and str(folder).encode() in words:
            found.append(entry.parent.name)
    return found
