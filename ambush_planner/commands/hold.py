# SPDX-License-Identifier: Apache-2.0
"""``ambush hold``: which places to hold next."""

from __future__ import annotations

import argparse
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from .. import figures, map_figures
from ..colours import AMBUSHER
from ..game.strategy import within_slack
from ..maps.coordinates import Coordinates
from ..maps.risk_map import RiskMap
from ..maps.risk_map_file import read_risk_map
from ..maps.vector_file import InvalidFeatures, attribute, features_on
from ..operations.hold import Held, Holding, places_to_hold
from . import cli
from .geo_files import add_outputs, check_outputs, write_table
from .inputs import options_from, planner_parser
from .positions import Position, places_on

# Held places in the picture: a green that is none of the routes'.
HELD = '#35c48c'
NAME_WIDTH = 12  # characters in a line below the curve
EPILOG = """\
PLACES has points with a name: a CSV file with name, and x, y or lat, lon, or a vector file.
The table (.csv) has a row for each place, the picture (.png) the places on the map.
"""
DETAILS = """\
Finds the place that lowers the value of ambush plan most if nobody can wait within --radius of it,
and nobody who drives there is hit; then the next one, given the first, and so on.
In a row of the table, value and lower_bound are those if this place and those before it are held;
no other candidate can bring the value below others instead. The picture also has the strategy if
all are held, and the value as a curve.
--json: {"verdict", "files", "value", "lower_bound", "places": [{...}]}
"""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = planner_parser(
        'hold', 'Find the places whose holding lowers the value most.', EPILOG, DETAILS,
        '--start POSITION --goal POSITION --radius METRES [options] -o FILE ...',
        ('-k', '--radius', '--candidates'))
    made.add_argument('-k', '--count', type=cli.number(1, 100, int), default=5, metavar='K',
                      help='number of places to hold (default: 5)')
    made.add_argument('--radius', type=float, required=True, metavar='METRES',
                      help='radius of the area that holding a place secures')
    made.add_argument('--candidates', metavar='PLACES', help='the places that can '
                      "be held (default: places around the ambusher's sites)")
    add_outputs(made, 'table and picture to write', ('.csv', '.png'))
    return made


def _work(arguments: argparse.Namespace, console: cli.Console) -> cli.Exit:
    of_map, planning = options_from(arguments)
    risk_map = read_risk_map(arguments.map, of_map)
    check_outputs(arguments.output, console)
    start, goal, stops = places_on(arguments, risk_map)
    given = read_places(arguments.candidates, risk_map) if arguments.candidates else None
    with console.waiting('solving games'):
        found = places_to_hold(
            risk_map, start, goal, arguments.radius, arguments.count, planning,
            stops=stops, candidates=given, progress=lambda number, left: console.step(
                f'place {number}: {cli.count(left, "candidate")} may be the best'))
    rows = [_row(number, step, risk_map) for number, step in enumerate(found.steps, 1)]
    columns = rows[0] if rows else ('number', 'name', 'x', 'y', 'value', 'lower_bound')
    write_table(arguments.output, columns, rows,
                lambda: hold_figure(found, arguments.radius, risk_map))
    _tell(found, rows, arguments.count, arguments.start[0], risk_map, console)
    console.result['files'] = console.secret(arguments.output)
    sound = all(within_slack(step.strategy, planning.strategy) for step in found.steps)
    return cli.Exit.HOLDS if sound else cli.Exit.FINDING


def _row(number: int, step: Held, risk_map: RiskMap) -> dict[str, Any]:
    """The row of one place; the columns lat and lon are for maps with a coordinate system."""
    at = dict(zip('xy', step.xy, strict=True))
    if risk_map.crs:
        at |= zip(('lat', 'lon'), Coordinates(risk_map.crs).to_lat_lon([step.xy])[0], strict=True)
    return {'number': number, 'name': step.name, **at, 'value': step.strategy.value,
            'lower_bound': step.strategy.lower_bound,
            'others': step.others if step.candidates > 1 else None,
            'candidates': step.candidates, 'solved': step.solved}


def _tell(found: Holding, rows: list[dict[str, Any]], wanted: int, like: Position,
          risk_map: RiskMap, console: cli.Console) -> None:
    before = found.before
    console.line(f'{"none held":<26} {before.value:.4g}, lower bound {before.lower_bound:.4g}')
    for row in rows:
        at = row['name'] or like.like((row['x'], row['y']), risk_map)
        count = row['candidates'] - 1
        stay = 'the other candidate stays' if count == 1 else f'the other {count} candidates stay'
        others = '' if row['others'] is None else f'; {stay} above {row["others"]:.4g}'
        console.line(f'{row["number"]:>2} {at:<23} {row["value"]:.4g}, lower bound '
                     f'{row["lower_bound"]:.4g}{others}')
    if len(rows) < wanted:
        console.say('No further place: the value is 0, or no candidate remains.')
    held = found.strategies[-1].game.options.held_places
    places = ','.join(f'[{x:.2f},{y:.2f},{radius:g}]' for x, y, radius in held)
    console.line(f"To plan with them: --set 'game.held_places=[{places}]'")
    console.result = {'value': before.value, 'lower_bound': before.lower_bound, 'places': rows}


def hold_figure(found: Holding, radius: float, risk_map: RiskMap) -> Figure:
    """The places on the map, with the strategy if all are held, and below the value as a curve."""
    # Inches: a square map and its legend of up to these lines, which the layout does not reserve.
    lines = 2 + len(map_figures.ground_key(risk_map))
    heights = 6.1 + 0.3 * lines, 2.1
    figure = Figure(figsize=(map_figures.WIDTH, sum(heights)), layout='compressed')
    overview, curve = (part.subplots() for part in figure.subfigures(2, 1, height_ratios=heights))
    figures.draw_strategy(overview, found.strategies[-1], risk_map)
    held = f'{cli.count(len(found.steps), "place")} held (green)'
    overview.set_title(f'{held}\n{overview.get_title(loc="left")}', fontsize='medium', loc='left',
                     linespacing=1.4)
    for step in found.steps:
        overview.add_patch(Circle(step.xy, radius, color=HELD, alpha=0.35, linewidth=0, zorder=5))
    points = np.array([step.xy for step in found.steps]).reshape(-1, 2)
    apart = figures.BADGE * float(np.ptp(overview.get_xlim()))
    spots = figures.free_spots(points, figures.marks_of(found.strategies[-1]), apart)
    for k, spot in enumerate(spots):
        figures.number_badge(overview, k + 1, points[k], HELD, spot)
    style: dict[str, Any] = {'marker': 'o', 'markersize': 5, 'clip_on': False, 'zorder': 3}
    curve.plot([each.lower_bound for each in found.strategies], color='0.45', linestyle=':',
               label='lower bound', **style)
    curve.plot([each.value for each in found.strategies], color=AMBUSHER, label='value', **style)
    names = [fill(f'{number} {step.name}', NAME_WIDTH)
             for number, step in enumerate(found.steps, 1)]
    curve.set_xticks(range(len(found.strategies)), ['0', *names])
    curve.set(xlabel=f'places held, {radius:g} m around each', ylim=(0.0, None),
              ylabel='mean loss\nby the best ambush')
    curve.grid(color='0.92')
    curve.legend(frameon=False)
    return figure


def read_places(source: str, risk_map: RiskMap) -> dict[str, tuple[float, float]]:
    """World positions [m] by the names of points in a file; raises InvalidFeatures."""
    points = features_on(risk_map, source, 'Point', crs=risk_map.crs,
                         refused='each place needs a position')
    names = attribute(points, 'candidates', 'name').astype(str).str.strip()
    if names.duplicated().any():
        raise InvalidFeatures(f'{source}: each place needs its own name, but '
                              f'{names[names.duplicated()].iloc[0]!r} stands there twice')
    return dict(zip(names, zip(points.geometry.x, points.geometry.y, strict=True), strict=True))


main = cli.command(parser, _work)
