# SPDX-License-Identifier: Apache-2.0
"""The default plan against what the same ground, reach and length allow.

Each game is planned by default, from a finer first network, on a uniform network of 30 000 nodes,
and on a plain one of the default's size; with ``--before CHECKOUT`` also by the package of another
checkout. A row for each plan is appended to a file as it goes: run it in pieces. Rows that are
there are not planned again; ``--report`` plans nothing.
"""

from __future__ import annotations

import json
import math
import secrets
import time
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
from families import FAMILIES, SLOW, Problem
from one_run import Answer, run
from report import conditions, new_parser, publish, table
from scenarios import across, terrain

from ambush_planner import (
    DriveOptions,
    GameOptions,
    NetworkOptions,
    PlanningOptions,
    StrategyOptions,
    plan_trip,
    read_risk_map,
)

ROWS = Path('out/ground.jsonl')
YARD = Path(__file__).parents[1] / 'docs/yard.yaml'
CELLS = 200  # along the sides of maps that are drawn
REACH = 0.015, 0.1  # of the map's longer side
DETOUR = 1.1, 1.5
WAYS = ('default', 'fine', 'uniform', 'plain')
BEFORE = 'before'
FINE, NODES = 10_000, 30_000  # of the first network if it is fine, and of a uniform one
TUBE = 0.1  # of the reach, with a uniform network
# Names of families here, and of those of ``families`` that they are.
DRAWN = {'hills': 'hills-obstacles', 'rough': 'rough-obstacles', 'open': 'hills-coarse',
         'corridor': 'corridor', 'walls': 'building', 'city': 'city', 'maze': 'maze'}


def draw(family: str, seed: int) -> Problem:
    """The game of a family, or of a map by its path, that a seed draws."""
    rng = np.random.default_rng(seed)
    if family in DRAWN:
        scenario = FAMILIES[DRAWN[family]](rng, CELLS)
    elif family in SLOW:
        scenario = SLOW[family](rng, CELLS)
    else:
        scenario = terrain() if family == 'terrain' else across(
            read_risk_map(YARD if family == 'yard' else family), 0.06)
    reach = math.exp(rng.uniform(*np.log(REACH))) * max(scenario.risk_map.size)
    detour, secured = rng.uniform(*DETOUR), rng.choice([-1.0, 2.0 * reach])
    if family == 'terrain':
        reach, secured, detour = 500.0, 2000.0, 1.2
    elif family in SLOW:
        reach, secured, detour = 5.0, 10.0, 1.15
    options = PlanningOptions(game=GameOptions(ambush_radius=reach, secured_radius=secured),
                              strategy=StrategyOptions(max_detour=detour,
                                                       time_limit=math.inf))
    words = f'reach {reach:.3g} secured {secured:.3g} detour {detour:.3g}'
    return Problem(scenario, options, (), words)


def planned(name: str, way: str) -> Answer:
    """Value, bound and processor seconds of the game ``family:seed``, planned in one way."""
    family, seed = name.rsplit(':', 1)
    ground = draw(family, int(seed))
    plain, options = ground.scenario.risk_map, ground.options
    free = float((~plain.obstacles).sum()) * plain.resolution**2
    if way == 'fine':
        options = replace(options, network=NetworkOptions(target_nodes=FINE))
    elif way == 'plain':
        options = replace(options, network=NetworkOptions(refine=0))
    elif way == 'uniform':
        tube = TUBE * options.game.ambush_radius
        spacing = max(plain.resolution, math.sqrt(free / NODES))
        network, drive = NetworkOptions(spacing=spacing, refine=0), DriveOptions(tube=tube)
        options = replace(options, network=network, drive=drive)
    begin = time.process_time()
    plan = plan_trip(plain, ground.scenario.start, ground.scenario.goal, options)
    return {'seconds': time.process_time() - begin, 'value': plan.value, 'words': ground.words,
            'bound': plan.lower_bound, 'entropy': plan.strategy.route_entropy,
            'nodes': len(plan.network.points),
            'status': f'value {plan.value:.4g}, {len(plan.network.points)} nodes'}


def rows_in(file: Path) -> dict[tuple[str, str], Answer]:
    """The rows of a file by game and way."""
    lines = file.read_text().splitlines() if file.exists() else []
    return {(row['name'], row['way']): row for row in map(json.loads, lines)}


def summary(rows: dict[tuple[str, str], Answer]) -> str:
    """A row for each game and for all of them."""
    names = sorted({name for name, _ in rows})
    lines, columns = [], []
    for name in names:
        found = {way: rows.get((name, way), {}) for way in WAYS}
        values = {way: row['value'] for way, row in found.items() if 'value' in row}
        default = found['default']
        if 'value' not in default:
            lines.append([name, default.get('words', 'not planned'), *[''] * 7])
            continue
        over = default['value'] / min(values.values())
        gap = 1.0 - default['bound'] / default['value'] if default['value'] else 0.0
        columns.append((over, default['seconds'], gap))
        lines.append([name, default['words'], *(f'{values.get(way, math.nan):.4g}' for way in WAYS),
                      f'{over:.3f}', f"{default['seconds']:.1f}", f'{gap:.1%}'])
    figures = np.array(columns)
    for what, of in (('median', np.median), ('worst', np.max)) if columns else ():
        over, seconds, gap = of(figures, axis=0)
        lines.append([f'**{what}**', f'{len(figures)} of {len(names)}', *[''] * len(WAYS),
                      f'**{over:.3f}**', f'**{seconds:.1f}**', f'{gap:.1%}'])
    head = ('game', 'options', *WAYS, 'default over the best', 's', 'gap')
    return f'{conditions()}.\n\n{table(head, lines)}\n{comparison(rows)}'


def comparison(rows: dict[tuple[str, str], Answer]) -> str:
    """A row for each game that was also planned by another checkout; empty if there are none."""
    games = [(name, row, after) for (name, way), row in sorted(rows.items()) if way == BEFORE
             and row.get('entropy') and (after := rows.get((name, 'default'), {})).get('bound')]
    if not games:
        return ''
    figures = np.array([(before['seconds'], after['seconds'], after['value'] / before['value'],
                         after['entropy'] / before['entropy'],
                         after['value'] / after['bound'] - 1.0) for _, before, after in games])
    names = [name for name, _, _ in games]
    lines = [[name, *map('{:.4g}'.format, row)] for name, row in zip(names, figures, strict=True)]
    for what, of in (('median', np.median), ('least', np.min), ('largest', np.max)):
        lines.append([f'**{what}**', *map('{:.4g}'.format, of(figures, axis=0))])
    head = ('game', 's before', 's', 'value over before', 'entropy over before', 'gap')
    return f'\n{table(head, lines)}'


def main() -> None:
    parser = new_parser(__doc__)
    families = [*DRAWN, *SLOW, 'terrain', 'yard']
    parser.add_argument('--family', nargs='+', default=families,
                        help=f"of {', '.join(families)}, or the path of a map")
    parser.add_argument('--seed', type=int, default=secrets.randbelow(10**9),
                        help='the first seed, new in each run')
    parser.add_argument('--count', type=int, default=1, help='games of each family')
    parser.add_argument('--ways', nargs='*', default=list(WAYS), choices=WAYS)
    parser.add_argument('--before', type=Path, metavar='CHECKOUT', help='also plan with its code')
    parser.add_argument('--limit', type=float, default=300.0, help='of each plan [processor s]')
    parser.add_argument('--rows', type=Path, default=ROWS, help='file to which rows are appended')
    parser.add_argument('--report', action='store_true', help='only make the table')
    options = parser.parse_args()
    seeds = range(options.seed, options.seed + options.count)
    ways = [*options.ways, *([BEFORE] if options.before else [])]
    for family, seed, way in [] if options.report else product(
            options.family, seeds, ways):
        name = f'{family}:{seed}'
        if (name, way) in rows_in(options.rows):
            continue
        checkout = options.before if way == BEFORE else None
        answer = run('ground.planned', name, options.limit, checkout, way=way)
        options.rows.parent.mkdir(exist_ok=True)
        with options.rows.open('a') as file:
            print(json.dumps(answer | {'way': way}), file=file, flush=True)
    publish(options.results, 'ground', summary(rows_in(options.rows)))


if __name__ == '__main__':
    main()
