# SPDX-License-Identifier: Apache-2.0
"""The values of all parameters of the node, read into one frozen record."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType
from typing import Any

from ..errors import InvalidCoordinates, InvalidOption
from ..game.game import GameOptions
from ..game.strategy import StrategyOptions
from ..maps.coordinates import Coordinates
from ..maps.occupancy import OccupancyOptions
from ..maps.road_file import ROAD_OPTIONS, RoadGraph, read_roads
from ..maps.vector_file import file_and_layer
from ..network.construction import NetworkOptions
from ..planning.options import DriveOptions, PlanningOptions
from .table import PARAMETERS

# Cell value of an obstacle in Nav2's costmaps (inscribed).
COSTMAP_OBSTACLE = 99
# Most nodes, those of all legs, of a plan that is soon refined: it is there in about a second, or
# with four stops in about three.
_PLAIN_NODES = 1000
# Parameters in which it differs from what is asked for.
OF_PLAIN_NETWORK = ('network.refine', 'network.target_nodes')


@dataclass(frozen=True)
class RecordingOptions:
    """Directory, compression and obligation of the recordings of departures.

    With ``required`` a departure is refused unless it has been recorded. Raises InvalidOption if
    that contradicts ``enabled``, the directory is empty, or its home directory is unknown.
    """

    enabled: bool
    directory: str
    compression: str
    required: bool = False

    def __post_init__(self) -> None:
        if self.required and not self.enabled:
            raise InvalidOption('required is true, but enabled is false')
        if not self.directory.strip():
            raise InvalidOption('directory must not be empty')
        try:
            Path(self.directory).expanduser()
        except RuntimeError as error:
            raise InvalidOption(f'directory {self.directory!r}: {error}') from error


@dataclass(frozen=True)
class NodeParameters:
    """All parameters: ``values`` by the names of ``PARAMETERS``, and the options made of them."""

    occupancy: OccupancyOptions
    planning: PlanningOptions
    recording: RecordingOptions
    values: Mapping[str, Any]

    def with_plain_network(self, legs: int) -> NodeParameters:
        """The parameters of a plan that is soon refined: on plain networks of few nodes in all."""
        nodes = min(self.planning.network.target_nodes, max(_PLAIN_NODES // legs, 2))
        network = replace(self.planning.network, refine=0, target_nodes=nodes)
        changed = dict(zip(OF_PLAIN_NETWORK, (0, nodes), strict=True))
        return replace(self, planning=replace(self.planning, network=network),
                       values=MappingProxyType({**self.values, **changed}))


def parameters_from(values: Mapping[str, Any], roads: RoadGraph | None = None) -> NodeParameters:
    """Read the values of all ``PARAMETERS`` as a set; ``roads`` replace the file network.graph.

    Raises InvalidOption if a value is out of range, or values contradict each other.
    """
    for name, parameter in PARAMETERS.items():
        if parameter.choices and values[name] not in parameter.choices:
            choices = ', '.join(parameter.choices)
            raise InvalidOption(f'{name} must be one of {choices}, got {values[name]!r}')
    if not math.isfinite(values['route.path_spacing']):
        raise InvalidOption(
            f'route.path_spacing must be finite [m], got {values["route.path_spacing"]}'
        )
    occupancy = _options(OccupancyOptions, 'map', values)
    if values['map.preset'] != 'alpha':
        threshold = min(occupancy.obstacle_threshold, COSTMAP_OBSTACLE)
        occupancy = replace(occupancy, obstacle_threshold=threshold)
    if values['map.preset'] == 'costmap':
        unknown = None if occupancy.unknown_alpha is None else min(occupancy.unknown_alpha, 1.0)
        occupancy = replace(occupancy, alpha_min=1.0, alpha_max=1.0, unknown_alpha=unknown)
    limit = values['max_planning_time']
    return NodeParameters(
        occupancy=occupancy,
        planning=PlanningOptions(
            network=_options(NetworkOptions, 'network',
                             values if roads is None else {**values, 'network.graph': roads}),
            game=_options(GameOptions, 'game', values),
            strategy=_options(StrategyOptions, 'strategy', values, time_limit=limit),
            drive=_options(DriveOptions, 'route', values),
            max_gap=values['strategy.max_gap'],
        ),
        recording=_options(RecordingOptions, 'recording', values),
        values=MappingProxyType(dict(values)),
    )


def roads_named(values: Mapping[str, Any]) -> RoadGraph | None:
    """Read the roads of network.graph, if it names a file; raises InvalidOption."""
    if not (graph := values['network.graph']):
        return None
    path, _ = file_and_layer(graph)
    if path.exists() and not (path.is_file() or path.is_dir()):  # a pipe would never end
        raise InvalidOption(f'network.graph: {path} is not a regular file')
    try:
        return read_roads(graph, **{name: values[f'network.{name}'] for name in ROAD_OPTIONS})
    except InvalidOption as error:
        raise InvalidOption(f'network.{error}') from error


def check_crs(values: Mapping[str, Any]) -> None:
    """Raise InvalidOption if ``map.crs`` is unknown to pyproj, if that is installed."""
    if (crs := values['map.crs']) and find_spec('pyproj'):
        try:
            Coordinates(crs)
        except InvalidCoordinates as error:
            raise InvalidOption(f'map.crs: {error}') from error


def _options(kind: Any, group: str, values: Mapping[str, Any],
             **others: Any) -> Any:
    """Make the options of a group; errors name its parameters instead of the fields."""
    start = f'{group}.'
    options = {each.name: values[start + each.name] for each in fields(kind)
               if start + each.name in values}
    try:
        return kind(**options, **others)
    except InvalidOption as error:
        text = str(error)
        for option in options:
            text = re.sub(rf'\b{option}\b', start + option, text, count=1)
        raise InvalidOption(text) from error
