"""Compare the solver with HiGHS and Clarabel on maps of several sizes.

Every run is a process of its own on one thread. All solvers must agree on value and entropy.
"""

from __future__ import annotations

import json
import math
import os
import signal
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from report import conditions, new_parser, publish, table

ONE_RUN = Path(__file__).with_name('one_run.py')
THREAD_VARIABLES = ('OMP', 'OPENBLAS', 'MKL', 'RAYON')
PEERS = ('simplex', 'interior_point', 'conic')
TASKS = {
    'value': 'value by cut',
    'strategy': '**strategy, all stages**',
    'simplex': 'HiGHS dual simplex, value within the length budget',
    'interior_point': 'HiGHS interior point without crossover, value',
    'conic': 'Clarabel, route entropy',
}
# Our task, the peer's task, title.
COMPARISONS = (
    ('strategy', 'interior_point', 'strategy : HiGHS interior point, value alone'),
    ('strategy', 'conic', 'strategy : Clarabel, the same route-entropy problem'),
    ('value', 'simplex', 'value by cut : HiGHS dual simplex'),
    ('value', 'interior_point', 'value by cut : HiGHS interior point'),
)
HARD = (
    'reach-hills:52', 'reach-block:50', 'reach-hills:106', 'reach-block:103',
    *(f'{name}:{detour}'
      for name in ('terrain', 'city') for detour in ('1.05', '1.1', '1.15', '1.2')),
)
# Relative differences by which values and entropies of the peers may be off.
SAME_VALUE, SAME_ENTROPY = 1e-6, 2e-3

Answer = dict[str, Any]
Measured = dict[int, dict[str, Answer]]


def one_run(
    task: str, name: str, repeat_for: float, file: Path = Path(os.devnull), limit: int = 0
) -> Answer:
    """The answer of one process; ``{"limit": limit}`` if it exceeded its time limit."""
    threads = {f'{name}_NUM_THREADS': '1' for name in THREAD_VARIABLES}
    command = [sys.executable, ONE_RUN, task, name, file]
    command += ['--limit', str(limit), '--repeat-for', str(repeat_for)]
    print(f'{name:16s}  {task:15s}', end='', file=sys.stderr, flush=True)
    done = subprocess.run(command, env=os.environ | threads, stdout=subprocess.PIPE, check=False)
    if done.returncode == -signal.SIGPROF:
        print(f' > {limit} s', file=sys.stderr)
        return {'limit': limit}
    done.check_returncode()
    answer: Answer = json.loads(done.stdout)
    print(f" {answer['seconds']:8.3f} s  {answer.get('status', '')}", file=sys.stderr)
    return answer


def measure_size(nodes: int, repeats: int, limit: int, repeat_for: float) -> dict[str, Answer]:
    """Alternate between all solvers, without those that would exceed ``limit`` seconds."""
    runs: dict[str, list[Answer]] = {task: [] for task in TASKS}
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(repeats):
            for task, answers in runs.items():
                if not answers or (len(answers) + 1) * max(map(least_seconds, answers)) <= limit:
                    cap = limit if task in PEERS else 0
                    file = Path(folder, 'problem.npz')
                    answers.append(one_run(task, f'block:{nodes}', repeat_for, file, cap))
    return {task: median(answers) for task, answers in runs.items()}


def median(answers: list[Answer]) -> Answer:
    """An answer with median time and memory, or the one that exceeded its time limit."""
    for answer in answers:
        if 'limit' in answer:
            return answer
    middle = {key: statistics.median(a[key] for a in answers) for key in ('seconds', 'peak')}
    return answers[-1] | middle


def least_seconds(answer: Answer) -> float:
    """Seconds that a run took, or its time limit."""
    return float(answer.get('seconds', answer.get('limit')))


def check_agreement(measured: Measured) -> None:
    """Raise RuntimeError if solvers that finished disagree."""
    for nodes, size in measured.items():
        for task, other, key, tolerance in (
            ('simplex', 'value', 'value', SAME_VALUE),
            ('interior_point', 'value', 'value', SAME_VALUE),
            ('conic', 'strategy', 'route_entropy', SAME_ENTROPY),
        ):
            if key in size[task] and not math.isclose(
                size[task][key], size[other][key], rel_tol=tolerance
            ):
                raise RuntimeError(f'{nodes} across: {task} and {other} disagree on the {key}')


def report(measured: Measured, hard: dict[str, Answer], growth: list[Answer]) -> str:
    """All tables and the conditions under which they were measured."""
    across = [f'{nodes} across' for nodes in measured]
    ratios = [
        [title, *(f'**{ratio(size[ours], size[peer])}**' for size in measured.values())]
        for ours, peer, title in COMPARISONS
    ]
    seconds = [
        [title, *(time_and_memory(size[task]) for size in measured.values())]
        for task, title in TASKS.items()
    ]
    nodes = ['nodes', *(str(size['strategy']['nodes']) for size in measured.values())]
    sections = (
        ('How many times faster', table(['', *across], [nodes, *ratios])),
        ('Processor seconds (peak memory of the process in MB)', table(['', *across], seconds)),
        ('A reach of 4 spacings, and budgets that raise the value', hard_problems(hard)),
        ('From ten thousand to a million nodes', growth_table(growth)),
    )
    text = '\n\n'.join(f'### {title}\n\n{content}' for title, content in sections)
    return (
        'One thread for every solver, medians of processor seconds. '
        f"{conditions('highspy', 'clarabel')}.\n\n{text}"
    )


def hard_problems(hard: dict[str, Answer]) -> str:
    head = ('', 'nodes', 'seconds (MB)', 'value', 'gap', 'route entropy', 'length : shortest',
            'the budget raises the value', 'evaluations')
    rows = [
        [f'`{name}`', str(each['nodes']), time_and_memory(each), entry(each, 'value', '.6g'),
         entry(each, 'gap', '.1e'), entry(each, 'route_entropy', '.2f'),
         entry(each, 'length', '.3f'), 'yes' if each.get('price', 0.0) > 0.0 else 'no',
         entry(each, 'iterations', 'd')]
        for name, each in hard.items()
    ]
    return table(head, rows)


def growth_table(growth: list[Answer]) -> str:
    """Seconds by size, and the exponent of their growth."""
    rows = [
        [str(each['nodes']), str(each['edges']), f"{each['seconds']:.2f}", f"{each['peak']:.0f}",
         f"{1e6 * each['seconds'] / each['nodes']:.1f}", str(each['iterations'])]
        for each in growth
    ]
    text = table(
        ('nodes', 'edges', 'network and strategy [s]', 'MB', 'microseconds a node', 'evaluations'),
        rows,
    )
    if len(growth) < 2:
        return text
    logs = np.log([[each['nodes'], each['seconds']] for each in growth])
    exponent = np.polyfit(*logs.T, 1)[0]
    return f'{text}\n\nSeconds grow like nodes to the power of {exponent:.2f}.'


def entry(answer: Answer, key: str, form: str) -> str:
    return f'{answer[key]:{form}}' if key in answer else '-'


def ratio(ours: Answer, peer: Answer) -> str:
    if 'failed' in peer:
        return 'failed'
    times = least_seconds(peer) / ours['seconds']
    return ('> ' if 'limit' in peer else '') + (f'{times:.1f}x' if times < 20 else f'{times:.0f}x')


def time_and_memory(answer: Answer) -> str:
    if 'limit' in answer:
        return f"> {answer['limit']}"
    text = f"{answer['seconds']:.3g} ({answer['peak']:.0f})"
    if 'failed' in answer:
        return f"{text}, **failed** ({answer['status']})"
    return text if answer.get('status') != 'AlmostSolved' else f'{text}, AlmostSolved'


def main() -> None:
    parser = new_parser(__doc__)
    parser.add_argument(
        '--sizes', type=int, nargs='+', default=[30, 60, 100, 200], metavar='N',
        help='lattice nodes across the map',
    )
    parser.add_argument('--repeats', type=int, default=3, help='runs to take the median of')
    parser.add_argument(
        '--repeat-for', type=float, default=0.5, metavar='SECONDS',
        help='duration for which a short run is repeated; the median counts',
    )
    parser.add_argument(
        '--peer-limit', type=int, default=150, metavar='SECONDS',
        help='limit for all runs of one solver on one size, in processor seconds',
    )
    parser.add_argument(
        '--growth', type=int, nargs='*', default=[103, 206, 412, 1030], metavar='N',
        help='nodes across the map, 10 000 to a million in all: network and strategy',
    )
    parser.add_argument(
        '--problems', nargs='*', default=list(HARD), metavar='NAME',
        help='further problems, as in one_run.py',
    )
    options = parser.parse_args()
    short = options.repeat_for
    measured = {
        nodes: measure_size(nodes, options.repeats, options.peer_limit, short)
        for nodes in options.sizes
    }
    check_agreement(measured)
    hard = {
        name: median([one_run('strategy', name, short) for _ in range(options.repeats)])
        for name in options.problems
    }
    growth = [one_run('whole', f'block:{nodes}', short) for nodes in options.growth]
    publish(options.results, 'solver', report(measured, hard, growth))


if __name__ == '__main__':
    main()
