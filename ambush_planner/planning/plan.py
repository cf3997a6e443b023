# SPDX-License-Identifier: Apache-2.0
"""Requests and plans: a risk map becomes a plan once, and each departure draws a route from it."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import plan_methods
from ..arrays import FloatArray, IndexArray
from ..errors import InvalidOption
from ..game.bottleneck import Bottleneck, find_bottleneck
from ..game.revaluation import open_gap
from ..game.strategy import Strategy, TripStrategy
from ..maps.occupancy import OccupancyMap, OccupancyOptions
from ..maps.risk_map import RiskMap
from ..network.network import Network
from ..notebook import Shown
from ..option_checks import check_whole
from ..routes.corridors import Corridors, make_corridors
from ..routes.driven_path import Ends, driven_path, driven_paths, joined
from ..words import distance
from .few import FewRoutes
from .options import PlanningOptions, automatic_tube, node_spacing, start_tolerance, tube

if TYPE_CHECKING:
    from .refinement import Round
    from .solving import WarmStart

# A departure's route: the nodes (K,) of each leg.
Route = tuple[IndexArray, ...]

# Number of routes driven to find the mean length of paths: a third of a per cent of it.
DRIVEN = 300


@dataclass(frozen=True, eq=False)
class PlanRequest:
    """All inputs of a plan.

    Parameters
    ----------
    grid
        The map.
    occupancy
        The conversion of its values to losses.
    start_xy, goal_xy
        World positions [m].
    goal_tolerance
        How far a goal in an obstacle may be moved [m].
    options
        Network, game and strategy.
    stops_xy
        Stops [m] in the order in which they are visited.
    warm
        A similar strategy to start the search from.
    first
        Options of a plan that is wanted sooner, from which that of ``options`` then starts.
    """

    grid: OccupancyMap
    occupancy: OccupancyOptions
    start_xy: tuple[float, float]
    goal_xy: tuple[float, float]
    goal_tolerance: float
    options: PlanningOptions
    stops_xy: tuple[tuple[float, float], ...] = ()
    warm: WarmStart | None = None
    first: PlanningOptions | None = None


@dataclass(frozen=True, eq=False, repr=False)
class Plan(Shown):
    """The strategies for a map, a start, stops and a goal, with everything that departures need.

    ``corridors`` are the space around the routes of each leg that the driven path may use; () if
    they are measured for each route that is drawn (``measured_corridors``).
    ``spacing`` is the distance of the network's nodes, at least the map's resolution [m].
    ``seconds`` is the planning time. ``risk_map`` is the map if the plan was made in this process,
    else None. ``few`` is the mixture of few routes that departures draw from, None if they draw
    from the strategies. ``refinement`` has the rounds in which the network was refined; () if it is
    plain.
    """

    trip: TripStrategy
    corridors: tuple[Corridors, ...]
    options: PlanningOptions
    spacing: float
    seconds: float = 0.0
    risk_map: RiskMap | None = None
    few: FewRoutes | None = None
    refinement: tuple[Round, ...] = ()

    @property
    def legs(self) -> tuple[Strategy, ...]:
        """The strategy of each leg; their routes are drawn one by one."""
        return self.trip.legs

    @property
    def strategy(self) -> Strategy:
        """The strategy of a plan without stops; raises InvalidOption if there are any."""
        if len(self.legs) > 1:
            raise InvalidOption('a plan with stops has a strategy for each leg: see its legs')
        return self.legs[0]

    @property
    def network(self) -> Network:
        """The network of the first leg, whose nodes are those of all legs."""
        return self.legs[0].network

    def of_leg(self, number: int) -> Plan:
        """The plan of one leg alone."""
        return replace(self, trip=self.legs[number].alone,
                       corridors=self.corridors[number : number + 1], few=None)

    def legs_from(self, first: int) -> Plan:
        """The plan of the legs from ``first`` on."""
        if first == 0:
            return self
        return replace(self, trip=replace(self.trip, legs=self.legs[first:]),
                       corridors=self.corridors[first:])

    @property
    def drawn_from(self) -> TripStrategy:
        """The strategies that departures are drawn from: the plan's, or those of its few routes.

        Every number of the plan is of these.
        """
        return self.few.trip if self.few else self.trip

    @cached_property
    def bottleneck(self) -> Bottleneck:
        """The sites that decide the value."""
        return find_bottleneck(self.drawn_from)

    @property
    def own_map(self) -> RiskMap:
        """The map; raises InvalidOption if the plan was made in another process."""
        if self.risk_map is None:
            raise InvalidOption('the plan has no risk map; make it with plan_trip')
        return self.risk_map

    @property
    def value(self) -> float:
        """Mean loss per departure by the best ambush that knows everything except the draw.

        Of a trip with stops, the sum over its legs at one place.
        """
        return self.drawn_from.value

    @property
    def lower_bound(self) -> float:
        """No strategies on the same network and budgets have a smaller value.

        If departures draw from a few routes: no mixture of the paths that these were chosen from.
        """
        return self.drawn_from.lower_bound

    @property
    def gap_is_wide(self) -> bool:
        """Return whether the strategies' gap is over ``max_gap``: better ones may exist."""
        return gap_is_wide(self.trip, self.options)

    def _summary(self) -> dict[str, str]:
        trip = self.drawn_from
        stops = {'stops': str(len(self.stops_xy))} if self.stops_xy else {}
        return {'value': f'{self.value:.4g}', 'lower bound': f'{self.lower_bound:.4g}', **stops,
                'mean length': f'{trip.expected_length:.0f} {self.network.travel_unit}',
                'shortest route': f'{trip.shortest_length:.0f} {self.network.travel_unit}',
                'network': f'{len(self.network.points)} nodes',
                'node spacing': distance(self.spacing),
                'secured area': distance(trip.game.options.secured_distance),
                'planned in': f'{self.seconds:.2g} s'}

    def plot(self, axes: Any = None) -> Any:
        """Draw map, strategy and ambush sites on matplotlib axes, by default new ones.

        Positions are world positions, as in ``routes`` unless the map is in a robot's frame.
        Returns the axes.
        """
        return plan_methods.plot(self.drawn_from, self.risk_map, axes)

    def paths(self, n: int,
              rng: np.random.Generator | int | None = None) -> list[FloatArray]:
        """Draw ``n`` routes and return their paths (L, 3) = (x, y, yaw), one pose per spacing.

        ``rng`` is a generator, or a seed for tests; None: the operating system's entropy.
        """
        rng = np.random.default_rng(rng)
        check_whole('n', n, 0)
        if self.few is not None:
            return [self.few.path(numbers) for numbers in self.few.draw(n, rng)]
        return departure_paths(self, n, self.spacing, rng)

    def save(self, *files: Path | str, n: int = 1,
             rng: np.random.Generator | int | None = None) -> list[FloatArray]:
        """Draw ``n`` routes, write them to files and return their paths, as ``paths`` does.

        All files have the same routes; the suffix of each sets its format: .gpx, .gpkg, .geojson,
        .csv (extra ``gis``) or .png (extra ``figures``). A file with the suffix .plan (extra
        ``recordings``) has the plan itself, from which ``ambush draw`` draws departures. All are
        secret and have mode 0600.

        Raises InvalidOption for any other suffix, or if the plan has no ``risk_map``, and
        InvalidCoordinates if a format needs a coordinate system and the map has none.
        """
        return plan_methods.save(self, files, n, rng)

    def frontier(self, detours: Sequence[float] | None = None,
                 slacks: Sequence[float] | None = None) -> tuple[Any, ...]:
        """Solve the trip with other length budgets and slacks, a row for each.

        By default, those of ``frontier``. Returns FrontierRows.
        """
        return plan_methods.frontier(self, detours, slacks)

    @cached_property
    def driven_length(self) -> float:
        """Mean length of the paths [m], as they are driven: they cut the corners of routes.

        The length budget counts the edges of the network. A fixed seed keeps it independent of
        what departures draw.
        """
        if self.few is not None:
            return float(self.few.shares @ path_lengths(self.few.paths))
        rng = np.random.default_rng(0)
        return float(path_lengths(departure_paths(self, DRIVEN, self.spacing, rng)).mean())

    @property
    def start_xy(self) -> tuple[float, float]:
        """Begin of the routes [m]."""
        return self._place(self.network.source)

    @property
    def stops_xy(self) -> tuple[tuple[float, float], ...]:
        """The stops as they are visited [m]."""
        return tuple(self._place(leg.network.source) for leg in self.legs[1:])

    @property
    def goal_xy(self) -> tuple[float, float]:
        """End of the routes [m]: the requested goal, or where it was moved to."""
        return self._place(self.legs[-1].network.target)

    @property
    def ends_xy(self) -> tuple[tuple[float, float], ...]:
        """Start, stops and goal [m]."""
        return (self.start_xy, *self.stops_xy, self.goal_xy)

    @property
    def tube(self) -> float | None:
        """Largest distance of paths from the drawn route [m]; None: they avoid other nodes."""
        return tube(self.options, self.spacing)

    @property
    def start_tolerance(self) -> float:
        """Return the greatest distance of a departure's start and goal from the plan's [m]."""
        return start_tolerance(self.options, self.spacing)

    def _place(self, node: int) -> tuple[float, float]:
        x, y = self.network.points[node].tolist()
        return x, y


def gap_is_wide(trip: TripStrategy, options: PlanningOptions) -> bool:
    """Return whether the gap of strategies beyond the risk slack is over ``max_gap``."""
    return open_gap(trip, options.strategy) > options.max_gap * trip.value


def path_lengths(paths: Sequence[FloatArray]) -> FloatArray:
    """Lengths (K,) of paths (L, 2 or 3) [m]."""
    return np.array([np.hypot(*np.diff(path[:, :2], axis=0).T).sum() for path in paths])


def make_plan(risk_map: RiskMap, trip: TripStrategy, options: PlanningOptions,
              begin: float | None = None) -> Plan:
    """The plan that follows from strategies; planning began at ``begin`` (``time.monotonic``)."""
    plan = Plan(trip, (), options, node_spacing(risk_map, options.network), 0.0, risk_map)
    made = replace(plan, corridors=measured_corridors(plan))
    return replace(made, seconds=time.monotonic() - begin) if begin is not None else made


def measured_corridors(plan: Plan, among: Sequence[IndexArray | None] = ()
                       ) -> tuple[Corridors, ...]:
    """The corridors of all routes, or of routes ``among`` some nodes (K,) of each leg."""
    return tuple(_leg_corridors(leg, plan.own_map, plan.options, nodes)
                 for leg, nodes in zip(plan.legs, among or [None] * len(plan.legs), strict=True))


def corridors_of(plan: Plan, among: Sequence[IndexArray | None] = ()) -> tuple[Corridors, ...]:
    """The corridors of a plan, measured now, as in ``measured_corridors``, if it has none."""
    return plan.corridors or measured_corridors(plan, among)


def _leg_corridors(strategy: Strategy, risk_map: RiskMap, options: PlanningOptions,
                   among: IndexArray | None) -> Corridors:
    """The corridors of a leg's network; on roads, and without a reach, no corners are cut."""
    spacing, game = node_spacing(risk_map, options.network), strategy.game
    limit, most = tube(options, spacing), np.inf
    reach = game.options.ambush_radius + game.options.tube
    if options.network.roads:
        reach, most = 0.0, automatic_tube(options, spacing)
    elif game.options.ambush_radius == 0.0:
        reach = 0.0
    return make_corridors(strategy.network, risk_map, options.network.clearance, limit,
                          options.network.clear_of_edge, most, reach,
                          game.secured.shrunk(game.options.tube), among)


def draw_routes(plan: Plan, n: int, rng: np.random.Generator) -> list[Route]:
    """Draw ``n`` departures: a route of each leg, drawn on its own."""
    return list(zip(*(leg.sample_routes(n, rng) for leg in plan.legs), strict=True))


def departure_path(plan: Plan, route: Route, spacing: float, ends: Ends | None = None
                   ) -> FloatArray:
    """Poses (L, 3) = (x, y, yaw) of the path along a route, at most ``spacing`` [m] apart.

    ``ends`` are start and goal [m] if they differ from the route's. Each stop is met exactly, with
    the yaw of the arrival; the convoy may turn on the spot there. Raises InvalidOption if there
    would be more than ``MAX_POSES``.
    """
    radius = plan.options.drive.turning_radius
    places = [*plan.ends_xy]
    if ends is not None:
        places[0], places[-1] = ends
    corridors = corridors_of(plan, route)
    legs = [driven_path(each, nodes, spacing, radius, own) for each, nodes, own in zip(
        corridors, route, pairwise(places), strict=True)]
    return joined(legs)


def departure_paths(plan: Plan, n: int, spacing: float,
                    rng: np.random.Generator) -> list[FloatArray]:
    """Draw ``n`` departures and return their paths, as ``departure_path`` does."""
    radius, routes = plan.options.drive.turning_radius, draw_routes(plan, n, rng)
    if not n:
        return []
    by_leg = list(zip(*routes, strict=True))
    corridors = corridors_of(plan, [np.concatenate(own) for own in by_leg])
    legs = [driven_paths(each, list(own), spacing, radius)
            for each, own in zip(corridors, by_leg, strict=True)]
    return [joined(each) for each in zip(*legs, strict=True)]
