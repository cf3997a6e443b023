# SPDX-License-Identifier: Apache-2.0
"""What it costs that a plan's value holds wherever in a cell an ambusher waits.

The same losses on smaller and smaller cells: each cell of a coarse map is divided, so only the
places at which a plan looks change, and by how much it enlarges the reach for those between them.
Seeds are new in each run and printed.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from families import draw, problem_parser
from report import conditions, publish, table

from ambush_planner import GameOptions, RiskMap, StrategyOptions, plan_trip

FAMILIES = ('hills-coarse', 'hills-obstacles', 'rough', 'city')
NODES = 150
CELLS = (1.0, 0.5, 0.25, 0.125)  # cells over reach
DETOUR = 1.5


def measure(name: str) -> list[tuple[float, float]]:
    """Values and processor seconds of plans on cells of each size; the map has the largest."""
    problem = draw(name)
    scenario, coarse = problem.scenario, problem.scenario.risk_map
    reach = coarse.resolution / CELLS[0]
    game = GameOptions(ambush_radius=reach, secured_radius=2.0 * coarse.resolution)
    options = replace(problem.options, game=game, strategy=StrategyOptions(max_detour=DETOUR),
                      network=replace(problem.options.network, spacing=coarse.resolution))
    found = []
    for cells in CELLS:
        parts = np.ones((round(CELLS[0] / cells),) * 2)
        risk_map = RiskMap(np.kron(coarse.alpha, parts),
                           np.kron(coarse.obstacles, parts).astype(bool),
                           coarse.resolution / len(parts), coarse.origin)
        begin = time.process_time()
        value = plan_trip(risk_map, scenario.start, scenario.goal, options).value
        found.append((value, time.process_time() - begin))
    return found


def main() -> None:
    parser = problem_parser(__doc__)
    parser.set_defaults(families=FAMILIES)
    options = parser.parse_args()
    names = [f'plan:{family}:{NODES}:{options.seed + k}'
             for family in options.families for k in range(options.each)]
    found = np.array([measure(name) for name in names])
    values, seconds = found[:, :, 0] / found[:, -1:, 0], found[:, :, 1] / found[:, :1, 1]
    rows = [[f'{cells:g}', f'**{np.median(own):.3f}**', f'{own.min():.3f} to {own.max():.3f}',
             f'**{np.median(took):.1f}**']
            for cells, own, took in zip(CELLS, values.T, seconds.T, strict=True)]
    head = ('cell over reach', 'value, relative to the smallest cells: median', 'range',
            'time, relative to the largest cells: median')
    publish(options.results, 'cells', (
        f'{len(names)} maps of {NODES} nodes, seeds from {options.seed}, nodes a reach apart, '
        f'detour {DETOUR:g}. {conditions()}.\n\n{table(head, rows)}'))


if __name__ == '__main__':
    main()
