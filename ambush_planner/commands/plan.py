"""``ambush plan``: from a map to drawn routes."""

from __future__ import annotations

import argparse
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..errors import GoalOutsideMap, StartOutsideMap, StopOutsideMap
from ..maps.coordinates import Coordinates, InvalidCoordinates
from ..maps.occupancy import OccupancyOptions, risk_map_from_occupancy
from ..maps.risk_map import RiskMap
from ..maps.risk_map_file import agreed_crs
from ..planning.concerns import concerns
from ..planning.evaluation import evaluate
from ..planning.options import PlanningOptions
from ..planning.plan import Plan
from ..planning.trip import ORDERS, plan_trip
from . import cli
from .geo_files import FORMATS_HELP, add_outputs, draw, tell_outputs, write_outputs
from .inputs import MAP_HELP, OPTIONS_HELP, add_crs, add_set, crs_text, options_from, risk_map_from
from .report_words import distance, travel
from .terrain import add_terrain, terrain_from

EPILOG = f"""\
{MAP_HELP}
With --terrain, MAP is an elevation model (GeoTIFF or npz), converted as ambush terrain does.

A position is X Y, world coordinates [m], or LAT,LON [degrees], negative in the south and west.
{FORMATS_HELP}
{OPTIONS_HELP}
--json: {{"verdict", "files", "departures", "value", "lower_bound", "expected_length",
"shortest_length", "shortest_route_loss", "seconds"}}
""" + cli.EXIT_CODES


@dataclass(frozen=True)
class Position:
    """A position as it was typed: world coordinates [m], or latitude and longitude [degrees]."""

    numbers: tuple[float, float]
    in_degrees: bool

    def xy(self, risk_map: RiskMap) -> FloatArray:
        """World position [m]; raises InvalidCoordinates."""
        if not self.in_degrees:
            return np.array(self.numbers)
        if not risk_map.crs:
            raise InvalidCoordinates(
                f'{self.numbers[0]:g},{self.numbers[1]:g} is a latitude and longitude, but the '
                'coordinate system of the map is unknown; name it (--crs), or give X Y [m]')
        return Coordinates(risk_map.crs).from_lat_lon(self.numbers)


class _Positions(argparse.Action):
    """Parse ``X Y`` and ``LAT,LON``, one or several, and append them."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: argparse.Namespace,
                 values: Any, option_string: str | None = None) -> None:
        in_degrees = any(',' in text for text in values)
        try:
            numbers = [float(part) for text in values for part in text.split(',') if part]
            pairs = list(zip(numbers[::2], numbers[1::2], strict=True))
        except ValueError:
            parser.error(f'argument {option_string}: must be X Y [m] or LAT,LON [degrees], got '
                         f'{" ".join(values)!r}')
        if self.dest != 'via' and len(pairs) != 1:
            parser.error(f'argument {option_string}: must be one position')
        before = getattr(namespace, self.dest) or []
        setattr(namespace, self.dest, before + [Position(pair, in_degrees) for pair in pairs])


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = cli.new_parser('plan', 'Plan on a map and draw routes for a GPS or a GIS.', EPILOG)
    made.add_argument('map', type=Path, metavar='MAP',
                      help='the risk map, or with --terrain an elevation model')
    for end in ('--start', '--goal', '--via'):
        made.add_argument(end, nargs='+', action=_Positions, required=end != '--via', metavar='X Y',
                          help=('stops, ' if end == '--via' else '') + 'X Y [m] or LAT,LON')
    made.add_argument('-n', '--departures', type=cli.number(1, 1e4, int), default=1,
                      metavar='COUNT', help='number of routes to draw (default: 1)')
    add_outputs(made)
    made.add_argument('--order', choices=ORDERS, default='given',
                      help='order of the stops (default: given)')
    made.add_argument('--seed', type=cli.number(0, 2**63, int), metavar='N',
                      help='always draw the same routes; for tests only, as they can be predicted')
    add_crs(made)
    add_set(made)
    made.add_argument('--terrain', action='store_true', help='MAP is an elevation model')
    add_terrain(made.add_argument_group('with --terrain'))
    return made


def _work(arguments: argparse.Namespace, console: cli.Console) -> cli.Exit:
    options = options_from(arguments.set)
    occupancy = replace(options.map, crs=crs_text(arguments) or options.map.crs)
    risk_map = (_map_of_terrain(arguments, occupancy, console) if arguments.terrain
                else risk_map_from(arguments.map, occupancy, console))
    with console.waiting('solving the game'):
        plan = _plan(arguments, risk_map, options.planning)
    if arguments.seed is not None:
        console.say('Warning: drawn with --seed, so anyone who knows the seed can predict these '
                    'routes. Use it for tests only.')
    drawn = draw(plan, arguments.departures, np.random.default_rng(arguments.seed))
    write_outputs(arguments.output, drawn)
    _tell(plan, console)
    for text in concerns(plan):
        console.say(f'Warning: {text}.')
    tell_outputs(arguments.output, drawn, console)
    return cli.Exit.HOLDS


def _map_of_terrain(arguments: argparse.Namespace, options: OccupancyOptions,
                    console: cli.Console) -> RiskMap:
    elevation, ground = terrain_from(arguments, arguments.map, console)
    options = replace(options, crs=agreed_crs(elevation.crs, options.crs))
    return risk_map_from_occupancy(ground.values, ground.resolution, (*elevation.corner, 0.0),
                                   options)


def _plan(arguments: argparse.Namespace, risk_map: RiskMap, options: PlanningOptions) -> Plan:
    (start,), (goal,) = ([place.xy(risk_map) for place in getattr(arguments, end)]
                         for end in ('start', 'goal'))
    stops = [place.xy(risk_map) for place in arguments.via or ()]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter('ignore')  # the concerns tell more
            return plan_trip(risk_map, start, goal, options, stops=stops, order=arguments.order)
    except (StartOutsideMap, GoalOutsideMap, StopOutsideMap) as error:
        if not risk_map.crs:
            raise
        low, high = Coordinates(risk_map.crs).to_lat_lon(risk_map.bounds)
        raise type(error)(f'{error}; it spans latitudes {low[0]:.4f} to {high[0]:.4f} and '
                          f'longitudes {low[1]:.4f} to {high[1]:.4f}') from error


def _tell(plan: Plan, console: cli.Console) -> None:
    strategy = plan.strategy
    shortest = evaluate(strategy)['energy_efficient'].v_repeated
    longer = strategy.expected_length / strategy.shortest_length
    held = strategy.game.options.held_radius
    for name, text in (
        ('value', f'{strategy.value:.4g}: mean loss per departure if the ambusher plays best and '
                  'knows all but the draw'),
        ('lower bound', f'{strategy.lower_bound:.4g}: no planner can guarantee less on this '
                        'network'),
        ('mean length', f'{travel(strategy, strategy.expected_length)}, {longer:.2f} times the '
                        'shortest'),
        ('shortest route', f'would cost {shortest:.4g} once it is known'),
        ('assumption', f'nobody can wait within {distance(held)} of start, stops and goal'
                       if held else 'none: an ambush can wait anywhere, also at start and goal'),
    ):
        console.line(f'{name:<15} {text}')
    console.result = {
        'seconds': round(console.seconds, 1),
        'value': strategy.value, 'lower_bound': strategy.lower_bound,
        'expected_length': strategy.expected_length, 'shortest_length': strategy.shortest_length,
        'shortest_route_loss': shortest,
    }


main = cli.command(parser, _work)
