"""Compare the solver with HiGHS and Clarabel on maps of several sizes, in one run.

Every run is a process of its own on one thread. The tables go to the screen and into results.md.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import solver_tables
from report import RESULTS, conditions, write_block

ONE_RUN = Path(__file__).with_name('one_run.py')
THREAD_VARIABLES = ('OMP', 'OPENBLAS', 'MKL', 'RAYON')
OURS = ('build', 'value', 'strategy')
PEERS = ('simplex', 'interior_point', 'conic')

Runs = dict[str, list[dict[str, Any]]]


def one_run(
    task: str, name: str, repeat_for: float, file: Path = Path(os.devnull), limit: int = 0
) -> dict[str, Any]:
    """Answer of one process; ``{"limit": limit}`` if it was over its time."""
    threads = {f'{name}_NUM_THREADS': '1' for name in THREAD_VARIABLES}
    command = [sys.executable, ONE_RUN, task, name, file]
    command += ['--limit', str(limit), '--repeat-for', str(repeat_for)]
    print(f'{name:16s}  {task:15s}', end='', file=sys.stderr, flush=True)
    done = subprocess.run(command, env=os.environ | threads, stdout=subprocess.PIPE, check=False)
    if done.returncode == -signal.SIGPROF:
        print(f' > {limit} s', file=sys.stderr)
        return {'limit': limit}
    done.check_returncode()
    answer: dict[str, Any] = json.loads(done.stdout)
    print(f" {answer['seconds']:8.3f} s  {answer.get('status', '')}", file=sys.stderr)
    return answer


def runs_of_size(nodes: int, repeats: int, limit: int, repeat_for: float) -> Runs:
    """Let all solvers take turns; who would go over ``limit`` seconds has no further turn."""
    runs: Runs = {task: [] for task in (*OURS, *PEERS)}
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(repeats):
            for task, answers in runs.items():
                if not answers or (len(answers) + 1) * longest(answers) <= limit:
                    cap = limit if task in PEERS else 0
                    file = Path(folder, 'problem.npz')
                    answers.append(one_run(task, f'block:{nodes}', repeat_for, file, cap))
    return runs


def longest(answers: list[dict[str, Any]]) -> float:
    """Most seconds that one of these runs took."""
    return max(float(answer.get('seconds', answer.get('limit'))) for answer in answers)


def median(answers: list[dict[str, Any]]) -> dict[str, Any]:
    """The answers' common content with median time and memory; a limit that was met stands."""
    for answer in answers:
        if 'limit' in answer:
            return answer
    middle = {key: statistics.median(a[key] for a in answers) for key in ('seconds', 'peak')}
    return answers[-1] | middle


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument(
        '--sizes', type=int, nargs='+', default=[30, 60, 100, 200], metavar='N',
        help='lattice nodes across the map',
    )
    parser.add_argument('--repeats', type=int, default=3, help='runs to take the median of')
    parser.add_argument(
        '--repeat-for', type=float, default=0.5, metavar='SECONDS',
        help='for which a short run is repeated; the median counts',
    )
    parser.add_argument(
        '--peer-limit', type=int, default=150, metavar='SECONDS',
        help='processor seconds that all runs of one solver on one size may take',
    )
    parser.add_argument(
        '--growth', type=int, nargs='*', default=[103, 206, 412, 1030], metavar='N',
        help='nodes across the map, 10 000 to a million in all: network and strategy',
    )
    parser.add_argument(
        '--problems', nargs='*', default=list(solver_tables.HARD), metavar='NAME',
        help='further ones, of problems.py',
    )
    parser.add_argument(
        '--results', type=Path, default=RESULTS, help='file whose block `solver` is replaced'
    )
    options = parser.parse_args()
    short = options.repeat_for
    measured = {
        nodes: {task: median(answers) for task, answers in runs_of_size(
            nodes, options.repeats, options.peer_limit, short).items()}
        for nodes in options.sizes
    }
    hard = {
        name: median([one_run('strategy', name, short) for _ in range(options.repeats)])
        for name in options.problems
    }
    growth = [one_run('whole', f'block:{nodes}', short) for nodes in options.growth]
    text = solver_tables.report(measured, hard, growth, conditions('highspy', 'clarabel'))
    print(text)
    write_block(options.results, 'solver', text)


if __name__ == '__main__':
    main()
