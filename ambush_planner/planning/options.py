# SPDX-License-Identifier: Apache-2.0
"""All options of a plan, and the game that follows from them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from ..arrays import FloatArray
from ..errors import InvalidOption
from ..game.game import GameOptions
from ..game.strategy import StrategyOptions
from ..maps.risk_map import RiskMap
from ..network.construction import NetworkOptions, chosen_spacing
from ..network.grading import Grading
from ..option_checks import allowed, check_options, length

# Maximum distance of a place from the site that stands for it, as a share of the reach.
MAX_WIDENED = 0.04
# Maximum number of parts of a cell's side, even if MAX_WIDENED would take more.
MAX_PARTS = 5
# Largest default tube, in node spacings; and, if the game has a reach, as a share of it.
DEFAULT_TUBE, TUBE_OF_REACH = 0.35, 0.1
# Largest distance of paths from the line of a road, unless a tube is set [m].
ROAD_TUBE = 1.0
# Of a graded network: the least spacing around the ends, and the radius of the discs around
# refined places, in reaches.
FINEST, AROUND = 1.0 / 6.0, 1.25
# Maximum start tolerance, as a share of the reach; the secured area shrinks by it.
MAX_TOLERANCE = 0.25


@dataclass(frozen=True, kw_only=True)
class DriveOptions:
    """Options that turn a drawn route into the driven path; raises InvalidOption.

    Parameters
    ----------
    tube
        Largest distance of the path from the drawn route [m]. It is added to the reach of the
        game, so that the certificate covers the driven path. With a reach, off roads, paths also
        cut corners of the route where no ambush gains by it. None: with a reach, ``DEFAULT_TUBE``
        spacings, at most ``TUBE_OF_REACH`` times the reach, and on roads ``ROAD_TUBE``; without
        one, the path only avoids nodes that its route does not use; on roads it also stays within
        ``ROAD_TUBE`` of their lines.
    turning_radius
        Least radius of turns [m], if the corridors have enough room.
    start_tolerance
        How far the start and goal of a departure may be from the plan's [m]. The secured area
        shrinks by it, unless its radius is None, so that the certificate holds for all of them. At
        most half a node spacing; with a reach, also at most a quarter of it and the radius of the
        secured area.
    tracking_error
        Largest distance of the robot from the path [m]; it adds to the tube. Only for games with a
        reach.
    """

    tube: float | None = length(None, automatic=-1.0)
    turning_radius: float = length()
    start_tolerance: float = length(high=math.inf, finite=False)
    tracking_error: float = length()

    def __post_init__(self) -> None:
        check_options(self)


@dataclass(frozen=True, kw_only=True)
class PlanningOptions:
    """All options of a plan.

    If the time limit passes, a strategy is still accepted whose gap beyond the risk slack is at
    most ``max_gap`` times its value.
    """

    network: NetworkOptions = field(default_factory=NetworkOptions)
    game: GameOptions = field(default_factory=GameOptions)
    strategy: StrategyOptions = field(default_factory=StrategyOptions)
    drive: DriveOptions = field(default_factory=DriveOptions)
    max_gap: float = allowed(0.1, finite=False)

    def __post_init__(self) -> None:
        check_options(self)
        if self.drive.tracking_error > 0.0 and not self.game.ambush_radius > 0.0:
            raise InvalidOption(f'route.tracking_error {self.drive.tracking_error} is added to the '
                                'reach of ambushes, so game.ambush_radius must be over 0 [m]')


def solved_game(risk_map: RiskMap, options: PlanningOptions) -> GameOptions:
    """The game of a plan: with its tube, and with a secured area for all starts that it serves.

    If an ambusher may wait anywhere, his sites stand for all places around them. The secured
    area shrinks by the start tolerance, except that a radius of None includes it.
    """
    spacing = node_spacing(risk_map, options.network)
    game = _driven_game(options, spacing)
    if holds_anywhere(options):
        side = risk_map.resolution / parts_of_cells(risk_map.resolution, game)
        game = replace(game, widened=side / math.sqrt(2.0))
    if game.secured_radius is None:
        return replace(game, secured_radius=game.secured_distance)
    radius = game.secured_radius - start_tolerance(options, spacing)
    return replace(game, secured_radius=max(radius, 0.0))


def is_graded(options: PlanningOptions) -> bool:
    """Return whether the network is finer in some places than in others, and refined."""
    network = options.network
    return (options.game.ambush_radius > 0.0 and network.method == 'uniform_delaunay'
            and network.refine != 0
            and options.strategy.solver == 'max_entropy')


def grading(risk_map: RiskMap, options: PlanningOptions,
            refined: FloatArray | None) -> Grading | None:
    """Return the grading of the network, with ``Network.refined`` (K, 3); None: plain."""
    network, reach = options.network, options.game.ambush_radius
    if refined is None or not is_graded(options):
        return None
    secured = _driven_game(options, node_spacing(risk_map, network)).secured_distance
    return Grading(finest_spacing(risk_map, FINEST * reach), secured, refined, AROUND * reach)


def finest_spacing(risk_map: RiskMap, wanted: float) -> float:
    """The spacing [m]: nodes nearer to each other than half a cell show no more of the ground."""
    return max(wanted, risk_map.resolution / 2.0)


def holds_anywhere(options: PlanningOptions) -> bool:
    """Return whether a plan's value holds for ambushers anywhere on the ground, not only at nodes.

    Cyclic strategies have no hit probabilities.
    """
    return options.game.ambush_radius > 0.0 and options.strategy.solver == 'max_entropy'


def parts_of_cells(resolution: float, game: GameOptions) -> int:
    """Into how many parts a side of each cell is divided, whose centres are the sites.

    The farthest place of a part is within ``MAX_WIDENED`` times the reach from its centre, unless
    that takes more than ``MAX_PARTS``. It is 1 if ambushers wait at nodes only.
    """
    if game.ambush_radius == 0.0:
        return 1
    farthest = MAX_WIDENED * (game.ambush_radius + game.tube)
    return min(math.ceil(resolution / (math.sqrt(2.0) * farthest)), MAX_PARTS)


def start_tolerance(options: PlanningOptions, spacing: float) -> float:
    """Return the greatest distance of a departure's start and goal from the plan's [m].

    On roads they may not move: a straight way to the next node could leave the road.
    """
    if options.network.roads:
        return 0.0
    game = _driven_game(options, spacing)
    most = math.inf
    if game.reach > 0.0:
        most = min(game.secured_distance, MAX_TOLERANCE * game.reach)
    return min(options.drive.start_tolerance, 0.5 * spacing, most)


def _driven_game(options: PlanningOptions, spacing: float) -> GameOptions:
    """The game with the distance of the robot from the drawn route as its tube."""
    strays = (tube(options, spacing) or 0.0) + options.drive.tracking_error
    return replace(options.game, tube=strays)


def tube(options: PlanningOptions, spacing: float) -> float | None:
    """The tube [m]; None if the game stays the plain one."""
    if options.drive.tube is None and options.game.ambush_radius > 0.0:
        return automatic_tube(options, spacing)
    return options.drive.tube


def strays(options: PlanningOptions, spacing: float) -> float:
    """Return the greatest distance of paths from the drawn route, also in the plain game [m]."""
    most = tube(options, spacing)
    return automatic_tube(options, spacing) if most is None else most


def automatic_tube(options: PlanningOptions, spacing: float) -> float:
    """The tube that is used with a reach if none is set [m]; without one, of the same size."""
    reach = options.game.ambush_radius
    return min(DEFAULT_TUBE * spacing, TUBE_OF_REACH * reach if reach > 0.0 else math.inf,
               ROAD_TUBE if options.network.roads else math.inf)


def node_spacing(risk_map: RiskMap, options: NetworkOptions) -> float:
    """The distance of nodes, at least the map's resolution [m]."""
    return max(risk_map.resolution, chosen_spacing(risk_map, options))
