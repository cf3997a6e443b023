"""Plans for one reach on coarser and coarser networks: how fine is fine enough?

Map, reach, held ground and detour stay the same, and the spacing is a share of the reach. Values
hold for an ambusher at any cell, and include the tube, which grows with the spacing; ``--tube 0``
keeps it out. Seeds are new in each run and printed; ``--seed`` repeats a run.
"""

from __future__ import annotations

import secrets
import sys
import time

import numpy as np
from families import draw
from report import conditions, new_parser, publish, table

from ambush_planner import (
    GameOptions,
    NetworkOptions,
    NoRoute,
    PlanningOptions,
    StrategyOptions,
    TimeLimit,
    plan_trip,
)
from ambush_planner.arrays import FloatArray
from ambush_planner.planning.options import DriveOptions

FAMILIES = ('hills-coarse', 'hills-obstacles', 'city')
FRACTIONS = (8.0, 6.0, 4.0, 3.0, 2.0, 1.0)
# Size of the maps, in nodes of ``draw``; the finest network has far fewer.
NODES = 5000
REACH = 1 / 6  # of the map's longer side
HELD = 1.0  # reaches
DETOUR = 1.5  # a budget that seldom raises the value

# Value, bound, nodes, nats and processor seconds of one plan; NaN if there is none.
NO_PLAN = (np.nan,) * 5


def measure(name: str, fraction: float, tube: float | None, limit: float) -> tuple[float, ...]:
    """A plan on the problem's map with the spacing reach / ``fraction``."""
    scenario = draw(name).scenario
    reach = REACH * max(scenario.risk_map.size)
    options = PlanningOptions(
        NetworkOptions(spacing=reach / fraction),
        GameOptions(ambush_radius=reach, secured_radius=HELD * reach),
        StrategyOptions(max_detour=DETOUR, time_limit=limit), DriveOptions(tube),
    )
    begin = time.process_time()
    try:
        plan = plan_trip(scenario.risk_map, scenario.start, scenario.goal, options)
    except (NoRoute, TimeLimit):
        return NO_PLAN
    found = plan.strategy
    return (found.value, found.lower_bound, len(plan.network.points), found.route_entropy,
            time.process_time() - begin)


def convergence(names: list[str], fractions: list[float], tube: float | None,
                limit: float) -> str:
    """One row per map and spacing, then the medians per spacing, relative to the finest."""
    rows: list[list[str]] = []
    ratios: list[list[FloatArray]] = []
    for name in names:
        plans: list[FloatArray] = []
        ratios.append([])
        for fraction in fractions:
            plan = np.array(measure(name, fraction, tube, limit))
            plans.append(plan)
            ratios[-1].append(plan / plans[0])
            numbers = [f'{plan[2]:.0f}', f'**{ratios[-1][-1][0]:.2f}** ({plan[0]:.4g})',
                       f'{plan[1]:.4g}', f'{plan[3]:.1f}', f'{plan[4]:.1f}']
            rows.append([f'`{name}`', f'reach / {fraction:g}',
                         *(numbers if np.isfinite(plan[0]) else '-' * len(numbers))])
            print(*rows[-1], file=sys.stderr, flush=True)
    head = ('map', 'spacing', 'nodes', 'value', 'bound', 'nats', 's')
    medians = np.nanmedian(ratios, axis=0)
    found = np.isfinite(np.array(ratios)[:, :, 0]).sum(axis=0)
    short = [[f'reach / {fraction:g}', str(count), f'**{median[0]:.2f}**', f'{median[2]:.2f}',
              f'{median[3]:.2f}', f'{median[4]:.2f}']
             for fraction, count, median in zip(fractions, found, medians, strict=True)]
    return (f"{table(head, rows)}\n\nMedians, relative to the finest:\n\n"
            f"{table(('spacing', 'plans', 'value', 'nodes', 'nats', 's'), short)}")


def main() -> None:
    parser = new_parser(__doc__)
    parser.add_argument('--families', nargs='+', default=list(FAMILIES))
    parser.add_argument('--fractions', type=float, nargs='+', default=list(FRACTIONS),
                        help='reach over spacing, the finest first')
    parser.add_argument('--each', type=int, default=2, help='maps of each family')
    parser.add_argument('--seed', type=int, help='the first seed; a new one if not given')
    parser.add_argument('--tube', type=float, help='of the path [m], in place of the default')
    parser.add_argument('--limit', type=float, default=300.0, help='of each solve [s]')
    options = parser.parse_args()
    first = options.seed or secrets.randbelow(10**9)
    names = [f'{f}:{NODES}:{first + k}' for f in options.families for k in range(options.each)]
    text = (f'Seeds {first} to {first + options.each - 1}, reach {REACH:.3g} of the map, held '
            f'ground {HELD:g} reaches, detour {DETOUR:g}. {conditions()}.\n\n')
    publish(options.results, 'mesh_convergence',
            text + convergence(names, options.fractions, options.tube, options.limit))


if __name__ == '__main__':
    main()
