# SPDX-License-Identifier: Apache-2.0
"""Plans for one reach on coarser and coarser networks: how fine is fine enough?

Map, reach, held ground and detour stay the same, and the spacing is a share of the reach. Values
include the tube, which grows with the spacing. Without a reach the value depends on the mesh and
tends to 0 on finer ones. Seeds are new in each run and printed.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from families import draw, problem_parser
from report import conditions, publish, table

from ambush_planner import GameOptions, NoRoute, StrategyOptions, TimeLimit, plan_trip, solve
from ambush_planner.arrays import FloatArray

FAMILIES = ('hills-coarse', 'hills-obstacles', 'city')
FRACTIONS = (8.0, 6.0, 4.0, 3.0, 2.0, 1.0)
NODES = 5000  # of the maps, as ``draw`` counts; the finest network has far fewer
REACH = 1 / 6  # of the map's longer side; also the radius of held ground
DETOUR = 1.5  # a budget that seldom raises the value
# Value, bound, value without a reach, nodes, nats and processor seconds of one plan.
NO_PLAN = np.full(6, np.nan)


def measure(name: str, fraction: float, limit: float) -> FloatArray:
    """The figures of a plan on the problem's map with the spacing reach / ``fraction``."""
    problem = draw(name)
    scenario, reach = problem.scenario, REACH * max(problem.scenario.risk_map.size)
    options = replace(problem.options, game=GameOptions(ambush_radius=reach, secured_radius=reach),
                      network=replace(problem.options.network, spacing=reach / fraction),
                      strategy=StrategyOptions(max_detour=DETOUR, time_limit=limit))
    begin = time.process_time()
    try:
        plan = plan_trip(scenario.risk_map, scenario.start, scenario.goal, options)
        seconds = time.process_time() - begin
        at_nodes = solve(plan.network, GameOptions(ambush_radius=0.0, secured_radius=reach),
                         options.strategy)
    except (NoRoute, TimeLimit):
        return NO_PLAN
    found = plan.strategy
    return np.array([found.value, found.lower_bound, at_nodes.value, len(plan.network.points),
                     found.route_entropy, seconds])


def main() -> None:
    parser = problem_parser(__doc__)
    parser.set_defaults(families=FAMILIES)
    parser.add_argument('--fractions', type=float, nargs='+', default=list(FRACTIONS),
                        help='reach over spacing, the finest first')
    options = parser.parse_args()
    first = options.seed
    names = [f'plan:{f}:{NODES}:{first + k}' for f in options.families for k in range(options.each)]
    found = np.array([[measure(name, fraction, options.limit)
                       for fraction in options.fractions] for name in names])
    ratios = found / found[:, :1]
    rows = [[f'`{name}`', f'reach / {fraction:g}', f'**{ratio[0]:.2f}** ({value:.4g})',
             f'{bound:.4g}', f'**{ratio[2]:.2f}** ({plain:.4g})', f'{nodes:.0f}', f'{nats:.1f}',
             f'{seconds:.1f}']
            for name, plans, own in zip(names, found, ratios, strict=True)
            for fraction, ratio, (value, bound, plain, nodes, nats, seconds)
            in zip(options.fractions, own, plans, strict=True)]
    medians = np.nanmedian(ratios, axis=0)
    plans = np.isfinite(ratios[:, :, 0]).sum(axis=0)
    short = [[f'reach / {fraction:g}', str(count), f'**{m[0]:.2f}**', *(f'{x:.2f}' for x in m[2:])]
             for fraction, count, m in zip(options.fractions, plans, medians, strict=True)]
    text = (f'Seeds {first} to {first + options.each - 1}, reach and held ground {REACH:.3g} of '
            f'the map, detour {DETOUR:g}. {conditions()}.\n\n')
    head = ('value', 'bound', 'value without a reach', 'nodes', 'nats', 's')
    publish(options.results, 'mesh_convergence', (
        f"{text}{table(('map', 'spacing', *head), rows)}\n\nMedians, relative to the finest:\n\n"
        f"{table(('spacing', 'plans', head[0], *head[2:]), short)}"))


if __name__ == '__main__':
    main()
