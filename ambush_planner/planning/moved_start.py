# SPDX-License-Identifier: Apache-2.0
"""A plan for a convoy that has moved on: its routes, joined from where the convoy is now.

The convoy drives straight to a node around it that routes use, and goes on from there as they do.
The node is drawn, with the probabilities that make the value least (``joins``). The joined routes
are those of an acyclic strategy again: on the network whose source is the convoy's place, joined to
these nodes. Its value is computed like any other, and counts each site that can hit the way to the
route. The secured area is around the convoy's place instead of the planned start.

A convoy that is on its way, and finds the rest of its route blocked, takes another rest of the same
plan (``other_rest``).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray, IndexArray, frozen_array, sums
from ..errors import AmbushPlannerError
from ..game.ambusher import Ambusher
from ..game.budget import Budget
from ..game.certificate.certificate import Certificate, lower_bound
from ..game.distribution.chain import NO_FLOW
from ..game.game import make_game
from ..game.hits import worst_loss
from ..game.route_sampler import route_edges
from ..game.strategy import Strategy
from ..maps.occupancy import OccupancyMap
from ..network.network import Network
from ..routes.corridors import secured_in_map_axes
from ..routes.driven_path import Ends
from .changed_ground import MIN_CLEAR, Assessment, ChangedGround
from .departure import DrawnRoute
from .joins import best_first_steps
from .plan import Plan, departure_path

# Radius of the region around a plan's start in which a convoy may be that joins its routes, and
# maximum length of the straight line to them [node spacings].
REGION, _STRAIGHT = 10.0, 5.0
# Maximum number of nodes at which they are joined.
_MAX_JOINS = 60


@dataclass(frozen=True, eq=False)
class JoinedPlan:
    """A plan from another start, and its value on the newest map.

    Routes and paths are drawn from ``plan`` directly: none of its routes is blocked. The
    assessment's ``clear_share`` is the share of the original routes that are clear.
    """

    plan: Plan
    assessment: Assessment


def joined_plan(ground: ChangedGround, newest: OccupancyMap, ends: Ends) -> JoinedPlan | None:
    """Return the plan for a convoy at ``ends[0]`` [m] instead of at the planned start.

    Returns None on roads, if ``ends[0]`` is further than ``REGION`` from the planned start, if too
    few routes are clear on the newest map or none can be joined by a straight line, or if the
    strategy has cycles.
    """
    plan, network = ground.plan, ground.plan.network
    away = math.dist(ends[0], network.points[network.source].tolist())
    if plan.options.network.roads or away > REGION * plan.spacing:
        return None
    look = ground.compare(newest)
    lost = look.lost | _through_start_again(network)
    share, p = ground.conditioned.avoiding(lost)
    at = _nodes_ahead(ground, newest, ends[0], p)
    if share < MIN_CLEAR or not len(at):
        return None
    edges = np.column_stack((np.full(len(at), network.source), at))
    kept = network.tails != network.source
    points = network.points.copy()
    points[network.places == network.places[network.source]] = ends[0]
    moved = replace(network, points=points, alpha=look.alpha, ground_length=None,
                    edges=np.concatenate((network.edges[kept], edges)))

    def flow(begins: FloatArray) -> FloatArray:
        onwards = ground.conditioned.onwards(sums(at, begins, len(points)), lost)
        return np.concatenate((onwards[kept], begins))

    try:
        strategy = _best_joined(ground, newest, moved, flow, len(at))
    except AmbushPlannerError:  # no route within the budget
        return None
    fitted = ground.fitted(newest, ends, np.unique(network.places[at]))
    game, corridors = strategy.game, fitted.corridors
    secured = secured_in_map_axes(game.secured.shrunk(game.options.tube), corridors.origin)
    joined = replace(fitted, strategy=strategy,
                     corridors=replace(corridors, network=moved, secured=secured))
    return JoinedPlan(joined, Assessment(strategy.value, strategy.lower_bound, share,
                                         strategy.expected_length, strategy.length_budget,
                                         moved.travel_unit))


def other_rest(ground: ChangedGround, newest: OccupancyMap, ends: Ends, ahead: IndexArray,
               source: Sequence[int], spacing: float = 0.0) -> DrawnRoute | None:
    """Draw another rest of a route that the convoy at ``ends[0]`` [m] is on.

    The strategy is a Markov chain, so the rest is drawn from it on condition that it begins at the
    first of the nodes ``ahead`` (K,) from which it can be driven on the newest map; the convoy
    drives straight there.

    ``source`` and ``spacing`` are those of ``draw_route``. The network's source is in place of the
    convoy in the route. None if no rest is clear.
    """
    rng = np.random.default_rng(source)
    network = ground.plan.network
    lost = ground.compare(newest).lost | _through_start_again(network)
    place = np.array([ends[0]])
    for node in ahead.tolist():
        at = network.points[[node]]
        if (at == place).all() or not ground.clear(place, at, newest).all():
            continue
        rest = ground.conditioned.draw_from(node, lost, rng)
        if rest is not None:
            route = np.concatenate(([network.source], rest))
            fitted = ground.fitted(newest, ends, network.places[[node]])
            path = departure_path(fitted, route, spacing or fitted.spacing, ends)
            return DrawnRoute(route, path, None, rng)
    return None


def whole_route(left: IndexArray, drawn: IndexArray) -> IndexArray:
    """Return the whole route (K,) of a convoy that has left a route for another rest of it.

    ``drawn`` (L,) is that of ``other_rest``, the source in place of the convoy. Raises ValueError
    if the rest does not begin on the route that was ``left``.
    """
    (at,) = np.flatnonzero(left == drawn[1])
    return frozen_array(np.concatenate((left[:at], drawn[1:])), np.int64)


def rest_strategy(ground: ChangedGround, newest: OccupancyMap, route: IndexArray,
                  drawn: IndexArray) -> Strategy:
    """Return the strategy that a whole route (K,) is from, given how it began.

    ``other_rest`` has drawn the rest on the newest map, as in ``whole_route``. Raises ValueError if
    it cannot have drawn one from there.
    """
    strategy, network = ground.plan.strategy, ground.plan.network
    lost = ground.compare(newest).lost | _through_start_again(network)
    begins = np.zeros(len(network.points))
    begins[drawn[1]] = 1.0
    p = ground.conditioned.onwards(begins, lost)
    driven = route[:len(route) - len(drawn) + 2]
    steps = np.column_stack((driven[:-1], driven[1:]))
    if len(new := steps[route_edges(network, driven) < 0]):  # a departure that joined its plan
        network = replace(network, edges=np.concatenate((network.edges, new)))
        p = np.concatenate((p, np.zeros(len(new))))
        strategy = replace(strategy, game=make_game(network, strategy.game.options))
    p[route_edges(network, driven)] = 1.0
    return replace(strategy, edge_probability=frozen_array(p, np.float64))


def _nodes_ahead(ground: ChangedGround, newest: OccupancyMap, place: tuple[float, float],
                 p: FloatArray) -> IndexArray:
    """Return nodes (K,) on routes of p (M,), before any stop, to which a straight line is clear.

    They are at most ``_MAX_JOINS``, at all distances up to ``_STRAIGHT``.
    """
    network, reach = ground.plan.network, _STRAIGHT * ground.plan.spacing
    away = np.hypot(*(network.points - place).T)
    on_routes = sums(network.heads, p, len(away)) > NO_FLOW
    near = on_routes & (away > 0.0) & (away <= reach)
    at = np.flatnonzero(near & (network.leg == network.leg[network.source]))
    at = at[ground.clear(np.broadcast_to(place, (len(at), 2)), network.points[at], newest)]
    at = at[np.argsort(away[at], kind='stable')]
    return np.sort(at[::math.ceil(len(at) / _MAX_JOINS)]) if len(at) else at


def _through_start_again(network: Network) -> np.ndarray:
    """Return the edges (M,) by which later legs pass the place of the source."""
    again = network.places == network.places[network.source]
    again[network.source] = False
    return np.asarray(again[network.edges].any(axis=1))


def _best_joined(ground: ChangedGround, newest: OccupancyMap, network: Network,
                 flow: Callable[[FloatArray], FloatArray], joins: int) -> Strategy:
    """Return the best strategy on another network that begins with one of its last edges.

    ``flow`` gives p (M,) from their probabilities (``joins``,). It may exceed the budget, whose
    shortest route begins elsewhere. Raises NoRoute or BudgetInfeasible if that exceeds it.
    """
    before = ground.plan.strategy
    game = make_game(network, before.game.options)
    budget = Budget.length(game, ground.plan.options.strategy.max_detour)
    source = network.source
    away = math.dist(network.points[source], before.network.points[source])
    longest = max(budget.limit, before.expected_length + away)
    p = flow(np.full(joins, 1.0 / joins))
    p = flow(best_first_steps(game, p, longest, ground.site_search(newest, game, p)))
    ambusher = Ambusher(before.ambusher.q, before.ambusher.price * budget.binds)
    value = worst_loss(game, p)
    at_nodes = Certificate(value, min(lower_bound(game, ambusher, budget), value))
    anywhere = replace(at_nodes, value=ground.at_any_cell(at_nodes, newest, game, p).value)
    return Strategy(game, frozen_array(p, np.float64), ambusher, budget, anywhere)
