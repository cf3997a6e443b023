# SPDX-License-Identifier: Apache-2.0
"""Measure by how much solves pass their time limit, on problems that need more time.

A limit is of the wall clock, but what a solve does after it is counted in processor seconds, so
that the numbers are those of an idle machine. At most 1 s or 5 % of the limit is allowed.
"""

from __future__ import annotations

import threading
import time

from families import KINDS, draw, problem_parser
from one_run import Answer, run
from report import conditions, publish, table
from solver import TRIP_FAMILIES, at_nodes, gap_of

from ambush_planner import AmbushPlannerError, TimeLimit
from ambush_planner.planning.solving import solve_on_network
from ambush_planner.planning.trip import trip_network

LIMITS = (3.0, 20.0)  # s
NODES = 2500
ALLOWED, SHARE = 1.0, 0.05  # s, of the limit
NONE = {'seconds': 0.0, 'name': '-'}


def solved(name: str, time_limit: float) -> Answer:
    """Processor seconds of a solve after its time limit; 0 if it ends before."""
    at_nodes('nodes:hills-coarse:100:0')  # loads all libraries
    problem, late = draw(name, time_limit), [0.0]
    scenario, status = problem.scenario, 'in time'
    try:
        network = trip_network(scenario.risk_map, scenario.start, scenario.goal,
                               problem.options.network, problem.stops, 'given')
        clock = threading.Timer(time_limit, lambda: late.insert(0, time.process_time()))
        clock.start()
        strategy = solve_on_network(scenario.risk_map, network, problem.options)
    except TimeLimit as error:
        if error.strategy is None:
            return {'failed': True, 'seconds': 0.0, 'status': 'no strategy'}
        strategy, status = error.strategy, 'gap open'
    except AmbushPlannerError as error:
        return {'failed': True, 'seconds': 0.0, 'status': type(error).__name__}
    clock.cancel()
    over = time.process_time() - late[0] if late[0] else 0.0
    return {'seconds': over, 'status': status, 'gap': gap_of(strategy)}


def main() -> None:
    parser = problem_parser(__doc__)
    parser.add_argument('--kinds', nargs='+', default=[k for k in KINDS if k != 'nodes'],
                        choices=KINDS)
    parser.add_argument('--limits', type=float, nargs='+', default=LIMITS, metavar='SECONDS')
    options = parser.parse_args()
    rows = []
    for limit in options.limits:
        allowed = max(ALLOWED, SHARE * limit)
        for kind in options.kinds:
            answers = [run('limits.solved', f'{kind}:{family}:{NODES}:{seed}', options.limit,
                           time_limit=limit)
                       for family in options.families if family in TRIP_FAMILIES
                       for seed in range(options.seed, options.seed + options.each)]
            answers = [each for each in answers if 'failed' not in each]
            worst = max(answers, key=lambda each: float(each['seconds']), default=NONE)
            rows.append([f'{limit:g} s', kind, str(len(answers)),
                         str(sum(each['seconds'] > 0.0 for each in answers)),
                         str(sum(each['seconds'] > allowed for each in answers)),
                         f"{worst['seconds']:.2f} s", f"`{worst['name']}`"])
    head = ['limit', 'kind', 'problems', 'late', 'more than allowed', 'worst overrun', 'of']
    publish(options.results, 'limits', (
        f'Seeds from {options.seed}, about {NODES} nodes a leg. Processor seconds after the limit; '
        f"at most {ALLOWED:g} s or {SHARE:.0%} are allowed. {conditions('highspy')}.\n\n"
        f'{table(head, rows)}'))


if __name__ == '__main__':
    main()
