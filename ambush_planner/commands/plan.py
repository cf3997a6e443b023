"""``ambush plan``: from a map to drawn routes."""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..errors import GoalOutsideMap, StartOutsideMap, StopOutsideMap
from ..maps.coordinates import Coordinates
from ..maps.occupancy import OccupancyOptions
from ..maps.risk_map import RiskMap
from ..maps.risk_map_file import agreed_crs
from ..planning.concerns import assumptions, concerns, is_sound
from ..planning.evaluation import evaluate
from ..planning.options import PlanningOptions
from ..planning.plan import Plan
from ..planning.trip import ORDERS, plan_trip
from . import cli
from .geo_files import FORMATS_HELP, add_outputs, draw, tell_outputs, write_outputs
from .inputs import (
    MAP_HELP,
    OPTIONS_HELP,
    POSITION_HELP,
    add_crs,
    add_options,
    add_places,
    crs_text,
    options_from,
    risk_map_from,
)
from .report_words import travel
from .terrain import add_terrain, terrain_from

EPILOG = f"""\
{MAP_HELP}
With --terrain, MAP is an elevation model (GeoTIFF or npz), converted as ambush terrain does.

{POSITION_HELP}
{FORMATS_HELP}
{OPTIONS_HELP}
--json: {{"verdict", "files", "departures", "value", "lower_bound", "expected_length",
"shortest_length", "shortest_route_loss", "seconds"}}
""" + cli.EXIT_CODES


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = cli.new_parser('plan', 'Plan on a map and draw routes for a GPS or a GIS.', EPILOG)
    made.add_argument('map', type=Path, metavar='MAP',
                      help='the risk map, or with --terrain an elevation model')
    add_places(made)
    made.add_argument('-n', '--departures', type=cli.number(1, 1e4, int), default=1,
                      metavar='COUNT', help='number of routes to draw (default: 1)')
    add_outputs(made)
    made.add_argument('--order', choices=ORDERS, default='given',
                      help='order of the stops (default: given)')
    made.add_argument('--seed', type=cli.number(0, 2**63, int), metavar='N',
                      help='always draw the same routes; for tests only, as they can be predicted')
    add_crs(made)
    add_options(made)
    made.add_argument('--terrain', action='store_true', help='MAP is an elevation model')
    add_terrain(made.add_argument_group('with --terrain'))
    return made


def _work(arguments: argparse.Namespace, console: cli.Console) -> cli.Exit:
    options = options_from(arguments)
    occupancy = replace(options.map, crs=crs_text(arguments) or options.map.crs)
    risk_map = (_map_of_terrain(arguments, occupancy, console) if arguments.terrain
                else risk_map_from(arguments.map, occupancy, console))
    with console.waiting('solving the game') as progress:
        plan = _plan(arguments, risk_map, options.planning, progress)
    if arguments.seed is not None:
        console.say('Warning: drawn with --seed, so anyone who knows the seed can predict these '
                    'routes. Use it for tests only.')
    drawn = draw(plan, arguments.departures, np.random.default_rng(arguments.seed))
    write_outputs(arguments.output, drawn)
    _tell(plan, console)
    for text in concerns(plan):
        console.say(f'Warning: {text}.')
    tell_outputs(arguments.output, drawn, console)
    return cli.Exit.HOLDS if is_sound(plan) else cli.Exit.FINDING


def _map_of_terrain(arguments: argparse.Namespace, options: OccupancyOptions,
                    console: cli.Console) -> RiskMap:
    elevation, ground = terrain_from(arguments, arguments.map, console)
    return ground.risk_map(elevation.corner,
                           replace(options, crs=agreed_crs(elevation.crs, options.crs)))


def _plan(arguments: argparse.Namespace, risk_map: RiskMap, options: PlanningOptions,
          progress: Callable[[float, float], None]) -> Plan:
    (start,), (goal,) = ([place.xy(risk_map) for place in getattr(arguments, end)]
                         for end in ('start', 'goal'))
    stops = [place.xy(risk_map) for place in arguments.via or ()]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter('ignore')  # the concerns tell more
            return plan_trip(risk_map, start, goal, options, stops=stops, order=arguments.order,
                             progress=progress)
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
    for name, text in (
        ('value', f'{strategy.value:.4g}: mean loss per departure if the ambusher plays best and '
                  'knows all but the draw'),
        ('lower bound', f'{strategy.lower_bound:.4g}: no planner can guarantee less on this '
                        'network'),
        ('mean length', f'{travel(strategy, strategy.expected_length)}, {longer:.2f} times the '
                        'shortest'),
        ('shortest route', f'would cost {shortest:.4g} once it is known'),
        *(('assumption', text) for text in assumptions(plan)),
    ):
        console.line(f'{name:<15} {text}')
    console.result = {
        'seconds': round(console.seconds, 1),
        'value': strategy.value, 'lower_bound': strategy.lower_bound,
        'expected_length': strategy.expected_length, 'shortest_length': strategy.shortest_length,
        'shortest_route_loss': shortest,
    }


main = cli.command(parser, _work)
