# SPDX-License-Identifier: Apache-2.0
"""Smoke run: every benchmark runs on tiny inputs and writes its block."""

import os
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import interfaces
import pytest

BENCHMARKS = Path(__file__).resolve().parent.parent / 'benchmarks'
pytestmark = pytest.mark.slow

SCRIPTS = {
    'ground': f'--family yard --seed 3 --ways default --before {BENCHMARKS.parent}',
    'limits': '--families gates --each 1 --limits 300 --busy 1 --seed 1',
    'others': '--families hills-coarse --each 1 --nodes 80 --seed 1',
    'random_games': '--first 57 --count 4',
    'solver': '--kinds plan --sizes 100 --each 1 --families gates --seed 1 --limit 60 --changes 1',
}
NODE_SCRIPTS = {
    'node_fuzz': '--messages 20 --seed 3',
    'node_latency': '--calls 2 --nodes 400 --seconds 0.6 --cells 200',
}
if not interfaces._missing():
    NODE_SCRIPTS['node_motion'] = '--trips 1 --speeds 6'


def run(script, arguments, folder):
    """Run a script in a process of its own; return its exit code."""
    command = [sys.executable, BENCHMARKS / f'{script}.py', '--results', f'{script}.md']
    done = subprocess.run(
        [*command, *arguments.split()], cwd=folder, capture_output=True, text=True,
        check=False, env={**os.environ, 'MPLBACKEND': 'agg'},
    )
    assert done.stdout, done.stderr
    _, block, _ = re.split(rf'<!-- {script}: (?:begin|end) -->\n', (
        folder / f'{script}.md').read_text())
    assert '| --- |' in block, done.stderr
    assert block in done.stdout  # after what HiGHS prints of itself
    return done.returncode


@pytest.mark.parametrize('script', SCRIPTS)
def test_script_runs_and_writes_its_block(tmp_path, script):
    assert run(script, SCRIPTS[script], tmp_path) == 0


def test_node_scripts_run_and_write_their_blocks(tmp_path):
    """They mostly wait, so they run together. Their exit codes, which judge speed, may differ."""
    with ThreadPoolExecutor(len(NODE_SCRIPTS)) as pool:
        list(pool.map(run, NODE_SCRIPTS, NODE_SCRIPTS.values(), [tmp_path] * len(NODE_SCRIPTS)))
