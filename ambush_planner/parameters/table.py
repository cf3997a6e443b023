# SPDX-License-Identifier: Apache-2.0
"""Every parameter of the node: default, range and description, in one table."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from types import MappingProxyType
from typing import Any

from ..game.game import GameOptions
from ..game.strategy import StrategyOptions
from ..maps.occupancy import OccupancyOptions
from ..maps.road_file import ROAD_OPTIONS
from ..network.construction import NetworkOptions
from ..option_checks import MAX_LENGTH
from ..planning.options import DriveOptions

# Options of a plan by the groups of their parameters.
PLANNED: Mapping[str, Any] = {
    'map': OccupancyOptions, 'network': NetworkOptions, 'game': GameOptions,
    'strategy': StrategyOptions, 'route': DriveOptions}


@dataclass(frozen=True)
class Declaration:
    """One parameter; its type is that of the default, its range ``low`` to ``high``.

    A ``fixed`` parameter is read at the start, and read-only to ROS.
    """

    default: bool | int | float | str | list[str]
    description: str
    low: float = 0.0
    high: float = math.inf
    choices: tuple[str, ...] = ()
    fixed: bool = False


def is_planned(name: str) -> bool:
    """Return whether a parameter is an option of a plan."""
    group, _, option = name.partition('.')
    return group in PLANNED and option in {each.name for each in fields(PLANNED[group])}


def _declared(name: str, described: str | Declaration) -> Declaration:
    """Return the declaration of a parameter; the range of an option is that of its field."""
    if isinstance(described, Declaration):
        return described
    group, _, option = name.partition('.')
    (field,) = (each for each in fields(PLANNED[group]) if each.name == option)
    allowed = field.metadata['allowed']
    default: Any = allowed.automatic if field.default is None else field.default
    low = allowed.low if isinstance(default, str) else min(allowed.low, default)
    return Declaration(default, described, low, allowed.high, allowed.choices,
                       option in ('graph', *ROAD_OPTIONS))


# The options of a plan only have a description here.
_DESCRIBED: dict[str, str | Declaration] = {
    'plan': Declaration(
        '',
        'File of ambush plan -o FILE.plan to start from: its map, start, goal and stops, and its '
        'options instead of the parameters map, network, game, strategy and route, '
        'except map.costmap, strategy.max_gap and route.path_spacing.',
        fixed=True),
    'map.alpha_min':
        'Loss from an ambush in a cell of value 0.',
    'map.alpha_max':
        'Loss from an ambush in a cell of value 100; at least map.alpha_min.',
    'map.crs':
        "Coordinate system of the map's frame for reports and exports, such as EPSG:32616, or "
        '`datum LAT LON YAW` as in navsat_transform; empty: unknown.',
    'map.obstacle_threshold':
        'Cells of at least this value are obstacles; 101: none are.',
    'map.preset': Declaration(
        'alpha',
        'Source of the map: alpha, a risk map for this planner; costmap, a costmap of Nav2, in '
        'which cells from 99 (inscribed) are obstacles and each ambush costs 1, so that the value '
        'is the probability of being hit; costmap_risk, the same obstacles, but losses from the '
        'costs.',
        choices=('alpha', 'costmap', 'costmap_risk')),
    'map.costmap': Declaration(
        False,
        'Whether obstacles also come from the topic costmap, a costmap of Nav2; departures wait '
        'for it.', fixed=True),
    'map.unknown_alpha':
        'Loss from an ambush in an unknown cell (-1); -1: such cells are obstacles.',
    'network.method':
        'How nodes are sampled and connected.',
    'network.spacing':
        'Distance between nodes [m] (on roads: at most); 0: chosen for about '
        "network.target_nodes nodes, but at least the map's resolution.",
    'network.target_nodes':
        'Approximate number of nodes if network.spacing is 0.',
    'network.refine':
        'With a reach and uniform_delaunay: rounds in which the network, fine at the rim of the '
        'secured area, is refined where the ambusher waits; -1: as long as the value falls by '
        'over 2 %; 0: one plan on a plain network, with a budget of its own shortest route.',
    'network.clearance':
        'Distance that routes keep from obstacle cells [m].',
    'network.clear_of_edge':
        "Whether routes also keep this distance from the map's outer edge.",
    'network.graph':
        'File with roads, for network.method graph: lines (GeoPackage, GeoJSON, ...) or a graph of '
        'nav2_route (GeoJSON).',
    'network.node_crossings':
        'Whether roads also meet where they cross without a shared vertex, except on bridges and '
        'in tunnels.',
    'network.road_column':
        'Column of network.graph that says which lines are roads, and its values for roads: '
        'class=road,track; for files whose columns are not known.',
    'network.all_lines_are_roads':
        'Whether all lines of network.graph are roads, if no column says which.',
    'network.two_way':
        'Whether roads are two-way although a column that is not known may say directions.',
    'network.join_distance':
        'Maximum distance of start, stops and goal from the nearest road [m].',
    'game.ambush_radius':
        'An ambush hits every route that passes within this distance [m]; 0: routes through its '
        'node.',
    'game.secured_radius':
        'Radius of the secured area around start, stops and goal [m], where nobody can wait and '
        'nobody who drives there is hit; -1: as far as the reach, with tube, tracking error and '
        'start tolerance.',
    'game.alpha_threshold':
        'Routes avoid nodes with a higher loss; .inf: none.',
    'game.ambush_in_obstacles':
        'Whether an ambush with an ambush_radius may also be in obstacle cells.',
    'strategy.solver':
        'Algorithm that solves the game.',
    'strategy.max_detour':
        'Maximum expected length, as a multiple of the shortest path; .inf: any. It is a target as '
        'well as a limit: longer routes are harder to guess.',
    'strategy.risk_slack':
        'Share of the value to give up for less predictable routes.',
    'strategy.length_weight':
        'Weight w of the length for the solvers interior_point and simplex, which minimise '
        '(1 - w) * value + w * length.',
    'strategy.max_gap': Declaration(
        0.1,
        'Maximum gap to the best strategy, as a share of the value, at which departures may use a '
        'strategy that is not the best: after a change of the map, until the next solve, and if '
        'max_planning_time ended the search.'),
    'replan.tolerance': Declaration(
        0.05,
        'Share by which a change of the map may raise the value of the strategy before the planner '
        'solves again.'),
    'autostart': Declaration(
        True,
        'Whether the node configures and activates itself at the start; false: a lifecycle '
        'manager does.', fixed=True),
    'planner_ids': Declaration(
        [''],
        "Values of planner_id, besides the node's name, for which the actions answer, such as "
        'GridBased for the trees of Nav2.'),
    'parameters.locked': Declaration(
        False, 'Whether parameters keep their values while the node is active.', fixed=True),
    'robot_base_frame': Declaration(
        '',
        'Frame of the robot, such as base_link. Requests without a start begin at the robot, as TF '
        'gives its pose. Empty: a start is required.'),
    'transform.max_age': Declaration(
        2.0, 'Maximum age of a moving transform [s]; .inf: any.'),
    'max_planning_time': Declaration(60.0, 'Time limit of a solve [s]; .inf: none.', 0.001),
    'route.start_tolerance': Declaration(
        math.inf,
        'Maximum distance of start and goal from those of a cached strategy for a departure on '
        'it [m]; at most half the distance between nodes, which .inf stands for.'),
    'route.tube':
        'How far the driven path may leave the drawn route [m]; this is added to the ambush '
        'radius. Within it, corners are cut where no ambush gains. -1: as far as the path meets no '
        'other node, or, with an ambush radius, a tenth of it, at most 0.35 times the distance '
        'between nodes.',
    'route.tracking_error':
        'Maximum distance of the robot from the driven path [m], added to the reach of ambushes; '
        'needs an ambush_radius over 0.',
    'route.turning_radius':
        'Minimum radius of turns if there is room for it [m].',
    'route.path_spacing': Declaration(
        0.0,
        "Maximum distance between poses of the path [m]; 0: the map's resolution or the distance "
        'between nodes, whichever is larger. A path of more than 20000 poses is refused.',
        high=MAX_LENGTH),
    'path.publish': Declaration(
        True,
        'Whether the path is published. If not, only responses of get_plan and results of the '
        'actions carry routes, and new_route is refused.', fixed=True),
    'trip.max_idle': Declaration(
        600.0,
        'Time after which the trip of a robot that makes no progress is over [s], so that its next '
        'request is a departure; .inf: never.'),
    'recording.enabled': Declaration(True, 'Whether departures are recorded.', fixed=True),
    'recording.required': Declaration(
        False,
        'Whether a departure is refused unless its recording is on the disk before the path is '
        'published.', fixed=True),
    'recording.directory': Declaration(
        '~/.ros/ambush_planner', 'Directory of the folders with recordings.', fixed=True),
    'recording.compression': Declaration(
        'zstd', 'Compression of the recordings.', choices=('zstd', 'lz4', 'none'), fixed=True),
    'seed': Declaration(
        -1,
        "-1: routes are drawn with the operating system's entropy; 0 or more: always the same "
        'sequence of routes, only for tests and replay.', -1, math.inf, fixed=True),
}
PARAMETERS: Mapping[str, Declaration] = MappingProxyType(
    {name: _declared(name, described) for name, described in _DESCRIBED.items()})
