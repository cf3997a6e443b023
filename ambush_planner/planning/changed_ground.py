# SPDX-License-Identifier: Apache-2.0
"""Assess a plan, and draw its routes, on a map that has changed since it was solved."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from ..arrays import BoolArray, FloatArray, IndexArray, frozen_array
from ..game.budget import BUDGET_TOLERANCE
from ..game.certificate.certificate import Certificate
from ..game.distribution.chain import RouteMixture
from ..game.hits import Law, joint_law
from ..game.legs import Legs
from ..game.revaluation import legs_in_game, revalue
from ..game.route_sampler import route_edges
from ..game.strategy import TripStrategy, with_certificate
from ..maps.occupancy import OccupancyMap, OccupancyOptions, obstacles_in
from ..maps.risk_map import RiskMap, to_map_axes
from ..routes.corridor_update import add_obstacles, move_end
from ..routes.corridors import Corridors
from ..routes.driven_path import Ends
from .cell_losses import CellSearch, LatestLosses
from .changed_network import ChangedNetwork, PlannedNetwork
from .clear_ground import ClearGround
from .conditioning import ConditionedStrategy, clear_laws
from .options import holds_anywhere
from .plan import Plan, Route

# Maximum number of draws until a route is clear. If a tenth of the routes is clear, one departure
# in 10^13 needs more.
_MAX_DRAWS = 300
# Maximum share of blocked routes; beyond it the game is solved again.
_MAX_BLOCKED = 0.01
# Minimum share of clear routes; below it departures wait for the next solve.
MIN_CLEAR = 0.1


@dataclass(frozen=True)
class Assessment:
    """Value and lower bound of a plan's strategies on another map.

    The bound is about the strategies' own networks: ground that has become free counts from the
    next solve on. ``clear_share`` is the probability that a route meets no new obstacle and no
    forbidden node; if it is below 1, routes are drawn until one is clear, and the value is that of
    this. ``expected_length`` [``travel_unit``] is the mean over the clear routes (inf if there are
    none), ``length_budget`` its limit by ``max_detour``.
    """

    value: float
    lower_bound: float
    clear_share: float = 1.0
    expected_length: float = math.inf
    length_budget: float = math.inf
    travel_unit: str = 'm'

    @property
    def gap(self) -> float:
        """Value minus lower bound."""
        return self.value - self.lower_bound

    @property
    def is_blocked(self) -> bool:
        """Return whether so large a share of the routes is blocked that the game is solved again.

        Most strategies use all ground a little, so a few blocked routes are common.
        """
        return self.clear_share < 1.0 - _MAX_BLOCKED

    @property
    def is_over_budget(self) -> bool:
        """Return whether the clear routes are longer on average than the length budget allows."""
        return self.length_budget * (1.0 + BUDGET_TOLERANCE) < self.expected_length < math.inf

    @property
    def concern(self) -> str:
        """Warning about the length of the clear routes; '' if there is none."""
        if not self.is_over_budget:
            return ''
        return (f'the routes that are clear on the current map have a mean length of '
                f'{self.expected_length:.4g} {self.travel_unit}, '
                f'{self.expected_length / self.length_budget:.3g} times the budget of '
                f'{self.length_budget:.4g} {self.travel_unit} (strategy.max_detour)')

    def is_stale(self, original_value: float, tolerance: float) -> bool:
        """Return whether to solve again; ``original_value`` is that on the plan's own map."""
        return self.is_blocked or self.value > original_value * (1.0 + tolerance) + 1e-12

    def allows_departure(self, max_gap: float, original_gap: float) -> bool:
        """Return whether a convoy may depart before the next solve.

        The gap may exceed ``original_gap``, that on the plan's own map, by at most ``max_gap``
        times the value.
        """
        growth = self.gap - original_gap
        return self.clear_share >= MIN_CLEAR and growth <= max_gap * self.value + 1e-12


class ChangedGround:
    """A plan on other maps of the same ground: its assessment, and draws of clear routes.

    The plan was solved on the map ``planned_on``; ``occupancy`` converts the maps' values. Several
    plans may share the ``losses`` of the newest map.
    """

    def __init__(self, plan: Plan, planned_on: OccupancyMap, occupancy: OccupancyOptions,
                 losses: LatestLosses | None = None) -> None:
        self.plan, self._planned_on, self._occupancy = plan, planned_on, occupancy
        self._cell_losses = losses or LatestLosses()
        self._planned = PlannedNetwork(plan, planned_on, occupancy, self._cell_losses)
        self._latest: ChangedNetwork | None = None
        self._assessment: Assessment | None = None
        self._corridors: tuple[Corridors, ...] | None = None
        self._search: CellSearch | None = None  # its cached geometry serves all maps

    def compare(self, newest: OccupancyMap) -> ChangedNetwork:
        """Compare the plan's network on the newest map, which is of the same ground."""
        if self._latest is None or self._latest.newest is not newest:
            self._latest = self._planned.compare(newest)
            self._assessment = self._corridors = None
        return self._latest

    def forget_all_but(self, newest: OccupancyMap) -> None:
        """Free the memory of results on other maps; of all if none was compared since."""
        if self._latest is None:
            self._search = None
        elif self._latest.newest is not newest:
            self._latest = self._assessment = self._corridors = None

    def assess(self, newest: OccupancyMap) -> Assessment:
        """Assess drawing routes until one is clear on the newest map, of the same ground."""
        changed = self.compare(newest)
        if self._assessment is None:
            self._assessment = self._assess(changed)
        return self._assessment

    def drawn_from(self, newest: OccupancyMap) -> TripStrategy:
        """Return the strategies that departures on the newest map are drawn from.

        They are the plan's on condition that routes are clear, with the losses and the value on
        that map. Raises ValueError if no route is clear.
        """
        changed, known, trip = self.compare(newest), self.assess(newest), self.plan.trip
        certificate = Certificate(known.value, known.lower_bound)
        if self._is_unchanged(changed):
            same = certificate.value == trip.value
            return trip if same else with_certificate(trip, certificate)
        share, laws = self.clear_laws(changed)
        if not share > 0.0:
            raise ValueError('no route of the strategy is clear')
        legs = legs_in_game(trip, trip.game.options, changed.alpha)
        drawn = tuple(replace(
            leg, game=game, budget=budget,
            edge_probability=frozen_array(law.uses(len(leg.edge_probability)), np.float64),
            mixture=law if isinstance(law, RouteMixture) else None)
            for leg, game, budget, law in zip(trip.legs, legs.games, legs.budgets, laws,
                                              strict=True))
        return with_certificate(replace(trip, legs=drawn), certificate)

    def connects(self, newest: OccupancyMap, ends: Ends) -> bool:
        """Return whether all first and last edges in use can be driven from start and to goal.

        It has to be all of them, so that a request does not depend on the route that is drawn.
        """
        (start, goal), plan = ends, self.plan
        if any(one == other for one, other in pairwise((start, *plan.stops_xy, goal))):
            return False  # the solve will refuse it
        lost = self.by_leg(self.compare(newest).lost)
        # Start and goal separately: the rectangle around both may be the whole map.
        for k, node, place in ((0, 'source', start), (-1, 'target', goal)):
            network, end = plan.legs[k].network, (1, 0)[k]
            used = (plan.legs[k].edge_probability > 0.0) & ~lost[k]
            used &= network.edges[:, 1 - end] == getattr(network, node)
            others = network.points[network.edges[used, end]]
            moved = np.broadcast_to(place, others.shape)
            a, b = (moved, others) if node == 'source' else (others, moved)
            # A step of length 0 has no direction.
            if (a == b).all(axis=1).any() or not self.clear(a, b, newest).all():
                return False
        return True

    def draw(self, rng: np.random.Generator, newest: OccupancyMap, first: int = 0) -> Route | None:
        """Draw a route of each leg from ``first`` on until it is clear on the newest map.

        So a route has its conditional probability, given that it is clear. Returns None after too
        many draws.
        """
        lost, drawn = self.by_leg(self.compare(newest).lost), []
        for leg, leg_lost in zip(self.plan.legs[first:], lost[first:], strict=True):
            for _ in range(_MAX_DRAWS):
                nodes = leg.sample_route(rng)
                if not leg_lost.any() or not leg_lost[route_edges(leg.network, nodes)].any():
                    drawn.append(nodes)
                    break
            else:
                return None
        return tuple(drawn)

    def fit_plan(self, newest: OccupancyMap, ends: Ends, joins: IndexArray | None = None,
                 first: int = 0) -> Plan:
        """Return the plan from leg ``first`` on, with corridors fitted to the newest map and ends.

        The path of a clear route between ``ends`` is then clear, if the straight lines from the
        ends to the network are (``clear``). The start is connected with the same nodes as before,
        or with the nodes ``joins`` (K,).
        """
        plan, options = self.plan.legs_from(first), self.plan.options.network
        corridors = list(self._clear_corridors(newest)[first:])
        for k, node, place, others in (
                (0, plan.network.source, ends[0], joins),
                (len(corridors) - 1, plan.legs[-1].network.target, ends[1], None)):
            if tuple(plan.network.points[node].tolist()) != place:
                corner, part = self._map_part(newest, corridors[k], node, place, others)
                corridors[k] = move_end(corridors[k], node, place, part, corner,
                                              options.clearance, options.clear_of_edge, others)
        return replace(plan, corridors=tuple(corridors))

    @cached_property
    def conditioned(self) -> tuple[ConditionedStrategy, ...]:
        """The strategy of each leg, to be conditioned on avoiding lost edges."""
        return tuple(ConditionedStrategy(leg) for leg in self.plan.legs)

    def clear(self, a: FloatArray, b: FloatArray, newest: OccupancyMap) -> BoolArray:
        """Return whether segments a -> b, both (K, 2) [m], are clear on the newest map: (K,).

        Those of one call should lie close together: the map is read around all of them.
        """
        return self._clear_ground(newest).segments(a, b)

    def value_at_cells(self, at_sites: Certificate, newest: OccupancyMap, law: Law,
                       unchanged: bool = False, moved: Legs | None = None) -> Certificate:
        """Return a certificate whose value also covers ambushes at any cell, if the plan's does.

        ``at_sites`` is the certificate of a law at the network's sites. If the law and the losses
        of the nodes are ``unchanged``, its value covers all cells that have not changed. The law is
        of the plan's legs, or of those that have ``moved``.
        """
        changed = self.compare(newest).changed
        if not self._planned.hiding:
            # Cells that have become obstacles hide nobody. If only such cells have changed, the
            # losses of the planned map are used as they are.
            changed = changed[~obstacles_in(newest.values.ravel()[changed], self._occupancy)]
        if (math.isinf(at_sites.value) or not holds_anywhere(self.plan.options)
                or (unchanged and not len(changed))):
            return at_sites
        losses = self._cell_losses.update(newest if len(changed) else self._planned_on,
                                          self._occupancy, self._planned.hiding)
        if moved is None:
            games = self.plan.trip.joint.games
            self._search = self._search or CellSearch(losses, games, self._used)
            search = self._search.with_losses(losses)
        else:
            search = CellSearch(losses, moved.games, law.uses(moved.edge_count) > 0.0)
        cells = None
        if unchanged and not self._planned.hiding:
            cells = np.stack(np.divmod(changed, newest.values.shape[1]), axis=1)
        worst = search.worst(law, at_sites.value, cells=cells)
        return replace(at_sites, value=max([at_sites.value, *worst.mean_loss[:1]]))

    def _assess(self, changed: ChangedNetwork) -> Assessment:
        """Assess drawing routes until one avoids the lost edges."""
        plan, trip = self.plan, self.plan.trip
        if changed.lost.all():
            return Assessment(math.inf, 0.0, 0.0)
        known, unchanged = trip.certificate, self._is_unchanged(changed)
        clear_share, laws = self.clear_laws(changed)
        if not clear_share > 0.0:
            return Assessment(math.inf, 0.0, 0.0)
        law = joint_law(trip.joint, laws)
        if not unchanged:
            known = revalue(trip, changed.alpha, law)
        known = self.value_at_cells(known, changed.newest, law, unchanged)
        length = sum(float(leg_law.uses(len(leg.edge_probability)) @ leg.network.travel_costs)
                     for leg, leg_law in zip(plan.legs, laws, strict=True))
        return Assessment(known.value, known.bound, clear_share, length,
                          plan.options.strategy.max_detour * trip.shortest_length,
                          plan.network.travel_unit)

    @cached_property
    def _used(self) -> BoolArray:
        """Marks the edges (M,) that routes of the plan use."""
        return np.concatenate([leg.edge_probability for leg in self.plan.legs]) > 0.0

    def by_leg(self, lost: BoolArray) -> list[BoolArray]:
        """Split the lost edges (M,) by leg."""
        return np.split(lost, self.plan.trip.joint.first[1:-1])

    def _is_unchanged(self, changed: ChangedNetwork) -> bool:
        """Return whether no edge in use is lost, and no node's loss has changed."""
        return (not changed.lost[self._used].any()
                and np.array_equal(changed.alpha, self.plan.network.alpha))

    def clear_laws(self, changed: ChangedNetwork) -> tuple[float, list[Law]]:
        """Return the probability that a route is clear, and the law of each leg then."""
        return clear_laws(self.conditioned, self.by_leg(changed.lost))

    def _clear_corridors(self, newest: OccupancyMap) -> tuple[Corridors, ...]:
        """Corridors of the plan, narrowed by the new obstacles."""
        changed, plan = self.compare(newest), self.plan
        if self._corridors is None:
            self._corridors = plan.corridors if not len(changed.new_obstacles) else tuple(
                add_obstacles(each, changed.new_obstacles, plan.options.network.clearance,
                                   newest.resolution) for each in plan.corridors)
        return self._corridors

    def _map_part(self, newest: OccupancyMap, corridors: Corridors, node: int,
                  place: tuple[float, float],
                  neighbours: IndexArray | None) -> tuple[FloatArray, RiskMap]:
        """Cut out the map around the links of a moved node, as far as paths may go."""
        if neighbours is None:
            neighbours = corridors.links[(corridors.links == node).any(axis=1)].ravel()
        uv = np.vstack((self._planned.uv[neighbours], to_map_axes(newest.origin, [place])))
        reach = float(np.hypot(*(uv - uv[-1]).T).max())
        if self.plan.tube is not None:
            reach = self.plan.tube + 0.5 * reach
        return self._clear_ground(newest).part(uv, reach + self.plan.options.network.clearance)

    def _clear_ground(self, newest: OccupancyMap) -> ClearGround:
        return ClearGround(newest, self._occupancy, self.plan.options.network)
