# SPDX-License-Identifier: Apache-2.0
"""A plan for a convoy that has moved on: its routes, joined from where the convoy is now.

The convoy drives straight to a node around it that routes of the first leg use, and goes on from
there as they do. The node is drawn as often as routes pass it. The joined routes are those of an
acyclic strategy again: on the network whose source is the convoy's place, joined to these nodes.
Its value is computed like any other, and counts each site that can hit the way to the route. The
secured area is around the convoy's place instead of the planned start. Later legs stay as they are.

A convoy that is on its way, and finds the rest of its route blocked, takes another rest of the same
plan (``other_rest``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import BoolArray, FloatArray, IndexArray, frozen_array, sums
from ..errors import AmbushPlannerError
from ..game.budget import Budget, length_budget
from ..game.certificate.certificate import Certificate, lower_bounds
from ..game.distribution.chain import NO_FLOW, RouteMixture, chain_of
from ..game.game import make_game, make_games
from ..game.hits import Law, joint_law, largest_product
from ..game.legs import Legs
from ..game.route_sampler import route_edges
from ..game.strategy import Strategy, TripStrategy
from ..maps.occupancy import OccupancyMap
from ..network.network import Network
from ..routes.corridors import secured_in_map_axes
from ..routes.driven_path import Ends
from .changed_ground import MIN_CLEAR, Assessment, ChangedGround
from .conditioning import ConditionedStrategy
from .departure import DrawnRoute
from .plan import Plan, Route, departure_path

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
    away = math.dist(ends[0], plan.start_xy)
    if plan.options.network.roads or away > REGION * plan.spacing:
        return None
    look, begins = ground.compare(newest), ground.conditioned[0]
    share, laws = ground.clear_laws(look)
    if share < MIN_CLEAR:
        return None
    p = laws[0].uses(len(network.edges))
    at = _nodes_ahead(ground, newest, ends[0], p)
    if not len(at):
        return None
    kept, lost = network.tails != network.source, ground.by_leg(look.lost)[0]
    points = network.points.copy()
    points[network.source] = ends[0]
    edges = np.column_stack((np.full(len(at), network.source), at))
    moved = replace(network, points=points, alpha=look.alpha, ground_length=None, seconds=None,
                    edges=np.concatenate((network.edges[kept], edges)))
    odds = sums(network.heads, p, len(points))[at]
    odds /= odds.sum()
    onwards = begins.onwards(sums(at, odds, len(points)), lost)
    try:
        trip = _joined_trip(ground, newest, moved, np.concatenate((onwards[kept], odds)), laws)
    except AmbushPlannerError:  # no route within the budget
        return None
    fitted = ground.fitted(newest, ends, np.unique(at))
    first = fitted.corridors[0]
    secured = secured_in_map_axes(trip.game.secured.shrunk(trip.game.options.tube), first.origin)
    first = replace(first, network=moved, secured=secured)
    joined = replace(fitted, trip=trip, corridors=(first, *fitted.corridors[1:]))
    return JoinedPlan(joined, Assessment(trip.value, trip.lower_bound, share, trip.expected_length,
                                         sum(leg.length_budget for leg in trip.legs),
                                         moved.travel_unit))


def other_rest(ground: ChangedGround, newest: OccupancyMap, ends: Ends, leg: int,
               ahead: IndexArray, source: Sequence[int],
               spacing: float = 0.0) -> DrawnRoute | None:
    """Draw another rest of the routes that the convoy at ``ends[0]`` [m] is on, in a ``leg``.

    The rest of the leg is drawn on condition that it begins at the first of the nodes ``ahead``
    (K,) from which it can be driven on the newest map; the convoy drives straight there. The legs
    after it are drawn again.

    ``source`` and ``spacing`` are those of ``draw_route``. The route is that of this leg and those
    after it, with the source of the leg in place of the convoy. None if no rest is clear.
    """
    rng, network = np.random.default_rng(source), ground.plan.legs[leg].network
    lost, place = ground.by_leg(ground.compare(newest).lost)[leg], np.array([ends[0]])
    for node in ahead.tolist():
        at = network.points[[node]]
        if (at == place).all() or not ground.clear(place, at, newest).all():
            continue
        rest = ground.conditioned[leg].draw_from(node, lost, rng)
        later = ground.draw(rng, newest, leg + 1)
        if rest is not None and later is not None:
            route = (np.concatenate(([network.source], rest)), *later)
            fitted = ground.fitted(newest, ends, np.array([node]), leg)
            path = departure_path(fitted, route, spacing or fitted.spacing, ends)
            return DrawnRoute(route, path, rng)
    return None


def whole_route(left: Route, drawn: Route) -> Route:
    """Return the whole route of a convoy that has left a route for another rest of it.

    ``drawn`` is that of ``other_rest``. Raises ValueError if the rest does not begin on the route
    that was ``left``.
    """
    leg = len(left) - len(drawn)
    (at,) = np.flatnonzero(left[leg] == drawn[0][1])
    return (*left[:leg], frozen_array(np.concatenate((left[leg][:at], drawn[0][1:])), np.int64),
            *drawn[1:])


def rest_strategy(ground: ChangedGround, newest: OccupancyMap, route: Route,
                  drawn: Route) -> TripStrategy:
    """Return the strategies that a whole route is from, given how it began.

    ``other_rest`` has drawn the rest on the newest map, as in ``whole_route``. Raises ValueError if
    it cannot have drawn one from there.
    """
    trip, number = ground.plan.trip, len(route) - len(drawn)
    legs, lost = list(trip.legs), ground.by_leg(ground.compare(newest).lost)
    for k, nodes in enumerate(route[: number + 1]):
        rest = drawn[0] if k == number else nodes[-2:]
        legs[k] = _leg_given(legs[k], ground.conditioned[k], lost[k], nodes, rest)
    return replace(trip, legs=tuple(legs))


def _leg_given(strategy: Strategy, conditioned: ConditionedStrategy, lost: BoolArray,
               nodes: IndexArray, drawn: IndexArray) -> Strategy:
    """The strategy of a leg given that its route (K,) began as it did, and the rest was drawn."""
    network = strategy.network
    begins = np.zeros(len(network.points))
    begins[drawn[1]] = 1.0
    ended = drawn[1] == network.target
    p = np.zeros(len(lost)) if ended else conditioned.onwards(begins, lost)
    driven = nodes[:len(nodes) - len(drawn) + 2]
    steps = np.column_stack((driven[:-1], driven[1:]))
    if len(new := steps[route_edges(network, driven) < 0]):  # a departure that joined its plan
        seconds = network.seconds
        if seconds is not None:
            seconds = np.append(seconds, np.zeros(len(new)))
        network = replace(network, edges=np.concatenate((network.edges, new)), seconds=seconds)
        p = np.concatenate((p, np.zeros(len(new))))
        game = make_game(network, strategy.game.options)
        strategy = replace(strategy, game=game, budget=replace(strategy.budget, game=game))
    p[route_edges(network, driven)] = 1.0
    return replace(strategy, edge_probability=frozen_array(p, np.float64), mixture=None)


def _nodes_ahead(ground: ChangedGround, newest: OccupancyMap, place: tuple[float, float],
                 p: FloatArray) -> IndexArray:
    """Return nodes (K,) on the first leg's routes of p (M,) to which a straight line is clear.

    They are at most ``_MAX_JOINS``, at all distances up to ``_STRAIGHT``.
    """
    network, reach = ground.plan.network, _STRAIGHT * ground.plan.spacing
    away = np.hypot(*(network.points - place).T)
    on_routes = sums(network.heads, p, len(away)) > NO_FLOW
    at = np.flatnonzero(on_routes & (away > 0.0) & (away <= reach))
    at = at[ground.clear(np.broadcast_to(place, (len(at), 2)), network.points[at], newest)]
    at = at[np.argsort(away[at], kind='stable')]
    return np.sort(at[::math.ceil(len(at) / _MAX_JOINS)]) if len(at) else at


def _joined_trip(ground: ChangedGround, newest: OccupancyMap, network: Network, p: FloatArray,
                 laws: Sequence[Law]) -> TripStrategy:
    """The strategies on another network of the first leg, with p (M,), and on those of the others.

    The length may exceed the budget, whose best routes begin elsewhere. Raises NoRoute or
    BudgetInfeasible if the best route exceeds it.
    """
    before, options = ground.plan.trip, ground.plan.options.strategy
    others = [replace(leg.network, alpha=network.alpha) for leg in before.legs[1:]]
    games = make_games((network, *others), before.game.options, before.ambusher.q > 0.0)
    budgets = (length_budget(games[0], options.max_detour), *(
        Budget(game, leg.length_budget, leg.shortest_length)
        for game, leg in zip(games[1:], before.legs[1:], strict=True)))
    legs = Legs(games, budgets)
    ambusher = replace(before.ambusher, circulations=())
    laws = (chain_of(network, p), *laws[1:])
    law = joint_law(legs, laws)
    value, _ = largest_product(legs.loss, legs.entering, law)
    bound = max(float(lower_bounds(legs, ambusher).sum()), 0.0)
    at_nodes = Certificate(value, min(bound, value))
    anywhere = replace(at_nodes, value=ground.at_any_cell(at_nodes, newest, law, moved=legs).value)
    strategies = [Strategy(game, frozen_array(own.uses(len(game.playable)), np.float64), alone,
                           budget, anywhere, own if isinstance(own, RouteMixture) else None)
                  for game, budget, alone, own in zip(
                      games, budgets, ambusher.by_leg(), laws, strict=True)]
    return TripStrategy(tuple(strategies), anywhere)
