# SPDX-License-Identifier: Apache-2.0
"""All options of a plan, and the quantities that follow from them and the map."""

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
# Maximum number of parts of a cell's side, even if MAX_WIDENED asks for more.
MAX_PARTS = 5
# Largest default tube, in node spacings; and, if the game has a reach, as a share of it.
DEFAULT_TUBE, TUBE_OF_REACH = 0.35, 0.1
# Largest distance of paths from the line of a road, unless a tube is set [m].
ROAD_TUBE = 1.0
# Least spacing of a graded network, and outer radius of the ring around a refined place [reaches].
FINEST, REFINED_RADIUS = 1.0 / 6.0, 1.25
# Maximum start tolerance, as a share of the reach; the secured area shrinks by it.
MAX_TOLERANCE = 0.25


@dataclass(frozen=True, kw_only=True)
class DriveOptions:
    """Options of the driven path; raises InvalidOption.

    Parameters
    ----------
    tube
        Largest distance of the path from the drawn route [m]. It is added to the reach of the
        game, so that the certificate covers the driven path. With a reach, off roads, paths also
        cut corners of the route where no ambush gains by it. None: with a reach, ``DEFAULT_TUBE``
        spacings, at most ``TUBE_OF_REACH`` times the reach, and on roads at most ``ROAD_TUBE``;
        without a reach, the path only avoids nodes that its route does not use, and on roads stays
        within ``ROAD_TUBE`` of their lines.
    turning_radius
        Least radius of turns [m], where the corridors have enough room.
    start_tolerance
        Largest distance of a departure's start and goal from the plan's [m]. The secured area
        shrinks by it, unless its radius is None, so that the certificate holds for all departures.
        It is limited to half a node spacing; with a reach, also to a quarter of the reach and to
        the radius of the secured area.
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

    If the time limit passes, a strategy is accepted if its gap beyond the risk slack is at most
    ``max_gap`` times its value.
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
    """Return the options of a plan's game, with its tube, widening and secured radius.

    If ambushes are possible anywhere, sites are widened to stand for all places around them. The
    secured area shrinks by the start tolerance, unless its radius is None.
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
    """Return the grading of the network with ``Network.refined`` (K, 3), None if it has none.

    That of a first network, whose ``refined`` is None, brings the budget of those that follow.
    """
    network, reach = options.network, options.game.ambush_radius
    if not is_graded(options):
        return None
    secured = _driven_game(options, node_spacing(risk_map, network)).secured_distance
    return Grading(useful_spacing(risk_map, FINEST * reach), secured, refined,
                   REFINED_RADIUS * reach)


def useful_spacing(risk_map: RiskMap, spacing: float) -> float:
    """Return a spacing [m], at least half a cell: nodes that are closer show no more ground."""
    return max(spacing, risk_map.resolution / 2.0)


def holds_anywhere(options: PlanningOptions) -> bool:
    """Return whether a plan's value holds for ambushes anywhere on the ground, not only at nodes.

    It does not for the linear programs, because hit probabilities of cyclic strategies are unknown.
    """
    return options.game.ambush_radius > 0.0 and options.strategy.solver == 'max_entropy'


def parts_of_cells(resolution: float, game: GameOptions) -> int:
    """Return the number of parts into which each side of a cell is divided; 1 without a reach.

    The centres of the parts are the sites. No place of a part is further from its centre than
    ``MAX_WIDENED`` times the reach, unless that takes more than ``MAX_PARTS``.
    """
    if game.ambush_radius == 0.0:
        return 1
    max_distance = MAX_WIDENED * (game.ambush_radius + game.tube)
    return min(math.ceil(resolution / (math.sqrt(2.0) * max_distance)), MAX_PARTS)


def start_tolerance(options: PlanningOptions, spacing: float) -> float:
    """Return the largest distance of a departure's start and goal from the plan's [m].

    On roads it is 0: a straight way to the next node could leave the road.
    """
    if options.network.roads:
        return 0.0
    game = _driven_game(options, spacing)
    limit = math.inf
    if game.reach > 0.0:
        limit = min(game.secured_distance, MAX_TOLERANCE * game.reach)
    return min(options.drive.start_tolerance, 0.5 * spacing, limit)


def _driven_game(options: PlanningOptions, spacing: float) -> GameOptions:
    """Options of the game with a tube for the path and the robot's tracking error."""
    deviation = (tube(options, spacing) or 0.0) + options.drive.tracking_error
    return replace(options.game, tube=deviation)


def tube(options: PlanningOptions, spacing: float) -> float | None:
    """Return the tube [m]; None without a reach, if none is set."""
    if options.drive.tube is None and options.game.ambush_radius > 0.0:
        return automatic_tube(options, spacing)
    return options.drive.tube


def max_deviation(options: PlanningOptions, spacing: float) -> float:
    """Return the largest distance of paths from the drawn route, with a tube or without [m]."""
    limit = tube(options, spacing)
    return automatic_tube(options, spacing) if limit is None else limit


def automatic_tube(options: PlanningOptions, spacing: float) -> float:
    """Return the tube for games with a reach if none is set [m]; without a reach, a similar one."""
    reach = options.game.ambush_radius
    return min(DEFAULT_TUBE * spacing, TUBE_OF_REACH * reach if reach > 0.0 else math.inf,
               ROAD_TUBE if options.network.roads else math.inf)


def node_spacing(risk_map: RiskMap, options: NetworkOptions) -> float:
    """Return the spacing of nodes, at least the map's resolution [m]."""
    return max(risk_map.resolution, chosen_spacing(risk_map, options))
