"""The values of all parameters, read into one frozen record."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

from ..errors import InvalidOption
from ..game.game import GameOptions
from ..game.strategy import StrategyOptions
from ..maps.occupancy import OccupancyOptions
from ..network.construction import NetworkOptions
from .parameters import CHOSEN, COMPRESSIONS, PARAMETERS
from .plan import DriveOptions, PlanningOptions

_COSTMAP_OBSTACLE = 99
# In groups of the core's options, but not of these.
_NOT_THE_CORES = ('map.preset', 'strategy.max_gap')

_Options = TypeVar('_Options')


@dataclass(frozen=True)
class RecordingOptions:
    """Whether, where and how departures are recorded.

    Raises
    ------
    InvalidOption
        The directory is empty, or the compression is not one of those there are.
    """

    enabled: bool
    directory: str
    compression: str
    service_events: bool = False

    def __post_init__(self) -> None:
        if not self.directory.strip():
            raise InvalidOption('directory must not be empty')
        try:
            Path(self.directory).expanduser()
        except RuntimeError as error:
            raise InvalidOption(f'directory {self.directory!r}: {error}') from error
        if self.compression not in COMPRESSIONS:
            raise InvalidOption(
                f'compression must be one of {", ".join(COMPRESSIONS)}, got {self.compression!r}'
            )


@dataclass(frozen=True)
class RobotOptions:
    """Where the robot is: its frame ('': unknown), and how old a transform may be [s]."""

    frame: str = ''
    max_age: float = math.inf


@dataclass(frozen=True)
class NodeParameters:
    """All parameters, as the parts of the planner take them.

    ``values`` are those of ``PARAMETERS`` by their names.
    """

    occupancy: OccupancyOptions
    planning: PlanningOptions
    recording: RecordingOptions
    robot: RobotOptions
    publish_path: bool
    path_spacing: float
    start_tolerance: float
    replan_tolerance: float
    max_gap: float
    queue_size: int
    trip_order: str
    error_hold: float
    seed: int
    values: Mapping[str, Any]


def parameters_from(values: Mapping[str, Any]) -> NodeParameters:
    """Read the values of all ``PARAMETERS`` as a set.

    Raises
    ------
    InvalidOption
        A value is out of range, or values contradict each other.
    """
    if not math.isfinite(values['route.path_spacing']):
        raise InvalidOption(
            f'route.path_spacing must be finite [m], got {values["route.path_spacing"]}'
        )
    limit = values['max_planning_time']
    return NodeParameters(
        occupancy=_occupancy(values),
        planning=PlanningOptions(
            _options(NetworkOptions, 'network', values),
            _options(GameOptions, 'game', values),
            _options(StrategyOptions, 'strategy', values, time_limit=limit),
            _drive(values),
            values['strategy.max_gap'],
        ),
        recording=_options(RecordingOptions, 'recording', values),
        robot=RobotOptions(values['robot_base_frame'], values['transform.max_age']),
        publish_path=values['path.publish'],
        path_spacing=values['route.path_spacing'],
        start_tolerance=values['route.start_tolerance'],
        replan_tolerance=values['replan.tolerance'],
        max_gap=values['strategy.max_gap'],
        queue_size=values['queue.size'],
        trip_order=_choice(values, 'trip.order'),
        error_hold=values['diagnostics.error_hold'],
        seed=values['seed'],
        values=MappingProxyType(dict(values)),
    )


def _occupancy(values: Mapping[str, Any]) -> OccupancyOptions:
    preset = _choice(values, 'map.preset')
    options = _options(OccupancyOptions, 'map', values)
    if preset == 'alpha':
        return options
    return replace(
        options, obstacle_threshold=min(options.obstacle_threshold, _COSTMAP_OBSTACLE)
    )


def _choice(values: Mapping[str, Any], name: str) -> str:
    choices, value = PARAMETERS[name].choices, values[name]
    if value not in choices:
        raise InvalidOption(f'{name} must be one of {", ".join(choices)}, got {value!r}')
    chosen: str = value
    return chosen


def _drive(values: Mapping[str, Any]) -> DriveOptions:
    tube, radius = values['route.tube'], values['route.turning_radius']
    if tube < 0.0 and tube != CHOSEN:
        raise InvalidOption(f'route.tube must be >= 0 [m], or -1 to be chosen, got {tube}')
    try:
        return DriveOptions(None if tube == CHOSEN else tube, radius)
    except InvalidOption as error:
        raise InvalidOption(f'route.{error}') from error


def _options(
    kind: Callable[..., _Options], group: str, values: Mapping[str, Any], **others: Any
) -> _Options:
    """Make the options that ``group`` holds; errors call them by their parameters' names."""
    start = f'{group}.'
    options = {
        name.removeprefix(start): values[name]
        for name in values if name.startswith(start) and name not in _NOT_THE_CORES
    }
    try:
        return kind(**options, **others)
    except InvalidOption as error:
        text = str(error)
        for option in options:
            text = re.sub(rf'\b{option}\b', start + option, text, count=1)
        raise InvalidOption(text) from error
