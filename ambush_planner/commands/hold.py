# SPDX-License-Identifier: Apache-2.0
"""``ambush hold``: which places to hold next."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from . import cli
from .planner_parser import planner_parser, source_names
from .positions import Position, read_ground

if TYPE_CHECKING:
    from ..maps.risk_map import RiskMap
    from ..operations.hold import Held, Holding

EPILOG = """\
PLACES has points with a name: a CSV file with name, and x, y or lat, lon, or a vector file.
The console has a line for each place, PICTURE.png the places on the map.
"""
DETAILS = """\
Finds the place that lowers the value of ambush plan most if nobody can wait within --radius of it,
and nobody who drives there is hit; then the next one, given the first, and so on.
In a line, value and lower bound are those if this place and those before it are held. The picture
also has the strategy if all are held.
It ends at strategy.time_limit (60 s) with the best so far, and complete is false then.
--json: {"verdict", "picture", "value", "lower_bound", "complete", "places": [{...}]}
"""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = planner_parser(
        'hold', 'Find the places whose holding lowers the value most.', EPILOG, DETAILS,
        '--start POSITION --goal POSITION --radius METRES [options] -o PICTURE.png',
        ('-k', '--radius', '--candidates'))
    made.add_argument('-k', '--count', type=cli.number(1, 100, int), default=5, metavar='K',
                      help='number of places to hold (default: 5)')
    made.add_argument('--radius', type=float, required=True, metavar='METRES',
                      help='radius of the area that holding a place secures')
    made.add_argument('--candidates', metavar='PLACES', help='the places that can '
                      "be held (default: places around the ambusher's sites)")
    made.add_argument('-o', '--output', type=cli.file_of('.png'), required=True,
                      metavar='PICTURE.png', help='the picture to write')
    return made


def _work(arguments: argparse.Namespace, console: cli.Console) -> cli.Exit:
    from .inputs import options_from

    of_map, planning = options_from(arguments)
    risk_map, start, goal, stops = read_ground(arguments, of_map)

    from ..game.strategy import within_slack
    from ..map_figures import as_png
    from ..operations.hold import places_to_hold
    from ..recordings.durable_files import write_all_durably
    from .hold_figure import hold_figure

    given = read_places(arguments.candidates, risk_map) if arguments.candidates else None
    limit = planning.strategy.time_limit
    with console.waiting(f'solving games, at most {limit:g} s (strategy.time_limit)'):
        found = places_to_hold(
            risk_map, start, goal, arguments.radius, arguments.count, planning,
            stops=stops, candidates=given, progress=lambda number, left: console.step(
                f'place {number}: {cli.count(left, "candidate")} may be the best'))
    rows = [_row(number, step, risk_map) for number, step in enumerate(found.steps, 1)]
    output = arguments.output
    write_all_durably({output: as_png(hold_figure(found, arguments.radius, risk_map), output.name,
                                      source_names(arguments))})
    _tell(found, rows, arguments.count, arguments.start[0], risk_map, console)
    if not found.complete:
        console.warn(f'time is up after {limit:g} s: the last place is the best of those tried; '
                     'to find better ones, name a few --candidates, or allow more time '
                     '(strategy.time_limit)')
    console.result['picture'] = console.secret([output])[0]
    sound = all(within_slack(step.strategy, planning.strategy) for step in found.steps)
    return cli.Exit.HOLDS if sound else cli.Exit.FINDING


def _row(number: int, step: Held, risk_map: RiskMap) -> dict[str, Any]:
    """The numbers of one place; lat and lon are for maps with a coordinate system."""
    from ..maps.coordinates import Coordinates

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
    if len(rows) < wanted and found.complete:
        console.say('No further place: the value is 0, or no candidate remains.')
    held = found.strategies[-1].game.options.held_places
    places = ','.join(f'[{x:.2f},{y:.2f},{radius:g}]' for x, y, radius in held)
    console.line(f"To plan with them: --set 'game.held_places=[{places}]'")
    console.result = {'value': before.value, 'lower_bound': before.lower_bound, 'places': rows,
                      'complete': found.complete}


def read_places(source: str, risk_map: RiskMap) -> dict[str, tuple[float, float]]:
    """World positions [m] by the names of points in a file; raises InvalidFeatures."""
    from ..maps.tables import InvalidFeatures
    from ..maps.vector_file import attribute, read_features_on

    points = read_features_on(risk_map, source, 'Point', crs=risk_map.crs,
                         refused='each place needs a position')
    names = attribute(points, 'candidates', 'name').astype(str).str.strip()
    if names.duplicated().any():
        raise InvalidFeatures(f'{source}: each place needs its own name, but '
                              f'{names[names.duplicated()].iloc[0]!r} stands there twice')
    return dict(zip(names, zip(points.geometry.x, points.geometry.y, strict=True), strict=True))


main = cli.command(parser, _work)
