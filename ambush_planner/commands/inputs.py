# SPDX-License-Identifier: Apache-2.0
"""Options of commands that plan, from their arguments."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Iterable
from dataclasses import fields, replace
from difflib import get_close_matches
from typing import Any

import yaml

from ..errors import InvalidOption
from ..game.game import GameOptions
from ..game.strategy import StrategyOptions
from ..gone import present_name, remedy_for
from ..maps.occupancy import OccupancyOptions
from ..maps.road_file import ROAD_OPTIONS
from ..network.construction import NetworkOptions
from ..planning.options import DriveOptions, PlanningOptions
from .cli import WORDS

# Default options by their groups, in which the time limit of a solve is the node's.
DEFAULTS: dict[str, Any] = {
    'map': OccupancyOptions(), 'network': NetworkOptions(), 'game': GameOptions(),
    'strategy': StrategyOptions(time_limit=60.0), 'route': DriveOptions()}
# Options that a plan or an argument of its own sets.
SET_BY_PLAN = ('game.tube', 'game.widened')
# What the types of options are called; the first one that a field's type names is its own.
_KINDS = {tuple: 'a list of lists', str: 'text', float: 'a number', int: 'a whole number',
          bool: 'true or false'}
_TYPES = {f'{group}.{each.name}': next(kind for kind in _KINDS if kind.__name__ in str(each.type))
          for group, part in DEFAULTS.items() for each in fields(part)
          if f'{group}.{each.name}' not in SET_BY_PLAN}
# How options are typed, by their names without the group; and other texts in messages.
_TYPED = {name.partition('.')[2]: f'--set {name}' for name in _TYPES} | {
    name.partition('.')[2]: f'--{word}' for word, (name, *_) in WORDS.items()} | {
    'graph': '--roads'} | {name: f'--{name.replace("_", "-")}' for name in ROAD_OPTIONS}
_PHRASES = {' (node_crossings)': '', ' (road_column, all_lines_are_roads)': '', ' (two_way)': '',
            ' (all_lines_are_roads)': '', ' (game.secured_radius -1)': ' (leave out --secured)',
            ' (strategy.time_limit, or max_planning_time of the node)':
            ' (--set strategy.time_limit=SECONDS)',
            'max_planning_time': 'strategy.time_limit'}
# Qualified names, and those that are no ordinary words.
_NAMED = re.compile(rf"(?<!--set )(?<!')(?<![.\w])((?:{'|'.join(DEFAULTS)})\.)?"
                    rf"({'|'.join(_TYPED)})(?!\w)")


def options_from(arguments: argparse.Namespace) -> tuple[OccupancyOptions, PlanningOptions]:
    """The options of a ``planner_parser``: for the map, and for the plan; raises InvalidOption.

    An option can be given once, by its word of ``WORDS`` or with ``--set``. The argument ``--crs``
    takes precedence over ``map.crs``.
    """
    if arguments.held is not None:
        present_name('--held')
        arguments.secured = arguments.held
    given = [f'{name}={_in_metres(value) if unit == "METRES" else value}'
             for word, (name, unit, _) in WORDS.items()
             if (value := getattr(arguments, word)) is not None]
    given += [f'network.{name}={str(value).lower() if value is True else value}'
              for name in ROAD_OPTIONS if (value := getattr(arguments, name))]
    if arguments.roads:
        given += ['network.method=graph', f'network.graph={arguments.roads}']
    of_map, of_plan = options_of([*arguments.set, *given])
    crs = arguments.crs
    return replace(of_map, crs=crs) if crs else of_map, of_plan


def options_of(assignments: Iterable[str]) -> tuple[OccupancyOptions, PlanningOptions]:
    """Parse assignments such as ``network.spacing=50``; raises InvalidOption.

    At the time limit, commands use the best strategy so far, and say what its gap is.
    """
    changes: dict[str, dict[str, Any]] = {group: {} for group in DEFAULTS}
    for assignment in assignments:
        name, _, text = assignment.partition('=')
        name = present_name(name) if '.' in name else name
        if name not in _TYPES:
            raise InvalidOption(remedy_for(name) or f'no option {name!r}; {_similar(name)}')
        if not text:
            raise InvalidOption(f'{name} has no value; write {name}=VALUE, without spaces')
        group, option = name.split('.')
        if option in changes[group]:
            raise InvalidOption(f'{name} has two values; give one')
        changes[group][option] = _value(name, text)
    network = changes['network']
    for option in ('graph', *ROAD_OPTIONS, 'join_distance'):
        if option in network and network.get('method') != 'graph':
            raise InvalidOption(f'network.{option} has no effect without roads '
                                '(network.method=graph)')
    of_map, network, game, strategy, route = (_changed(group, changes[group]) for group in DEFAULTS)
    return of_map, PlanningOptions(network=network, game=game, strategy=strategy, drive=route,
                                   max_gap=math.inf)


def _changed(group: str, changes: dict[str, Any]) -> Any:
    """Options of a group with changes; errors name the group, too."""
    try:
        return replace(DEFAULTS[group], **changes)
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


def as_typed(text: str) -> str:
    """A message that names options as they are typed: ``--reach``, ``--set network.spacing``."""
    for phrase, other in _PHRASES.items():
        text = text.replace(phrase, other)
    return _NAMED.sub(lambda found: _TYPED[found[2]] if found[1] or '_' in found[2] else found[0],
                      text)


def _similar(name: str) -> str:
    """The option that is meant, or all of them."""
    near = [f'--{name}'] if name in WORDS else [each for each in _TYPES
                                                if each.endswith(f'.{name}')]
    near = near or ([_PHRASES[name]] if name in _PHRASES else get_close_matches(name, _TYPES, 1))
    return f'did you mean {near[0]}?' if near else f'choose from {", ".join(sorted(_TYPES))}'


def _value(name: str, text: str) -> Any:
    kind = _TYPES[name]
    try:
        value = yaml.safe_load(text)
        if kind is float and not isinstance(value, bool):
            value = float(value)  # YAML reads 1e3 as text
        elif kind is tuple:
            value = tuple(map(tuple, value))
    except (yaml.YAMLError, TypeError, ValueError):
        value = None
    if type(value) is not kind:
        point = ', with a decimal point' if re.fullmatch(r'-?\d+,\d+\D*', text) else ''
        raise InvalidOption(f'{name} must be {_KINDS[kind]}{point}, got {text!r}')
    return value
