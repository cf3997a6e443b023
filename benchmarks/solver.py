"""Measure the solver on random problems of every family, and HiGHS and Clarabel on the same ones.

Seeds are new in each run and printed; ``--seed`` repeats a run. Every solve is a process of its own
on one thread. The peers solve problems without a reach; their times are compared by shifted
geometric means, in which a solver over its time limit, or failed, counts with the limit.
"""

from __future__ import annotations

import json
import math
import os
import secrets
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from families import FAMILIES
from report import conditions, new_parser, publish, table

ONE_RUN = Path(__file__).with_name('one_run.py')
THREAD_VARIABLES = ('OMP', 'OPENBLAS', 'MKL', 'RAYON')
PEERS = {
    'simplex': 'HiGHS dual simplex, value within the length budget',
    'interior_point': 'HiGHS interior point without crossover, the same',
    'conic': 'Clarabel, route entropy within our value and length',
}
SHIFT = 1.0  # s, of the geometric means
# Relative difference by which a peer's value may exceed ours, or its entropy differ.
SAME_VALUE, SAME_ENTROPY = 1e-5, 1e-2
# The first usable strategy: time limit as a share of the whole solve's time, least limit [s], gap.
EARLY, LEAST_EARLY, USABLE = 0.1, 0.2, 0.1
STAGES = ('cut', 'chain', 'faces', 'program', 'law', 'once', 'certificate')

Answer = dict[str, Any]


def one_run(task: str, name: str, file: Path, limit: float, *more: str) -> Answer:
    """The answer of one process; its time is ``limit`` if it exceeded that or failed."""
    threads = {f'{name}_NUM_THREADS': '1' for name in THREAD_VARIABLES}
    command = [sys.executable, str(ONE_RUN), task, name, str(file), '--limit', str(limit), *more]
    print(f'{name:32s} {task:15s}', end='', file=sys.stderr, flush=True)
    done = subprocess.run(command, env=os.environ | threads, stdout=subprocess.PIPE, check=False)
    if done.returncode == 0:
        # HiGHS 1.16 prints its name first.
        answer: Answer = json.loads(done.stdout.splitlines()[-1])
    else:
        late = done.returncode == -signal.SIGPROF
        answer = {'failed': True, 'seconds': limit, 'status': 'late' if late else 'crashed'}
    if task != 'strategy' and answer.get('failed'):
        answer['seconds'] = limit
    print(f" {answer['seconds']:8.2f} s  {answer['status']}", file=sys.stderr)
    return answer | {'name': name}


def measure(names: list[str], limit: float, peers: list[str], early: bool,
            *more: str) -> list[Answer]:
    """Our answers; those without a reach hold the peers' under their names."""
    answers = []
    for name in names:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder, 'problem.npz')
            ours = one_run('strategy', name, file, limit, *more)
            answers.append(ours)
            if file.exists() and ours['reach'] == 0.0:
                ours |= {peer: one_run(peer, name, file, limit, *more) for peer in peers}
                check_agreement(ours)
            if early and 'failed' not in ours:
                soon = max(EARLY * ours['seconds'], LEAST_EARLY)
                ours['early'] = one_run('strategy', name, file, soon, *more) | {'limit': soon}
    return answers


def check_agreement(ours: Answer) -> None:
    """Raise RuntimeError if a peer that finished contradicts our bound, value or entropy."""
    for peer in ('simplex', 'interior_point'):
        theirs = ours.get(peer, {}).get('value')
        if theirs is not None:
            low, high = ours['value'] - ours['gap'], ours['value']
            room = SAME_VALUE * max(high, 1e-9)
            if not low - room <= theirs <= high + room:
                raise RuntimeError(f"{ours['name']}: {peer} has {theirs}, not {low} to {high}")
    entropy = ours.get('conic', {}).get('route_entropy')
    if entropy is not None and not -SAME_ENTROPY * (1.0 + entropy) <= (
        entropy - ours['route_entropy']
    ):
        raise RuntimeError(f"{ours['name']}: Clarabel has less entropy, {entropy}")


def quantiles(seconds: list[float]) -> list[str]:
    """Median, 95 % quantile and largest."""
    return [f'{s:.2f}' for s in np.quantile(seconds, [0.5, 0.95, 1.0])]


def by_family(answers: list[Answer]) -> str:
    """One row per family and one for all: times, the slowest problem, shares of the stages."""
    rows = []
    for family in (*FAMILIES, ''):
        here = [a for a in answers
                if 'failed' not in a and family in ('', a['name'].split(':')[0])]
        if not here:
            continue
        total = sum(a['seconds'] for a in here)
        worst = max(here, key=lambda a: float(a['seconds']))
        shares = [f"{100 * sum(a['stages'].get(s, 0.0) for a in here) / total:.0f}" for s in STAGES]
        rows.append([
            family or '**all**', str(len(here)), *quantiles([a['seconds'] for a in here]),
            f"`{worst['name']}` reach {worst['reach']:g} detour {worst['detour']:.3g}",
            ', '.join(shares), f"{np.median([a['evaluations'] for a in here]):.0f}",
            f"{max(a['evaluations'] for a in here)}", f"{max(a['peak'] for a in here):.0f}",
        ])
    return table(('', 'problems', 'median [s]', '95 %', 'worst', 'the worst',
                  f"% in {', '.join(STAGES)}", 'evaluations, median', 'most', 'MB'), rows)


def paths(answers: list[Answer]) -> str:
    """How often each way through the solver was taken; (law) found its limits infeasible."""
    ways = Counter(f"**{a['status']}**" if a['status'] != 'solved' else a['path'] for a in answers)
    return table(('way', 'problems'), [[w or 'none', str(n)] for w, n in ways.most_common()])


def first_strategies(answers: list[Answer]) -> str:
    """The gaps, relative to the bound, of solves that were given a tenth of the time."""
    ran = [a['early'] for a in answers if 'early' in a]
    if not ran:
        return ''
    gaps = [math.inf if 'failed' in a else a['gap'] / max(a['value'] - a['gap'], 1e-300)
            for a in ran]
    worst, over = int(np.argmax(gaps)), [a['seconds'] - a['limit'] for a in ran]
    row = [str(len(ran)), f'**{np.mean(np.array(gaps) <= USABLE):.0%}**', f'{np.median(gaps):.1%}',
           f"{gaps[worst]:.0%} (`{ran[worst]['name']}`)", f'{np.median(over):.2f}',
           f'{max(over):.2f}']
    head = ('problems', f'gap at most {USABLE:.0%}', 'median', 'worst',
            'over the limit, median [s]', 'most [s]')
    return (f'\n\nAfter {EARLY:g} of the time, at least {LEAST_EARLY:g} s:\n\n'
            f'{table(head, [row])}')


def against_peers(answers: list[Answer], peers: list[str], limit: float) -> str:
    """Shifted geometric means over the problems without a reach, and their ratios to ours."""
    shared = [a for a in answers if peers and peers[0] in a]
    if not shared:
        return ''
    own = shifted_mean([a['seconds'] for a in shared])
    rows = [['**strategy, all stages**', f'{own:.2f}', '1', '-', '-']]
    for peer in peers:
        theirs = [a[peer] for a in shared]
        mean = shifted_mean([t['seconds'] for t in theirs])
        states = Counter(t['status'] for t in theirs)
        late = states.pop('late', 0)
        solved = ('Optimal', 'Solved', 'AlmostSolved')
        rows.append([PEERS[peer], f'{mean:.2f}', f'**{mean / own:.1f}x**', str(late),
                     str(sum(n for state, n in states.items() if state not in solved))])
    head = ('', 'shifted geometric mean [s]', 'ratio', f'over {limit:g} s', 'failed')
    return f'\n\n{len(shared)} problems without a reach:\n\n{table(head, rows)}'


def shifted_mean(seconds: list[float]) -> float:
    return math.exp(float(np.mean(np.log(np.array(seconds) + SHIFT)))) - SHIFT


def main() -> None:
    parser = new_parser(__doc__)
    parser.add_argument('--sizes', type=int, nargs='+', default=[2500, 9500], metavar='NODES',
                        help='sizes of the networks, such as 2500 9500 37000 1000000')
    parser.add_argument('--each', type=int, nargs='+', default=[5], metavar='COUNT',
                        help='problems of each family, for all sizes or for each size')
    parser.add_argument('--families', nargs='+', default=list(FAMILIES), choices=list(FAMILIES))
    parser.add_argument('--seed', type=int, help='the first seed; a new one if not given')
    parser.add_argument('--reach', type=float, help='for all problems [spacings]')
    parser.add_argument('--detour', type=float, help='for all problems')
    parser.add_argument('--early', action='store_true',
                        help='solve again within a tenth of the time, on an idle machine')
    parser.add_argument('--ambushers', type=int, help='for all problems; else one')
    parser.add_argument('--stops', type=int, help='random ones on the way; else none')
    parser.add_argument('--peers', nargs='*', default=list(PEERS), choices=list(PEERS))
    parser.add_argument('--limit', type=float, default=300.0,
                        help='limit of each solve [s]; ours is elapsed time')
    options = parser.parse_args()
    if len(options.each) not in (1, len(options.sizes)):
        parser.error('--each takes one count, or one for each of the --sizes')
    first = options.seed or secrets.randbelow(10**9)
    more = [f'--{key}={value}' for key in ('reach', 'detour', 'ambushers', 'stops')
            if (value := getattr(options, key)) is not None]
    sections = []
    each = options.each * (len(options.sizes) if len(options.each) == 1 else 1)
    for nodes, count in zip(options.sizes, each, strict=True):
        names = [f'{f}:{nodes}:{first + k}' for f in options.families for k in range(count)]
        answers = measure(names, options.limit, options.peers, options.early, *more)
        sections.append(f'### {nodes} nodes\n\n{by_family(answers)}\n\n{paths(answers)}'
                        f'{first_strategies(answers)}'
                        f'{against_peers(answers, options.peers, options.limit)}')
    text = (f'Seeds {first} to {first + max(each) - 1}. One thread, processor seconds. '
            f"{conditions('highspy', 'clarabel')}.\n\n" + '\n\n'.join(sections))
    publish(options.results, 'solver', text)


if __name__ == '__main__':
    main()
