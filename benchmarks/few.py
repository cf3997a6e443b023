# SPDX-License-Identifier: Apache-2.0
"""What having only a few routes costs: values of the best mixtures found, over the plan's.

The plan's value and bound let convoys stray from their routes by the tube. Few routes are judged as
they are driven, so that their values can be lower than its bound; and if convoys stray from these
paths by as much again.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from families import draw, problem_parser
from one_run import Answer, run
from report import conditions, publish, quantiles, table

from ambush_planner import AmbushPlannerError, plan_trip
from ambush_planner.planning.few_routes import CURVE, few_routes

# Minimum and maximum number of nodes to aim for.
MIN_NODES, MAX_NODES = 400, 1000


def compared(name: str) -> Answer:
    """The values of few routes, and the processor time that they take [s]."""
    problem = draw(name)
    scenario = problem.scenario
    begin = time.process_time()
    try:
        plan = plan_trip(scenario.risk_map, scenario.start, scenario.goal, problem.options)
        between = time.process_time()
        few = few_routes(plan, CURVE[-1])
        seconds = time.process_time() - between
        strays = replace(plan.options.drive, tracking_error=plan.tube or 0.0)
        straying = few_routes(replace(plan, options=replace(plan.options, drive=strays)), CURVE[-1])
    except AmbushPlannerError as error:
        return {'failed': True, 'seconds': 0.0, 'status': f'{type(error).__name__}: {error}'}
    strategy, curves = plan.strategy, {'as driven': few.curve,
                                       "straying by the plan's tube": straying.curve}
    return {'seconds': between - begin, 'few': seconds, 'status': 'compared', 'ratios': {
        f'{judged}, over the {what}': [value / over for _, value in curve]
        for judged, curve in curves.items()
        for what, over in (('value', strategy.value), ('lower bound', strategy.lower_bound))}}


def main() -> None:
    parser = problem_parser(__doc__)
    options = parser.parse_args()
    first = options.seed
    nodes = np.random.default_rng(first)
    names = [f'plan:{family}:{nodes.integers(MIN_NODES, MAX_NODES)}:{seed}'
             for family in options.families for seed in range(first, first + options.each)]
    answers = [run('few.compared', name, options.limit) for name in names]
    found = [answer for answer in answers if 'failed' not in answer]
    ratios = {key: np.array([each['ratios'][key] for each in found])
              for key in found[0]['ratios']}
    rows = [[str(size), *(f'{np.median(ratio[:, k]):.3f} / {ratio[:, k].max():.3f}'
                          for ratio in ratios.values())] for k, size in enumerate(CURVE)]
    head = ('routes, median / worst', *ratios)
    publish(options.results, 'few', (
        f'{len(found)} of {len(names)} problems of {MIN_NODES} to {MAX_NODES} nodes, seeds '
        f'{first} to {first + options.each - 1}. {conditions()}.\n\n{table(head, rows)}\n\n'
        'Processor seconds, median / 95 % / worst: plan '
        f'{quantiles([each["seconds"] for each in found])}; all {len(CURVE)} mixtures '
        f'{quantiles([each["few"] for each in found])}.'))


if __name__ == '__main__':
    main()
