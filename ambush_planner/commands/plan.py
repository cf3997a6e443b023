# SPDX-License-Identifier: Apache-2.0
"""``ambush plan``: from a map to drawn routes."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from ..maps.occupancy import OccupancyOptions
from ..maps.risk_map import RiskMap
from ..maps.risk_map_file import agreed_crs
from ..planning.concerns import assumptions, concerns, is_sound
from ..planning.evaluation import evaluate
from ..planning.few_routes import MAX_ROUTES
from ..planning.plan import Plan
from ..planning.slots import SlotMixture, mix_slots
from ..planning.trip import ORDERS
from ..route_files import SUFFIXES, Drawn, draw, write_routes
from . import cli
from .console import percent, travel
from .few_files import SHEET, FewDrawn, map_of, tell_few, write_sheets
from .geo_files import FORMATS_HELP, add_outputs, check_outputs, tell_outputs, tell_overwritten
from .inputs import (
    MAP_HELP,
    OPTIONS_HELP,
    POSITION_HELP,
    add_crs,
    add_options,
    add_places,
    options_from,
    planned,
    risk_map_from,
)
from .slots import add_slots, checked_slots
from .terrain import add_terrain, terrain_from

DESCRIPTION = """\
Plan on a map and draw routes for a GPS or a GIS.

  ambush plan map.yaml --start 4 20 --goal 56 20 --reach 2 -n 20 -o routes.csv routes.png
  ambush plan map.tif --start 36.55,-84.38 --goal 36.70,-84.12 --reach 500 -o routes.gpx"""
EPILOG = f"""\
{MAP_HELP}
With --terrain, MAP is an elevation model (GeoTIFF or npz), converted as ambush terrain does. Next
to a FILE.json there is then the risk map, FILE_map.npz.

{POSITION_HELP}
{FORMATS_HELP}
With --routes, the files have a layer or track for each route, with its number and share, .png shows
each, and .json has them for ambush draw, which --help explains. The table on the console has the
faces of one or two dice (a first and a second one) and the cards that stand for each route, by the
nearest shares, and the value of each such draw.
With --slots, a time of departure is drawn for each route, as ambush slots does with one map: the
name and the attribute slot of a route have it. With --routes, ambush draw draws it.
{OPTIONS_HELP}
--json: {{"verdict", "files", "departures", "value", "lower_bound", "expected_length",
"shortest_length", "shortest_route_loss", "spotter": {{"x", "y", "loss", "factor"}}, "seconds",
"few": null, or with --routes {{"value", "lower_bound", "candidates", "worst_xy", "shares", "costs",
"curve", "draws"}}, "slots": null, or with --slots {{"value", "lower_bound", "shares", "drawn"}}}}
""" + cli.EXIT_CODES


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = cli.new_parser('plan', DESCRIPTION, EPILOG)
    made.add_argument('map', type=Path, metavar='MAP',
                      help='the risk map, or with --terrain an elevation model')
    add_places(made)
    number = made.add_mutually_exclusive_group()
    number.add_argument('-n', '--departures', type=cli.number(1, 1e4, int), default=1,
                        metavar='COUNT', help='number of routes to draw (default: 1)')
    number.add_argument('--routes', type=cli.number(1, MAX_ROUTES, int), metavar='K', help='find '
                        'the best mixture of at most K routes, and write these')
    made.add_argument('--equal', action='store_true', help='with --routes: K routes with equal '
                      'shares')
    add_outputs(made, suffixes=(*SUFFIXES, SHEET))
    made.add_argument('--order', choices=ORDERS, default='given',
                      help='order of the stops (default: given); random: drawn with each route')
    made.add_argument('--load', type=cli.number(0.0, 1.0), nargs='+', default=(), metavar='SHARE',
                      help='with --via: share of the loss that is aboard on each leg')
    add_slots(made)
    made.add_argument('--seed', type=cli.number(0, 2**63, int), metavar='N',
                      help='always draw the same routes; for tests only, as they can be predicted')
    add_crs(made)
    add_options(made)
    made.add_argument('--terrain', action='store_true', help='MAP is an elevation model')
    add_terrain(made.add_argument_group('with --terrain'))
    return made


def _work(arguments: argparse.Namespace, console: cli.Console) -> cli.Exit:
    options, slots = options_from(arguments), checked_slots(arguments.slots)
    _check(arguments)
    check_outputs(arguments.output)
    options = replace(options, game=replace(options.game, loads=tuple(arguments.load)))
    risk_map = (_map_of_terrain(arguments, options.map, console) if arguments.terrain
                else risk_map_from(arguments.map, options.map, console))
    rng = np.random.default_rng(arguments.seed)
    plan = planned(arguments, risk_map, options.planning, console, order=arguments.order,
                   routes=arguments.routes, equal=arguments.equal, rng=rng)
    day = mix_slots([plan.value] * len(slots), [plan.lower_bound] * len(slots),
                    arguments.window) if slots else None
    if arguments.seed is not None:
        console.say('Warning: drawn with --seed, so anyone who knows the seed can predict these '
                    'routes. Use it for tests only.')
    few = plan.few
    drawn = (draw(plan, arguments.departures, rng) if few is None
             else FewDrawn(plan.strategy, risk_map, few.paths, (), few))
    if day and few is None:
        drawn = replace(drawn, slots=[slots[k] for k in day.draw(arguments.departures, rng)])
    sheets = [path for path in arguments.output if path.suffix.lower() == SHEET]
    maps = [map_of(path) for path in sheets if arguments.terrain]
    tell_overwritten([*arguments.output, *maps], console)
    write_routes([path for path in arguments.output if path not in sheets], drawn)
    _tell(plan, console)
    if isinstance(drawn, FewDrawn):
        write_sheets(sheets, drawn, None if arguments.terrain else arguments.map, slots, day)
        tell_few(plan, drawn.few, console)
    if day:
        _tell_slots(slots, day, drawn, console)
    for text in concerns(plan):
        console.say(f'Warning: {text}.')
    tell_outputs([*arguments.output, *maps], drawn, console)
    return cli.Exit.HOLDS if is_sound(plan) else cli.Exit.FINDING


def _check(arguments: argparse.Namespace) -> None:
    """Raise UsageError if options are given without those that they need."""
    if arguments.window > 1 and not arguments.slots:
        raise cli.UsageError('--window needs --slots HH:MM ...')
    if arguments.routes is None:
        if arguments.equal:
            raise cli.UsageError('--equal needs --routes K')
        for path in arguments.output:
            if path.suffix.lower() == SHEET:
                raise cli.UsageError(f'{cli.place(path)}: only --routes K writes such a file')


def _map_of_terrain(arguments: argparse.Namespace, options: OccupancyOptions,
                    console: cli.Console) -> RiskMap:
    elevation, ground = terrain_from(arguments, arguments.map, console)
    return ground.risk_map(elevation.corner,
                           replace(options, crs=agreed_crs(elevation.crs, options.crs)))


def _tell(plan: Plan, console: cli.Console) -> None:
    strategy = plan.strategy
    shortest = evaluate(strategy)['energy_efficient'].v_repeated
    spotter = [f'one at ({seen.x:.1f}, {seen.y:.1f}) who sees whether you pass raises '
               f'{strategy.value:.4g} to {seen.loss:.4g}, {seen.factor:.2f} times'
               ] if (seen := plan.spotter) else []
    ends = [f'{bound:.4g} at least if nobody could wait within {plan.bottleneck.distance:.3g} m of '
            'start, stops and goal'] if (bound := plan.secured_bound) is not None else []
    longer = strategy.expected_length / strategy.shortest_length
    for name, text in (
        ('value', f'{strategy.value:.4g}: mean loss per departure if the ambusher plays best and '
                  'knows all but the draw'),
        ('lower bound', f'{strategy.lower_bound:.4g}: no planner can guarantee less on this '
                        'network'),
        ('mean length', f'{travel(strategy, strategy.expected_length)}, {longer:.2f} times the '
                        'shortest'),
        ('shortest route', f'would cost {shortest:.4g} once it is known'),
        *(('spotter', text) for text in spotter),
        *(('ends', text) for text in ends),
        *(('assumption', text) for text in assumptions(plan)),
    ):
        console.item(f'{name:<15} {text}', indent=0, hang=16)
    console.result = {
        'seconds': round(console.seconds, 1),
        'value': strategy.value, 'lower_bound': strategy.lower_bound,
        'expected_length': strategy.expected_length, 'shortest_length': strategy.shortest_length,
        'shortest_route_loss': shortest, 'spotter': seen and asdict(seen), 'few': None,
        'slots': None,
    }


def _tell_slots(slots: Sequence[str], day: SlotMixture, drawn: Drawn,
                console: cli.Console) -> None:
    shares = dict(zip(slots, day.shares.tolist(), strict=True))
    named = ', '.join(f'{slot} {percent(share)}' for slot, share in shares.items())
    console.line(f'{"slots":<15} {named}: joint value {day.value:.4g}, lower bound '
                 f'{day.lower_bound:.4g}')
    if drawn.slots:
        console.line(f'{"departures":<15} {", ".join(drawn.slots)}')
    console.result['slots'] = {'value': day.value, 'lower_bound': day.lower_bound,
                               'shares': shares, 'drawn': drawn.slots}


main = cli.command(parser, _work)
