"""Inputs of commands that solve games: a risk map, a ``--set`` of options."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ..errors import InvalidOption
from ..game.game import GameOptions
from ..game.strategy import StrategyOptions
from ..maps.occupancy import NO_RISK, OccupancyOptions
from ..maps.risk_map import RiskMap
from ..maps.risk_map_file import read_risk_map
from ..network.construction import NetworkOptions
from ..planning.options import DriveOptions, PlanningOptions
from .console import Console

MAP_HELP = """\
MAP is a YAML file for map_server, as ambush risk and ambush terrain write it, a GeoTIFF of the
same values, -1..100, or an npz file with alpha and obstacles (H, W), row 0 the lowest, resolution
[m] and, if they are known, origin (x, y, yaw) and crs, the coordinate system."""
OPTIONS_HELP = """\
Options are named like the node's parameters (map., network., game., strategy., route.), which
docs/ros_interface.md explains, and have the defaults of the Python functions."""


@dataclass(frozen=True)
class SolveOptions:
    """Options from the values of a map to a strategy."""

    map: OccupancyOptions = field(default_factory=OccupancyOptions)
    network: NetworkOptions = field(default_factory=NetworkOptions)
    game: GameOptions = field(default_factory=GameOptions)
    strategy: StrategyOptions = field(default_factory=StrategyOptions)
    route: DriveOptions = field(default_factory=DriveOptions)

    @property
    def planning(self) -> PlanningOptions:
        """All of them but those of the map, as ``plan_trip`` takes them."""
        return PlanningOptions(self.network, self.game, self.strategy, self.route)


def add_set(parser: argparse.ArgumentParser) -> None:
    """Add the argument ``--set``, for ``options_from``."""
    parser.add_argument('--set', nargs='+', default=[], metavar='NAME=VALUE',
                        help='options, such as network.spacing=50 strategy.max_detour=1.3')


def add_crs(parser: argparse.ArgumentParser) -> None:
    """Add the arguments ``--crs`` and ``--datum``, for ``crs_text``."""
    crs = parser.add_mutually_exclusive_group()
    crs.add_argument('--crs', default='', metavar='SYSTEM', help='coordinate system of the map, '
                     'such as EPSG:32616 (default: as its file says)')
    add_datum(crs)


def add_map_output(parser: argparse.ArgumentParser) -> None:
    """Add the option of a command that writes a map."""
    parser.add_argument('-o', '--output', type=Path, required=True, metavar='MAP.yaml',
                        help='the map to write')


def add_datum(parser: argparse._ActionsContainer) -> None:
    """Add the argument ``--datum``, for ``crs_text``."""
    parser.add_argument('--datum', type=float, nargs=3, metavar=('LAT', 'LON', 'YAW'),
                        help="for a map in a robot's frame: position of its origin and direction "
                        "of x [rad from east], as in navsat_transform's parameter datum")


def crs_text(arguments: argparse.Namespace) -> str:
    """Return the coordinate system that the arguments name, as ``Coordinates`` reads it, or ''."""
    if arguments.datum:
        return 'datum ' + ' '.join(f'{number:.12g}' for number in arguments.datum)
    return str(arguments.crs)


def options_from(assignments: Sequence[str]) -> SolveOptions:
    """Parse assignments such as ``network.spacing=50``; raises InvalidOption."""
    options = vars(SolveOptions())
    names = [f'{group}.{option}' for group, part in options.items() for option in vars(part)]
    changes: dict[str, dict[str, Any]] = {group: {} for group in options}
    for assignment in assignments:
        name, _, text = assignment.partition('=')
        if name not in names:
            raise InvalidOption(f'no option {name!r}; choose from {", ".join(sorted(names))}')
        group, option = name.split('.')
        changes[group][option] = _value(name, text, type(getattr(options[group], option)))
    return SolveOptions(**{group: dataclasses.replace(part, **changes[group])
                           for group, part in options.items()})


def risk_map_from(path: Path, options: OccupancyOptions, console: Console) -> RiskMap:
    """Read a risk map, and warn if it carries no risk; raises as ``read_risk_map`` does."""
    risk_map = read_risk_map(path, options)
    losses = risk_map.alpha[~risk_map.obstacles]
    if losses.size and np.ptp(losses) == 0.0 and options.alpha_min < options.alpha_max:
        console.say(f'Warning: {NO_RISK}.')
    return risk_map


def _value(name: str, text: str, kind: type) -> Any:
    try:
        value = yaml.safe_load(text)
        if kind is float and not isinstance(value, bool):
            value = float(value)  # YAML reads 1e3 as text
    except (yaml.YAMLError, TypeError, ValueError):
        value = None
    if type(value) is not kind:
        raise InvalidOption(f'{name} must be of type {kind.__name__}, got {text!r}')
    return value
