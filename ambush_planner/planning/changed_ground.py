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
from ..routes.corridor_update import with_moved_end, with_new_obstacles
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
    """The value of a strategy on another map, and a lower bound on that of any strategy there.

    The bound holds for the strategy's own network: ground that has become free counts after the
    next solve. ``clear_share`` is the probability that a route meets no new obstacle and no place
    that must not be entered; if it is below 1, the value is that of drawing until a route is clear.
    ``expected_length`` [``travel_unit``] is the mean over the clear routes (inf if none is),
    ``length_budget`` what ``max_detour`` allows.
    """

    value: float
    lower_bound: float
    clear_share: float = 1.0
    expected_length: float = math.inf
    length_budget: float = math.inf
    travel_unit: str = 'm'

    @property
    def gap(self) -> float:
        """Upper bound on how much lower another strategy's value could be."""
        return self.value - self.lower_bound

    @property
    def is_blocked(self) -> bool:
        """Return whether too many routes are blocked; most strategies use all ground a little."""
        return self.clear_share < 1.0 - _MAX_BLOCKED

    @property
    def is_over_budget(self) -> bool:
        """Return whether the clear routes are longer on average than the length budget allows."""
        return self.length_budget * (1.0 + BUDGET_TOLERANCE) < self.expected_length < math.inf

    @property
    def concern(self) -> str:
        """A warning about the length of the clear routes, in words; '' if there is none."""
        if not self.is_over_budget:
            return ''
        return (f'the routes that are clear on the current map have a mean length of '
                f'{self.expected_length:.4g} {self.travel_unit}, '
                f'{self.expected_length / self.length_budget:.3g} times the budget of '
                f'{self.length_budget:.4g} {self.travel_unit} (strategy.max_detour)')

    def is_stale(self, original_value: float, tolerance: float) -> bool:
        """Return whether to solve again; ``original_value`` is that on the strategy's own map."""
        return self.is_blocked or self.value > original_value * (1.0 + tolerance) + 1e-12

    def allows_departure(self, max_gap: float, original_gap: float) -> bool:
        """Return whether a convoy may depart on the strategy before the next solve.

        ``max_gap`` bounds, as a share of the value, how much the gap may exceed ``original_gap``,
        the gap on the strategy's own map; both include the risk slack.
        """
        growth = self.gap - original_gap
        return self.clear_share >= MIN_CLEAR and growth <= max_gap * self.value + 1e-12


class ChangedGround:
    """Assesses a plan, and draws its routes, on other maps of the same ground.

    The plan was solved on the map ``planned_on``; ``occupancy`` says how cell values are read.
    Several plans may share the ``losses`` of the newest map.
    """

    def __init__(self, plan: Plan, planned_on: OccupancyMap, occupancy: OccupancyOptions,
                 losses: LatestLosses | None = None) -> None:
        self.plan, self._planned_on, self._occupancy = plan, planned_on, occupancy
        self._cell_losses = losses or LatestLosses()
        self._planned = PlannedNetwork(plan, planned_on, occupancy, self._cell_losses)
        self._latest: ChangedNetwork | None = None
        self._assessment: Assessment | None = None
        self._corridors: tuple[Corridors, ...] | None = None
        self._search: CellSearch | None = None  # keeps which routes pass where, on any map

    def compare(self, newest: OccupancyMap) -> ChangedNetwork:
        """Compare the plan's network on the newest map, which is of the same ground."""
        if self._latest is None or self._latest.newest is not newest:
            self._latest = self._planned.on(newest)
            self._assessment = self._corridors = None
        return self._latest

    def forget_all_but(self, newest: OccupancyMap) -> None:
        """Free what is known of another map than this one; all if the last map did not matter."""
        if self._latest is None:
            self._search = None
        elif self._latest.newest is not newest:
            self._latest = self._assessment = self._corridors = None

    def assess(self, newest: OccupancyMap) -> Assessment:
        """Return the value of the strategy on the newest map, which is of the same ground."""
        look = self.compare(newest)
        if self._assessment is None:
            self._assessment = self._assess(look)
        return self._assessment

    def drawn_from(self, newest: OccupancyMap) -> TripStrategy:
        """Return the strategies that departures on the newest map are drawn from.

        They are the plan's, given that their routes are clear, with the losses and the value of
        that map. Raises ValueError if no route is clear.
        """
        look, known, trip = self.compare(newest), self.assess(newest), self.plan.trip
        certificate = Certificate(known.value, known.lower_bound)
        if self._is_unchanged(look):
            same = certificate.value == trip.value
            return trip if same else with_certificate(trip, certificate)
        share, laws = self.clear_laws(look)
        if not share > 0.0:
            raise ValueError('no route of the strategy is clear')
        legs = legs_in_game(trip, trip.game.options, look.alpha)
        drawn = tuple(replace(
            leg, game=game, budget=budget,
            edge_probability=frozen_array(law.uses(len(leg.edge_probability)), np.float64),
            mixture=law if isinstance(law, RouteMixture) else None)
            for leg, game, budget, law in zip(trip.legs, legs.games, legs.budgets, laws,
                                              strict=True))
        return with_certificate(replace(trip, legs=drawn), certificate)

    def connects(self, newest: OccupancyMap, ends: Ends) -> bool:
        """Return whether all first and last edges in use can be driven from start and to goal.

        All of them: whether the plan suits must not depend on the route that is drawn.
        """
        (start, goal), plan = ends, self.plan
        if any(one == other for one, other in pairwise((start, *plan.stops_xy, goal))):
            return False  # the solve will refuse it
        lost = self.by_leg(self.compare(newest).lost)
        # Start and goal separately: the rectangle around both may be the whole map.
        for k, node, place in ((0, 'source', start), (-1, 'target', goal)):
            network, at = plan.legs[k].network, (1, 0)[k]
            used = (plan.legs[k].edge_probability > 0.0) & ~lost[k]
            used &= network.edges[:, 1 - at] == getattr(network, node)
            others = network.points[network.edges[used, at]]
            here = np.broadcast_to(place, others.shape)
            a, b = (here, others) if node == 'source' else (others, here)
            # A step of length 0 has no direction.
            if (a == b).all(axis=1).any() or not self.clear(a, b, newest).all():
                return False
        return True

    def draw(self, rng: np.random.Generator, newest: OccupancyMap, first: int = 0) -> Route | None:
        """Draw routes of the legs from ``first`` on until each is clear on the newest map.

        A route then has its conditional probability, given that it is clear. None after too many
        draws.
        """
        lost, drawn = self.by_leg(self.compare(newest).lost), []
        for leg, own in zip(self.plan.legs[first:], lost[first:], strict=True):
            for _ in range(_MAX_DRAWS):
                nodes = leg.sample_route(rng)
                if not own.any() or not own[route_edges(leg.network, nodes)].any():
                    drawn.append(nodes)
                    break
            else:
                return None
        return tuple(drawn)

    def fitted(self, newest: OccupancyMap, ends: Ends, joins: IndexArray | None = None,
               first: int = 0) -> Plan:
        """Return the plan from leg ``first`` on, with corridors that are clear on the newest map.

        They are between ``ends``.

        The path of a clear route is then clear, and so are the connections to the ends if their
        straight lines are (``clear``). The start is connected with the same nodes as before, or
        with the nodes ``joins`` (K,).
        """
        plan, options = self.plan.legs_from(first), self.plan.options.network
        corridors = list(self._clear_corridors(newest)[first:])
        for k, node, place, others in (
                (0, plan.network.source, ends[0], joins),
                (len(corridors) - 1, plan.legs[-1].network.target, ends[1], None)):
            if tuple(plan.network.points[node].tolist()) != place:
                corner, part = self._around(newest, corridors[k], node, place, others)
                corridors[k] = with_moved_end(corridors[k], node, place, part, corner,
                                              options.clearance, options.clear_of_edge, others)
        return replace(plan, corridors=tuple(corridors))

    @cached_property
    def conditioned(self) -> tuple[ConditionedStrategy, ...]:
        """The strategy of each leg on condition that routes avoid some edges."""
        return tuple(ConditionedStrategy(leg) for leg in self.plan.legs)

    def clear(self, a: FloatArray, b: FloatArray, newest: OccupancyMap) -> BoolArray:
        """Return whether segments a -> b, both (K, 2), clear the newest map's obstacles: (K,).

        Those of one call should lie together: the map is read around all of them.
        """
        return self._clear_ground(newest).segments(a, b)

    def at_any_cell(self, at_sites: Certificate, newest: OccupancyMap, law: Law,
                    on_others: bool = False, moved: Legs | None = None) -> Certificate:
        """The certificate of a law, against ambushers at any cell if the plan's is.

        Only at cells that have changed if ``at_sites`` holds ``on_others``. The law is of the
        plan's legs, or of those that have ``moved``.
        """
        changed = self._changed(newest)
        if (math.isinf(at_sites.value) or not holds_anywhere(self.plan.options)
                or (on_others and not len(changed))):
            return at_sites
        cells = self._cell_losses.on(newest if len(changed) else self._planned_on,
                                     self._occupancy, self._planned.hiding)
        if moved is None:
            self._search = self._search or CellSearch(cells, self.plan.trip.joint.games, self._used)
            search = self._search.on(cells)
        else:
            search = CellSearch(cells, moved.games, law.uses(moved.edge_count) > 0.0)
        among = None
        if on_others and not self._planned.hiding:
            among = np.stack(np.divmod(changed, newest.values.shape[1]), axis=1)
        worst = search.worst(law, at_sites.value, among=among)
        return replace(at_sites, value=max([at_sites.value, *worst.mean_loss[:1]]))

    def _changed(self, newest: OccupancyMap) -> IndexArray:
        """The cells whose losses have changed.

        Cells that have become obstacles hide nobody. If only such cells have changed, all ambushers
        of the planned map count, so that its losses need not be computed again.
        """
        changed = self.compare(newest).changed
        if self._planned.hiding:
            return changed
        return changed[~obstacles_in(newest.values.ravel()[changed], self._occupancy)]

    def _assess(self, look: ChangedNetwork) -> Assessment:
        """Return the assessment of drawing routes until one avoids the lost edges."""
        plan, trip = self.plan, self.plan.trip
        if look.lost.all():
            return Assessment(math.inf, 0.0, 0.0)
        known, unchanged = trip.certificate, self._is_unchanged(look)
        clear_share, laws = self.clear_laws(look)
        if not clear_share > 0.0:
            return Assessment(math.inf, 0.0, 0.0)
        law = joint_law(trip.joint, laws)
        if not unchanged:
            known = revalue(trip, look.alpha, law)
        known = self.at_any_cell(known, look.newest, law, unchanged)
        length = sum(float(own.uses(len(leg.edge_probability)) @ leg.network.travel_costs)
                     for leg, own in zip(plan.legs, laws, strict=True))
        return Assessment(known.value, known.bound, clear_share, length,
                          plan.options.strategy.max_detour * trip.shortest_length,
                          plan.network.travel_unit)

    @cached_property
    def _used(self) -> BoolArray:
        """The edges (M,) that routes of the plan use."""
        return np.concatenate([leg.edge_probability for leg in self.plan.legs]) > 0.0

    def by_leg(self, lost: BoolArray) -> list[BoolArray]:
        """The lost edges (M,), leg by leg."""
        return np.split(lost, self.plan.trip.joint.first[1:-1])

    def _is_unchanged(self, look: ChangedNetwork) -> bool:
        """Return whether no edge in use is lost, and no node's loss has changed."""
        return (not look.lost[self._used].any()
                and np.array_equal(look.alpha, self.plan.network.alpha))

    def clear_laws(self, look: ChangedNetwork) -> tuple[float, list[Law]]:
        """The probability that a route avoids the lost edges, and the law of each leg then."""
        return clear_laws(self.conditioned, self.by_leg(look.lost))

    def _clear_corridors(self, newest: OccupancyMap) -> tuple[Corridors, ...]:
        """Return the plan's corridors among the new obstacles."""
        look, plan = self.compare(newest), self.plan
        if self._corridors is None:
            self._corridors = plan.corridors if not len(look.new_obstacles) else tuple(
                with_new_obstacles(each, look.new_obstacles, plan.options.network.clearance,
                                   newest.resolution) for each in plan.corridors)
        return self._corridors

    def _around(self, newest: OccupancyMap, corridors: Corridors, node: int,
                place: tuple[float, float],
                neighbours: IndexArray | None) -> tuple[FloatArray, RiskMap]:
        """Return the map around the links of a moved node, as far as paths may go."""
        at = neighbours
        if at is None:
            at = corridors.links[(corridors.links == node).any(axis=1)].ravel()
        uv = np.vstack((self._planned.uv[at], to_map_axes(newest.origin, [place])))
        wide = float(np.hypot(*(uv - uv[-1]).T).max())
        if self.plan.tube is not None:
            wide = self.plan.tube + 0.5 * wide
        return self._clear_ground(newest).part(uv, wide + self.plan.options.network.clearance)

    def _clear_ground(self, newest: OccupancyMap) -> ClearGround:
        return ClearGround(newest, self._occupancy, self.plan.options.network)
