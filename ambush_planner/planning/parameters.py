"""Every parameter of the node, as it is declared."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from ..game.game import GameOptions
from ..game.strategy import SOLVERS, StrategyOptions
from ..maps.occupancy import OccupancyOptions
from ..network.construction import METHODS, NetworkOptions
from .plan import DriveOptions
from .trip import ORDERS

_MAP, _NETWORK, _GAME, _STRATEGY = (
    OccupancyOptions(), NetworkOptions(), GameOptions(), StrategyOptions()
)
COMPRESSIONS = ('zstd', 'lz4', 'none')
PRESETS = ('alpha', 'costmap')
# For a parameter whose option may be left to the planner.
CHOSEN = -1.0


@dataclass(frozen=True)
class Declaration:
    """One parameter; ``low`` and ``high`` belong to the range, its type is the default's.

    One that is ``fixed`` keeps the value that it has at the start. To ROS it is not read-only: it
    may be set to that value, as ``ros2 param load`` does with what ``dump`` has written.
    """

    default: bool | int | float | str
    description: str
    low: float = 0.0
    high: float = math.inf
    choices: tuple[str, ...] = ()
    fixed: bool = False


PARAMETERS: Mapping[str, Declaration] = MappingProxyType({
    'map.alpha_min': Declaration(
        _MAP.alpha_min, 'Loss for being ambushed in a cell of value 0.'),
    'map.alpha_max': Declaration(
        _MAP.alpha_max, 'Loss for being ambushed in a cell of value 100; at least map.alpha_min.'),
    'map.obstacle_threshold': Declaration(
        _MAP.obstacle_threshold,
        'Cells of at least this value are obstacles; 101: no value is one.', 1, 101),
    'map.preset': Declaration(
        'alpha',
        'What publishes the map: alpha, a risk map made for this planner; costmap, a costmap of '
        'Nav2, in which 99 (inscribed) is an obstacle like 100 (lethal), whatever the threshold.',
        choices=PRESETS),
    'map.unknown_alpha': Declaration(
        _MAP.unknown_alpha,
        'Loss for being ambushed in an unknown cell (-1); negative: such cells are obstacles.',
        -1.0),
    'network.method': Declaration(
        _NETWORK.method, 'How nodes are sampled and connected.', choices=METHODS),
    'network.spacing': Declaration(
        _NETWORK.spacing,
        'Distance of nodes [m]; 0: chosen for about network.target_nodes nodes, never below the '
        "map's resolution."),
    'network.target_nodes': Declaration(
        _NETWORK.target_nodes, 'Number of nodes aimed at when network.spacing is 0.',
        2, 1_000_000),
    'network.clearance': Declaration(
        _NETWORK.clearance, 'Distance that routes keep from obstacle cells [m].'),
    'network.clear_of_edge': Declaration(
        _NETWORK.clear_of_edge,
        "Whether routes keep this distance from the map's outer edge, too."),
    'game.ambush_radius': Declaration(
        _GAME.ambush_radius,
        'An ambush hits every route that passes within this distance of it [m]; 0: routes '
        "through the ambush's node."),
    'game.secured_radius': Declaration(
        _GAME.secured_radius, 'Nobody can wait within this distance of start, stops or goal [m].'),
    'game.alpha_threshold': Declaration(
        _GAME.alpha_threshold,
        'Nodes whose loss is over this are not driven through; .inf: all may be.'),
    'game.ambushers': Declaration(
        _GAME.ambushers, 'Number of sites that are held at once; their losses add up.', 1, 100),
    'game.ambush_in_obstacles': Declaration(
        _GAME.ambush_in_obstacles,
        'Whether, with an ambush_radius, somebody can also wait in obstacle cells.'),
    'strategy.solver': Declaration(_STRATEGY.solver, 'How the game is solved.', choices=SOLVERS),
    'strategy.max_detour': Declaration(
        _STRATEGY.max_detour,
        'Expected length allowed, as a multiple of the shortest path; .inf: any.', 1.0),
    'strategy.max_exposure': Declaration(
        _STRATEGY.max_exposure,
        'Expected exposure allowed, the integral of the loss along the route, as a multiple of the '
        'least one; .inf: any. For the solver max_entropy.', 1.0),
    'strategy.risk_slack': Declaration(
        _STRATEGY.risk_slack,
        'Share of the value that may be given up for less predictable routes.'),
    'strategy.length_weight': Declaration(
        _STRATEGY.length_weight,
        'Weight w of the length for the solvers interior_point and simplex, which minimise '
        '(1 - w) * value + w * length.', 0.0, 1.0),
    'strategy.max_gap': Declaration(
        0.1,
        'How much better another strategy could be where somebody departs on this one, as a share '
        'of its value: after a change of the map, until it is solved anew, and where '
        'max_planning_time was up before the best one was found.'),
    'replan.tolerance': Declaration(
        0.05,
        'Share by which a change of the map may raise the value of the strategy before it is '
        'solved anew.'),
    'queue.size': Declaration(
        8, 'How many solves may wait beside the one that runs; others are refused.', 1, 1000),
    'autostart': Declaration(
        True,
        'Whether the node configures and activates itself at the start; false: something else '
        "does, like Nav2's lifecycle manager.",
        fixed=True),
    'robot_base_frame': Declaration(
        '',
        'Frame of the robot, like base_link: where no start is given, it is where TF has the robot '
        'at departure. Empty: a start has to be given.'),
    'transform.max_age': Declaration(
        2.0, 'Age of a moving transform from which on it is refused [s]; .inf: any will do.'),
    'max_planning_time': Declaration(
        60.0, 'Time after which a solve is given up [s]; .inf: never.', 0.001),
    'route.start_tolerance': Declaration(
        math.inf,
        'How far start and goal may be from those of a strategy that is there for a departure on '
        'it [m]; never more than half the distance of nodes, which .inf stands for.'),
    'route.tube': Declaration(
        CHOSEN,
        'How far the path that is driven may be from the drawn route [m]; an ambush is taken to '
        'reach as much further. -1: as far as no other node is met, or with an ambush_radius a '
        'part of the distance of nodes.', CHOSEN),
    'route.turning_radius': Declaration(
        DriveOptions().turning_radius,
        'Turns are at least this wide [m] where there is room for it.'),
    'route.path_spacing': Declaration(
        0.0,
        "Largest distance of poses on the path [m]; 0: the map's resolution or the distance of "
        'nodes, whichever is larger. A path of more than 20000 poses is refused.'),
    'path.publish': Declaration(
        True,
        'Whether the path is published. If not, only the answers of get_plan carry routes, and '
        'new_route, whose answer has no room for one, is refused.'),
    'trip.order': Declaration(
        'given',
        'In which order the stops of via_poses are visited: as given, or (best) in the order of '
        'least value within the length budget of the shortest one; with more than 7 stops in a '
        'short order.', choices=ORDERS),
    'recording.enabled': Declaration(True, 'Whether each departure is recorded.'),
    'recording.directory': Declaration(
        '~/.ros/ambush_planner', 'Where the folders with the recordings are made.'),
    'recording.compression': Declaration(
        'zstd', 'Compression of the recordings.', choices=COMPRESSIONS),
    'recording.service_events': Declaration(
        False,
        'Whether request and answer are recorded as messages, too, which `ros2 bag play '
        '--publish-service-requests` asks again; many other readers refuse files with such '
        'messages.'),
    'diagnostics.error_hold': Declaration(
        30.0, 'How long the diagnostics tell of a request that failed [s]; a success ends it, '
        'too.'),
    'seed': Declaration(
        -1,
        "-1: routes are drawn with the operating system's entropy. From 0: always the same "
        'sequence of routes, for tests and replay only.', -1, math.inf, fixed=True),
})
