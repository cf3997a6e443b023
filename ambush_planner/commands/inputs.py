# SPDX-License-Identifier: Apache-2.0
"""Inputs of commands that solve games: a risk map, places, options."""

from __future__ import annotations

import argparse
import dataclasses
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import yaml

from ..arrays import FloatArray
from ..errors import InvalidOption
from ..game.game import GameOptions
from ..game.strategy import StrategyOptions
from ..maps.coordinates import Coordinates, InvalidCoordinates
from ..maps.grid_references import MGRS_REFERENCE, from_mgrs, mgrs_references
from ..maps.occupancy import OccupancyOptions
from ..maps.risk_map import RiskMap
from ..network.construction import NetworkOptions
from ..network.trip_graph import position_errors
from ..planning.options import DriveOptions, PlanningOptions
from .cli import new_parser

# Options of all commands that plan which their short help shows.
COMMON = ('-o', '--start', '--goal', '--via', '--reach', '--held', '--detour', '--slack', '--crs',
          '--set')
HELP = """\
MAP is a map of map_server (.yaml), a GeoTIFF, or an npz file; ambush risk makes one.
A POSITION is X Y in its metres, LAT,LON in degrees, or an MGRS reference.
"""
DETAILS = """
A GeoTIFF has the values of map_server, -1..100; an npz file has alpha and obstacles (H, W), row 0
the lowest, resolution [m] and, if they are known, origin (x, y, yaw) and crs, the coordinate
system. LAT and LON are negative in the south and west.
The options of --set are named like the node's parameters (map., network., game., strategy.,
route.), which docs/ros_interface.md explains, and have the defaults of the Python functions, except
that strategy.time_limit is 60 s.
"""
# Time limit of each solve [s], as the node's.
TIME_LIMIT = 60.0
# Options that a plan or an argument of its own sets.
SET_BY_PLAN = ('game.tube', 'game.widened', 'game.loads')
# What the node calls an option that has another name here.
OTHER_NAMES = {'max_planning_time': 'strategy.time_limit'}
KINDS = {float: 'a number', int: 'a whole number', bool: 'true or false', str: 'text',
         tuple: 'a list of lists'}
# Words for the options that every user sets.
WORDS = {
    'reach': ('game.ambush_radius', 'METRES', 'how far an ambusher reaches: 500, or 0.5km '
              '(default: 0, only the network nodes that he waits at)'),
    'held': ('game.secured_radius', 'METRES', 'radius of the area that you secure around '
             'start, stops and goal: nobody can wait there (default: as far as an ambush reaches: '
             'the reach and the tube)'),
    'detour': ('strategy.max_detour', 'RATIO', "largest mean length, as a multiple of the shortest "
               "route's (default: 1.2)"),
    'slack': ('strategy.risk_slack', 'SHARE', 'share of the value to give up for less predictable '
              'routes (default: 0.01)'),
}


@dataclass(frozen=True)
class SolveOptions:
    """Options from the values of a map to a strategy."""

    map: OccupancyOptions = field(default_factory=OccupancyOptions)
    network: NetworkOptions = field(default_factory=NetworkOptions)
    game: GameOptions = field(default_factory=GameOptions)
    strategy: StrategyOptions = field(
        default_factory=lambda: StrategyOptions(time_limit=TIME_LIMIT))
    route: DriveOptions = field(default_factory=DriveOptions)

    @property
    def planning(self) -> PlanningOptions:
        """All of them but those of the map, as ``plan_trip`` takes them.

        At the time limit, commands use the best strategy so far, and say what its gap is.
        """
        return PlanningOptions(network=self.network, game=self.game, strategy=self.strategy,
                               drive=self.route, max_gap=math.inf)


@dataclass(frozen=True)
class Position:
    """A position as it was typed: world coordinates [m], or latitude and longitude [degrees].

    ``as_mgrs``: the latter, typed as an MGRS reference.
    """

    numbers: tuple[float, float]
    in_degrees: bool
    as_mgrs: bool = False

    def like(self, xy: npt.ArrayLike, risk_map: RiskMap) -> str:
        """Another world position [m] on the map, written as this one was typed."""
        if not (self.in_degrees and risk_map.crs):
            x, y = np.asarray(xy, dtype=float).tolist()
            return f'({x:.1f}, {y:.1f})'
        lat, lon = Coordinates(risk_map.crs).to_lat_lon(xy).tolist()
        if self.as_mgrs:
            return mgrs_references(np.array([(lat, lon)]))[0]
        return f'{lat:.5f},{lon:.5f}'

    def __str__(self) -> str:
        return ('{:g},{:g}' if self.in_degrees else '{:g} {:g}').format(*self.numbers)

    def xy(self, risk_map: RiskMap) -> FloatArray:
        """World position [m]; raises InvalidCoordinates."""
        if not self.in_degrees:
            return np.array(self.numbers)
        if not risk_map.crs:
            raise InvalidCoordinates(
                f'{self} is a latitude and longitude, but the coordinate system of the map is '
                'unknown; name it (--crs), or give X Y [m]')
        return Coordinates(risk_map.crs).from_lat_lon(self.numbers)

    def is_on(self, risk_map: RiskMap) -> bool:
        """Whether the position lies on a map with a coordinate system."""
        try:
            return bool(risk_map.contains(risk_map.to_map_axes(self.xy(risk_map))))
        except InvalidCoordinates:
            return False


_POSITIONS = {'--start': 'where trips begin', '--via': 'stops',
              '--goal': 'where trips end; the start again for a round trip'}


class _Positions(argparse.Action):
    """Parse ``X Y``, ``LAT,LON`` and MGRS references, one or several, and append them."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: argparse.Namespace,
                 values: Any, option_string: str | None = None) -> None:
        texts = [''.join(values)] if MGRS_REFERENCE.match(''.join(values)) else values
        as_mgrs = any(MGRS_REFERENCE.match(text) for text in texts)
        in_degrees = any(',' in text or MGRS_REFERENCE.match(text) for text in texts)
        try:
            numbers = [float(part) for text in texts for part in _parts(text)]
            pairs = list(zip(numbers[::2], numbers[1::2], strict=True))
        except ValueError:
            parser.error(f'argument {option_string}: must be X Y [m], LAT,LON [degrees] or an MGRS '
                         f'reference, got {" ".join(values)!r}')
        before = getattr(namespace, self.dest) or []
        if self.dest != 'via' and len(before) + len(pairs) != 1:
            parser.error(f'argument {option_string}: must be one position')
        setattr(namespace, self.dest,
                before + [Position(pair, in_degrees, as_mgrs) for pair in pairs])


def _parts(text: str) -> Sequence[str | float]:
    """The numbers of a position, or of a part of it."""
    if MGRS_REFERENCE.match(text):
        return from_mgrs(text)
    return [part for part in text.split(',') if part]


def planner_parser(command: str, description: str, epilog: str, details: str, usage: str,
                   common: Sequence[str] = (), stops: bool = True,
                   hidden: str = '') -> argparse.ArgumentParser:
    """Return the parser of a command that plans: with a map, places, options, ``--crs``.

    ``epilog``, ``details`` and ``usage`` are as in ``new_parser``; ``common`` are the command's own
    options in its short help. Help omits the option ``hidden``.
    """
    parser = new_parser(command, description, HELP + epilog, (*COMMON, *common), DETAILS + details,
                        f'ambush {command} MAP {usage}')
    parser.add_argument('map', type=Path, metavar='MAP', help='the risk map')
    _add_places(parser, stops)
    _add_options(parser, hidden)
    add_crs(parser)
    return parser


def _add_places(parser: argparse.ArgumentParser, stops: bool) -> None:
    """Add the arguments ``--start``, ``--goal`` and perhaps ``--via``, lists of ``Position``."""
    for end in ('--start', '--goal', *['--via'] * stops):
        parser.add_argument(end, nargs='+', action=_Positions, required=end != '--via',
                            metavar='POSITION', help=_POSITIONS[end])


def _add_options(parser: argparse.ArgumentParser, hidden: str) -> None:
    """Add the arguments of ``WORDS`` and ``--set``, for ``options_from``; help omits ``hidden``."""
    for word, (_, unit, text) in WORDS.items():
        parser.add_argument(f'--{word}', metavar=unit,
                            help=argparse.SUPPRESS if word == hidden else text)
    parser.add_argument('--node-crossings', action='store_true', help='roads also meet where they '
                        'cross without a shared vertex (network.node_crossings)')
    parser.add_argument('--set', nargs='+', default=[], metavar='NAME=VALUE',
                        help='other options: network.spacing=50 game.ambushers=2')


def add_crs(parser: argparse._ActionsContainer) -> None:
    """Add the arguments ``--crs`` and ``--datum``, for ``crs_text``."""
    crs = parser.add_mutually_exclusive_group()
    crs.add_argument('--crs', default='', metavar='SYSTEM', help='coordinate system of a map '
                     'whose file does not say it, such as EPSG:32616')
    crs.add_argument('--datum', type=float, nargs=3, metavar=('LAT', 'LON', 'YAW'),
                     help="for a map in a robot's frame: position of its origin and direction of "
                     "x [rad from east], as in navsat_transform's parameter datum")


def crs_text(arguments: argparse.Namespace) -> str:
    """Return the coordinate system that the arguments name, as ``Coordinates`` reads it, or ''."""
    if arguments.datum:
        return 'datum ' + ' '.join(f'{number:.12g}' for number in arguments.datum)
    return str(arguments.crs)


def options_from(arguments: argparse.Namespace) -> SolveOptions:
    """The options of a ``planner_parser``; raises InvalidOption.

    An option can be given once, by its word of ``WORDS`` or with ``--set``. The arguments of
    ``add_crs`` take precedence over ``map.crs``.
    """
    words = {word: getattr(arguments, word) for word in WORDS}
    given = [f'{WORDS[word][0]}={_in_metres(value) if WORDS[word][1] == "METRES" else value}'
             for word, value in words.items() if value is not None]
    given += ['network.node_crossings=true'] * arguments.node_crossings
    if getattr(arguments, 'roads', None):
        given += ['network.method=graph', f'network.graph={arguments.roads}']
    options = options_of([*arguments.set, *given])
    if 'crs' in arguments and (crs := crs_text(arguments)):
        options = dataclasses.replace(options, map=dataclasses.replace(options.map, crs=crs))
    return options


def places_on(arguments: argparse.Namespace,
              risk_map: RiskMap) -> tuple[FloatArray, FloatArray, list[FloatArray]]:
    """Start, goal and stops (x, y) [m] of ``add_places``.

    Raises InvalidCoordinates, and the errors of ``position_errors`` if a position is off the map.
    """
    (start,), (goal,) = arguments.start, arguments.goal
    stops = enumerate(getattr(arguments, 'via', None) or (), start=1)
    return (_xy('start', start, risk_map), _xy('goal', goal, risk_map),
            [_xy(f'stop {k}', stop, risk_map) for k, stop in stops])


def _xy(name: str, given: Position, risk_map: RiskMap) -> FloatArray:
    if not risk_map.crs or given.is_on(risk_map):
        return given.xy(risk_map)
    low, high = Coordinates(risk_map.crs).to_lat_lon(risk_map.bounds)
    (left, bottom), (right, top) = np.asarray(risk_map.bounds).tolist()
    extent = (f'latitude {low[0]:.4f} to {high[0]:.4f}, longitude {low[1]:.4f} to {high[1]:.4f}'
              if given.in_degrees else f'x {left:.0f} to {right:.0f}, y {bottom:.0f} to {top:.0f}')
    raise position_errors(name)[0](
        f'{name} {given} is outside the map ({extent}){_hint(given, risk_map)}')


def _hint(given: Position, risk_map: RiskMap) -> str:
    """The latitude and longitude on the map that was meant: other signs, or the other order."""
    a, b = given.numbers
    for (one, other), north, east in product(((a, b), (b, a)), (1.0, -1.0), (1.0, -1.0)):
        meant = Position((north * one, east * other), True)
        if meant.is_on(risk_map):
            return f'; did you mean {meant}? Write LAT,LON, negative in the south and west'
    return ''


def options_of(assignments: Sequence[str]) -> SolveOptions:
    """Parse assignments such as ``network.spacing=50``; raises InvalidOption."""
    options = vars(SolveOptions())
    names = {f'{group}.{field.name}': str(field.type)
             for group, part in options.items() for field in dataclasses.fields(part)
             if f'{group}.{field.name}' not in SET_BY_PLAN}
    changes: dict[str, dict[str, Any]] = {group: {} for group in options}
    for assignment in assignments:
        name, _, text = assignment.partition('=')
        if name not in names:
            raise InvalidOption(f'no option {name!r}; {_similar(name, names)}')
        if not text:
            raise InvalidOption(f'{name} has no value; write {name}=VALUE, without spaces')
        group, option = name.split('.')
        if option in changes[group]:
            raise InvalidOption(f'{name} has two values; give one')
        kind = next(kind for kind in (tuple, str, float, int, bool) if kind.__name__ in names[name])
        changes[group][option] = _value(name, text, kind)
    network = changes['network']
    for name in ('graph', 'node_crossings', 'join_distance'):
        if name in network and network.get('method') != 'graph':
            raise InvalidOption(f'network.{name} has no effect without network.method=graph')
    return SolveOptions(**{group: _changed(group, part, changes[group])
                           for group, part in options.items()})


def _changed(group: str, part: Any, changes: dict[str, Any]) -> Any:
    """Options of a group with changes; errors name the group, too."""
    try:
        return dataclasses.replace(part, **changes)
    except InvalidOption as error:
        name = next((each for each in changes if str(error).startswith(each)), '')
        raise InvalidOption(f'{group}.{error}' if name else str(error)) from error


def _in_metres(text: str) -> str:
    """A length in metres, of one with a unit, such as 300m or 0.3km."""
    found = re.fullmatch(r'\s*([-+.\de]+)\s*(k?)m\s*', text)
    try:
        return f'{float(found[1]) * (1000.0 if found[2] else 1.0):.12g}' if found else text
    except ValueError:
        return text


_FIELDS = {each.name: f'{group}.{each.name}' for group, part in vars(SolveOptions()).items()
           for each in dataclasses.fields(part)}
_PHRASES = {'--node-crossings (network.node_crossings)': '--node-crossings',
            ' (game.secured_radius -1)': ' (leave out --held)',
            ' (strategy.time_limit, or max_planning_time of the node)': ' (strategy.time_limit)',
            'max_planning_time': 'strategy.time_limit', 'game.loads': '--load'}
# Qualified names, and those that are no ordinary words.
_NAMED = re.compile(r"(?<!--set )(?<!')(?<![.\w])(?:(?:map|network|game|strategy|route)\.)?("
                    + '|'.join(_FIELDS) + r')(?!\w)')


def as_typed(text: str) -> str:
    """A message that names options as they are typed: ``--reach``, ``--set network.spacing``."""
    for phrase, other in _PHRASES.items():
        text = text.replace(phrase, other)

    def typed(found: re.Match[str]) -> str:
        name = found[1]
        if '.' not in found[0] and '_' not in name:
            return found[0]
        flags = [f'--{word}' for word, (each, *_) in WORDS.items() if each == _FIELDS[name]]
        return flags[0] if flags else f'--set {_FIELDS[name]}'

    return _NAMED.sub(typed, text)


def _similar(name: str, names: Iterable[str]) -> str:
    """The option that is meant, or all of them."""
    near = [f'--{name}'] if name in WORDS else [each for each in names if each.endswith(f'.{name}')]
    near = near or ([OTHER_NAMES[name]] if name in OTHER_NAMES
                    else get_close_matches(name, names, 1))
    return f'did you mean {near[0]}?' if near else f'choose from {", ".join(sorted(names))}'


def _value(name: str, text: str, kind: type) -> Any:
    try:
        value = yaml.safe_load(text)
        if kind is float and not isinstance(value, bool):
            value = float(value)  # YAML reads 1e3 as text
        elif kind is tuple:
            value = tuple(map(tuple, value))
    except (yaml.YAMLError, TypeError, ValueError):
        value = None
    if type(value) is not kind:
        raise InvalidOption(f'{name} must be {KINDS[kind]}, got {text!r}')
    return value
