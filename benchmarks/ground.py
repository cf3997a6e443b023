# SPDX-License-Identifier: Apache-2.0
"""The default plan against what the same ground, reach and length allow.

Each game is planned by default, from a finer first network, on a uniform network of 30 000 nodes,
and on a plain one of the default's size; with ``--before``, also by another checkout, and a second
table compares the two. A row for each plan is appended to a file as it goes: run it in pieces. Rows
that are there are not planned again; ``--report`` plans nothing.
"""

from __future__ import annotations

import argparse
import json
import math
import secrets
import time
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
from families import FAMILIES, Problem
from one_run import Answer, run
from report import conditions, new_parser, publish, table
from scenarios import Scenario, across, terrain
from scipy.ndimage import gaussian_filter

from ambush_planner import (
    DriveOptions,
    GameOptions,
    NetworkOptions,
    PlanningOptions,
    RiskMap,
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
BEFORE = 'before'  # by default, by another checkout
FINE, NODES = 10_000, 30_000  # of the first network if it is fine, and of a uniform one
TUBE = 0.1  # of the reach, with a uniform network
SHIFTS = 10
# Names of families here, and of those of ``families`` that they are.
DRAWN = {'hills': 'hills-obstacles', 'rough': 'rough-obstacles', 'open': 'hills-coarse',
         'corridor': 'corridor', 'walls': 'building', 'city': 'city', 'maze': 'maze'}
# Maps that refine to large networks, with a reach of 5 m, 10 m secured and a detour of 1.15.
SLOW = ('slow hills', 'slow rough', 'slow walls')


def draw(family: str, seed: int) -> Problem:
    """The game of a family, or of a map by its path, that a seed draws."""
    rng = np.random.default_rng(seed)
    if family in SLOW:
        options = PlanningOptions(game=GameOptions(ambush_radius=5.0, secured_radius=10.0),
                                  strategy=StrategyOptions(max_detour=1.15, time_limit=math.inf))
        return Problem(across(_slow_map(family, rng), 0.06), options, (), 'reach 5 detour 1.15')
    if family in DRAWN:
        scenario = FAMILIES[DRAWN[family]](rng, CELLS)
    else:
        scenario = terrain() if family == 'terrain' else across(
            read_risk_map(YARD if family == 'yard' else family), 0.06)
    reach = math.exp(rng.uniform(*np.log(REACH))) * max(scenario.risk_map.size)
    detour, secured = rng.uniform(*DETOUR), rng.choice([-1.0, 2.0 * reach])
    if family == 'terrain':
        reach, secured, detour = 500.0, 2000.0, 1.2
    options = PlanningOptions(game=GameOptions(ambush_radius=reach, secured_radius=secured),
                              strategy=StrategyOptions(max_detour=detour,
                                                       time_limit=math.inf))
    words = f'reach {reach:.3g} held {secured:.3g} detour {detour:.3g}'
    return Problem(scenario, options, (), words)


def _slow_map(family: str, rng: np.random.Generator) -> RiskMap:
    """Waves or noise with obstacles on top, or noise with walls along the axes."""
    shape = CELLS, CELLS
    if family == 'slow hills':
        y, x = (np.indices(shape) + 0.5) / CELLS
        risk = sum(np.sin(7.0 * (a * x + b * y) + 3.0 * c) for a, b, c in rng.normal(size=(6, 3)))
        obstacles = risk > np.quantile(risk, 0.92)
    elif family == 'slow rough':
        risk, other = (gaussian_filter(rng.normal(size=shape), size) for size in (6.0, 9.0))
        obstacles = other > np.quantile(other, 0.9)
    else:
        obstacles = np.zeros(shape, dtype=bool)
        for _ in range(26):
            (x, y), length = rng.integers(10, CELLS - 10, 2), rng.integers(20, 60)
            along, wide = slice(x, x + length), slice(y - 1, y + 1)
            obstacles[(wide, along) if rng.random() < 0.5 else (along, wide)] = True
        risk = gaussian_filter(rng.normal(size=shape), 10.0)
    return RiskMap(1.0 + 9.0 * (risk - risk.min()) / np.ptp(risk), obstacles, 1.0)


def shifted(scenario: Scenario, number: int, spacing: float) -> Scenario:
    """The scenario with obstacle cells added on the left and below, which shifts the lattice.

    Shift 0 is the scenario itself; the others are less than a spacing [m], at random.
    """
    if number == 0:
        return scenario
    plain = scenario.risk_map
    most = max(2, math.ceil(spacing / plain.resolution))
    below, left = np.random.default_rng(number).integers(0, most, 2)
    pad = ((below, 0), (left, 0))
    x, y = plain.to_world(np.array([-left, -below]) * plain.resolution).tolist()
    risk_map = RiskMap(np.pad(plain.alpha, pad, constant_values=1.0),
                       np.pad(plain.obstacles, pad, constant_values=True),
                       plain.resolution, (x, y, plain.origin[2]))
    return replace(scenario, risk_map=risk_map)


def planned(name: str, way: str, shift: int) -> Answer:
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
    coarse = math.sqrt(free / NetworkOptions.target_nodes)
    scenario = shifted(ground.scenario, shift, min(coarse, options.game.ambush_radius))
    begin = time.process_time()
    plan = plan_trip(scenario.risk_map, scenario.start, scenario.goal, options)
    return {'seconds': time.process_time() - begin, 'value': plan.value, 'words': ground.words,
            'bound': plan.lower_bound, 'entropy': plan.trip.route_entropy,
            'nodes': len(plan.network.points),
            'status': f'value {plan.value:.4g}, {len(plan.network.points)} nodes'}


def rows_in(file: Path) -> dict[tuple[str, str, int], Answer]:
    """The rows of a file by game, way and shift."""
    lines = file.read_text().splitlines() if file.exists() else []
    return {(row['name'], row['way'], row['shift']): row for row in map(json.loads, lines)}


def work(options: argparse.Namespace) -> Iterator[tuple[str, str, int]]:
    """The plans to make: game, way and shift."""
    seeds = range(options.seed, options.seed + options.count)
    for family, seed in product(options.family, seeds):
        for way in [*options.ways, *[BEFORE] * (options.before is not None)]:
            yield f'{family}:{seed}', way, 0
        for shift in range(1, options.shifts):
            yield f'{family}:{seed}', 'default', shift


def summary(rows: dict[tuple[str, str, int], Answer]) -> str:
    """A row for each game and for all of them."""
    names = sorted({name for name, _, shift in rows if shift == 0})
    lines, columns = [], []
    for name in names:
        found = {way: rows.get((name, way, 0), {}) for way in WAYS}
        values = {way: row['value'] for way, row in found.items() if 'value' in row}
        default = found['default']
        if 'value' not in default:
            lines.append([name, default.get('words', 'not planned'), *[''] * 6])
            continue
        over = default['value'] / min(values.values())
        gap = 1.0 - default['bound'] / default['value'] if default['value'] else 0.0
        same = [rows[key]['value'] for key in rows
                if key[:2] == (name, 'default') and 'value' in rows[key]]
        spread = np.ptp(same) / np.median(same) if len(same) > 1 else math.nan
        columns.append((over, default['seconds'], gap, spread))
        lines.append([name, default['words'], *(f'{values.get(way, math.nan):.4g}' for way in WAYS),
                      f'{over:.3f}', f"{default['seconds']:.1f}", f'{gap:.1%}', f'{spread:.1%}'])
    figures = np.array(columns)
    for what, of in (('median', np.nanmedian), ('worst', np.nanmax)) if columns else ():
        over, seconds, gap, spread = of(figures, axis=0)
        lines.append([f'**{what}**', f'{len(figures)} of {len(names)}', *[''] * len(WAYS),
                      f'**{over:.3f}**', f'**{seconds:.1f}**', f'{gap:.1%}', f'{spread:.1%}'])
    head = ('game', 'options', *WAYS, 'default over the best', 's', 'gap', 'spread')
    return f'{conditions()}.\n\n{table(head, lines)}'


def comparison(rows: dict[tuple[str, str, int], Answer]) -> str:
    """A row for each game that was also planned before, with medians and worst of all of them."""
    lines, columns = [], []
    for name in sorted({name for name, way, _ in rows if way == BEFORE}):
        before, after = rows[name, BEFORE, 0], rows.get((name, 'default', 0), {})
        if 'value' in before and 'value' in after:
            seconds = before['seconds'], after['seconds']
            gaps = [100.0 * (each['value'] / each['bound'] - 1.0) for each in (before, after)]
            columns.append((after['value'] / before['value'], *seconds, *gaps,
                            after['entropy'] / before['entropy']))
            lines.append([name, *_figures(columns[-1])])
    if not columns:
        return ''
    figures = np.array(columns)
    worst = [*figures[:, :5].max(axis=0), figures[:, 5].min()]
    lines.append(['**median**', *_figures(np.median(figures, axis=0))])
    lines.append(['**worst**', *_figures(worst)])
    head = ('game', 'value over before', 's before', 's', 'gap before [%]', 'gap [%]',
            'entropy over before')
    return f'\n\n{table(head, lines)}'


def _figures(columns: Iterable[float]) -> list[str]:
    return [f'{each:.3f}' if k in (0, 5) else f'{each:.2f}' for k, each in enumerate(columns)]


def main() -> None:
    parser = new_parser(__doc__)
    families = [*DRAWN, *SLOW, 'terrain', 'yard']
    parser.add_argument('--family', nargs='+', default=families,
                        help=f"of {', '.join(families)}, or the path of a map")
    parser.add_argument('--seed', type=int, default=secrets.randbelow(10**9),
                        help='the first seed, new in each run')
    parser.add_argument('--count', type=int, default=1, help='games of each family')
    parser.add_argument('--ways', nargs='*', default=list(WAYS), choices=WAYS)
    parser.add_argument('--shifts', type=int, default=1, help=f'of the lattice, such as {SHIFTS}')
    parser.add_argument('--before', type=Path, help='another checkout, to compare with')
    parser.add_argument('--limit', type=float, default=300.0, help='of each plan [processor s]')
    parser.add_argument('--rows', type=Path, default=ROWS, help='file to which rows are appended')
    parser.add_argument('--report', action='store_true', help='only make the table')
    options = parser.parse_args()
    for name, way, shift in [] if options.report else work(options):
        if (name, way, shift) in rows_in(options.rows):
            continue
        answer = run('ground.planned', name, options.limit,
                     options.before if way == BEFORE else None, way=way, shift=shift)
        options.rows.parent.mkdir(exist_ok=True)
        with options.rows.open('a') as file:
            print(json.dumps(answer | {'way': way, 'shift': shift}), file=file, flush=True)
    rows = rows_in(options.rows)
    publish(options.results, 'ground', summary(rows) + comparison(rows))


if __name__ == '__main__':
    main()
