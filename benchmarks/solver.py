# SPDX-License-Identifier: Apache-2.0
"""Measure what a user waits for: ``plan_trip`` on random problems of every family, and its gap.

The kinds of problems are in families.py. Seeds are new in each run and printed; ``--seed`` repeats
a run. ``--checkout A B`` measures the packages of several checkouts on the same problems, in turns.
"""

from __future__ import annotations

import math
import subprocess
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from families import Problem, draw, problem_parser
from one_run import Answer, run
from report import conditions, publish, quantiles, table

from ambush_planner import AmbushPlannerError, Plan, RiskMap, plan_trip
from ambush_planner.game.strategy import TripStrategy

HERE = Path(__file__).parent.parent
KINDS = 'plan', 'trip', 'grid'
SIZES = 400, 2500, 9500  # of plans; of the other kinds: drawn
PLACES = 500, 2500  # smallest and largest number of places of a trip
TRIP_FAMILIES = ('hills-coarse', 'hills-obstacles', 'hills-fine', 'city', 'maze')
WITHIN = 0.0101  # gap that counts as closed, for a slack of 0.01
# There is no plan: the network of a coarse mesh has no way, or all ways are over a budget.
REFUSED = 'NoRoute', 'BudgetInfeasible', 'StartBlocked', 'GoalBlocked', 'StopBlocked'
OBSTACLE = 3  # cells along a side of what appears on the map


def planned(name: str) -> Answer:
    """A plan without a time limit, once all libraries are loaded."""
    problem = draw(name)
    planned_on(draw('plan:hills-coarse:100:0'))
    begin = time.process_time()
    trip = planned_on(problem).trip
    status = 'gap open' if trip.reason == 'time' else 'solved'
    return {'seconds': time.process_time() - begin, 'status': status, 'words': problem.words,
            'gap': gap_of(trip), 'nats': trip.route_entropy}


def planned_on(problem: Problem, risk_map: RiskMap | None = None, **options: Any) -> Plan:
    scenario = problem.scenario
    return plan_trip(risk_map or scenario.risk_map, scenario.start, scenario.goal, problem.options,
                     stops=problem.stops, **options)


def gap_of(strategy: TripStrategy) -> float:
    """The gap relative to the bound; 0 if there is nothing to lose."""
    return strategy.value / strategy.lower_bound - 1.0 if strategy.lower_bound else strategy.value


def replanned(name: str, changes: int) -> Answer:
    """Plans on maps on which an obstacle is somewhere else each time, each from the one before."""
    from ambush_planner.planning.solving import WarmStart  # not public, so only where it is used

    problem, rng, warm = draw(name), np.random.default_rng(changes), None
    seconds, gaps, risk_map = [], [], problem.scenario.risk_map
    while len(seconds) <= changes:
        begin = time.process_time()
        try:
            plan = planned_on(problem, risk_map, warm=warm)
        except AmbushPlannerError:
            if not seconds:
                raise
        else:
            seconds.append(time.process_time() - begin)
            gaps.append(gap_of(plan.trip))
            warm = WarmStart.of(plan.trip)
        risk_map = changed(problem.scenario.risk_map, rng)  # may close the only way
    return {'seconds': sum(seconds), 'status': 'solved', 'cold': seconds[0], 'warm': seconds[1:],
            'gaps': gaps[1:]}


def changed(risk_map: RiskMap, rng: np.random.Generator) -> RiskMap:
    """The map with an obstacle on ground that was free."""
    row, column = rng.choice(np.argwhere(~risk_map.obstacles))
    obstacles = risk_map.obstacles.copy()
    obstacles[row : row + OBSTACLE, column : column + OBSTACLE] = True
    return replace(risk_map, obstacles=obstacles)


def names_of(kind: str, sizes: list[int] | None, seeds: range,
             families: list[str]) -> dict[int, list[str]]:
    """The problems of a kind by their size; 0: sizes that are drawn."""
    if kind != 'plan':
        return {0: [f'{kind}:{family}:{places_of(family, seed)}:{seed}'
                    for family in families if family in TRIP_FAMILIES for seed in seeds]}
    return {size: [f'{kind}:{family}:{size}:{seed}' for family in families for seed in seeds]
            for size in sizes or SIZES}


def places_of(family: str, seed: int) -> int:
    """The drawn number of places of a trip."""
    rng = np.random.default_rng([seed, TRIP_FAMILIES.index(family)])
    return round(math.exp(rng.uniform(*np.log(PLACES))))


def after_changes(rows: list[Answer], checkout: Path, options: Any) -> None:
    """Plan again on changed maps, ``--changes`` of them on all problems of a size together."""
    solved = [row for row in rows if 'failed' not in row]
    for row in solved:
        row['replanned'] = run('solver.replanned', row['name'], 4.0 * options.limit, checkout,
                               changes=math.ceil(options.changes / len(solved)))


def summary(label: str, rows: list[Answer]) -> dict[str, str]:
    """The figures of one row of the table; a problem that did not end counts with the limit."""
    asked = [row for row in rows if 'failed' not in row or row['status'] not in REFUSED]
    solved = [row for row in rows if 'failed' not in row]
    if not solved:
        return {'': label, 'problems': str(len(asked)), 'not ended': str(len(asked))}
    worst = max(asked, key=lambda row: float(row['seconds']))
    found = {
        '': label, 'problems': str(len(asked)),
        'seconds: median / 95 % / worst': quantiles([row['seconds'] for row in asked]),
        'gap [%]': quantiles([100.0 * row['gap'] for row in solved]),
        'within 1.01 %': f"{np.mean([row.get('gap', 1.0) <= WITHIN for row in asked]):.0%}",
        'nats': f"{np.median([row['nats'] for row in solved]):.1f}",
        'MB': f"{max(row['peak'] for row in solved):.0f}",
        'not ended': str(len(asked) - len(solved)),
        'the slowest': f"`{worst['name']}` {worst.get('words', worst['status'])}",
    }
    again = [row['replanned'] for row in solved if 'replanned' in row]
    ended = [answer for answer in again if 'warm' in answer]
    if ended:
        warm = [second for answer in ended for second in answer['warm']]
        found['changed map: median / 95 % / worst'] = quantiles(warm)
        gaps = [100.0 * gap for answer in ended for gap in answer['gaps']]
        found['gap then [%]'] = quantiles(gaps)
    if again:
        found['not ended then'] = str(len(again) - len(ended))
    return found


def commit(checkout: Path) -> str:
    return subprocess.run(['git', '-C', checkout, 'describe', '--always', '--dirty'], text=True,
                          capture_output=True, check=False).stdout.strip() or checkout.name


def main() -> None:
    parser = problem_parser(__doc__)
    parser.add_argument('--kinds', nargs='+', default=list(KINDS), choices=KINDS)
    parser.add_argument('--sizes', type=int, nargs='+', metavar='NODES', help='of plans')
    parser.add_argument('--checkout', type=Path, nargs='+', default=[HERE], metavar='FOLDER')
    parser.add_argument('--changes', type=int, default=0, help='maps that change, for each size')
    options = parser.parse_args()
    first, sections = options.seed, []
    seeds, labels = range(first, first + options.each), [commit(c) for c in options.checkout]
    for kind in options.kinds:
        for size, names in names_of(kind, options.sizes, seeds, options.families).items():
            rows: list[list[Answer]] = [[] for _ in labels]
            for name in names:
                for own, checkout in zip(rows, options.checkout, strict=True):
                    own.append(run('solver.planned', name, options.limit, checkout))
            for own, checkout, label in zip(rows, options.checkout, labels, strict=True):
                if options.changes and kind == 'plan':
                    after_changes(own, checkout, options)
                where = f'{kind} {size or ""}'.strip()
                sections.append(summary(f'{where}, {label}' if len(labels) > 1 else where, own))
    head = list(dict.fromkeys(key for row in sections for key in row))
    publish(options.results, 'solver', (
        f'Commit {", ".join(labels)}, seeds {first} to {seeds[-1]}. One thread, processor seconds, '
        f"limit {options.limit:g} s. {conditions('highspy')}.\n\n"
        f"{table(head, [[row.get(key, '-') for key in head] for row in sections])}"))


if __name__ == '__main__':
    main()
