# SPDX-License-Identifier: Apache-2.0
"""Plans for a convoy that is not at the planned start: it joins the routes from its place.

The convoy drives straight to a node nearby that routes of the first leg use, and goes on from there
as they do. The node is drawn in proportion to the routes through it. So the joined routes are those
of an acyclic strategy again, on the network whose source is the convoy's place, with an edge to
each of these nodes. Its value is computed like any other, and covers the way to the route. The
secured area is around the convoy's place instead of the planned start. Later legs stay as they are.

A convoy under way whose route is blocked takes another rest of the same plan (``other_rest``).
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

# Largest distance of a convoy from the plan's start, and of the nodes at which it joins the routes
# from the convoy [node spacings].
REGION, _STRAIGHT = 10.0, 5.0
# Maximum number of these nodes.
_MAX_JOINS = 60


@dataclass(frozen=True, eq=False)
class JoinedPlan:
    """A plan from another start, with its assessment on the newest map.

    None of the routes of ``plan`` is blocked; ``clear_share`` of the assessment is the share of the
    original routes that are clear.
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
    if (plan.options.network.roads
            or math.dist(ends[0], plan.start_xy) > REGION * plan.spacing):
        return None
    changed = ground.compare(newest)
    share, laws = ground.clear_laws(changed)
    if share < MIN_CLEAR:
        return None
    p = laws[0].uses(len(network.edges))
    joins = _join_nodes(ground, newest, ends[0], p)
    if not len(joins):
        return None
    stays, lost = network.tails != network.source, ground.by_leg(changed.lost)[0]
    points = network.points.copy()
    points[network.source] = ends[0]
    edges = np.column_stack((np.full(len(joins), network.source), joins))
    moved = replace(network, points=points, alpha=changed.alpha, ground_length=None, seconds=None,
                    edges=np.concatenate((network.edges[stays], edges)))
    odds = sums(network.heads, p, len(points))[joins]
    odds /= odds.sum()
    rest = ground.conditioned[0].rest_flow(sums(joins, odds, len(points)), lost)
    try:
        trip = _joined_trip(ground, newest, moved, np.concatenate((rest[stays], odds)), laws)
    except AmbushPlannerError:  # no route within the budget
        return None
    fitted = ground.fit_plan(newest, ends, np.unique(joins))
    first = fitted.corridors[0]
    secured = secured_in_map_axes(trip.game.secured.shrink(trip.game.options.tube), first.origin)
    first = replace(first, network=moved, secured=secured)
    joined = replace(fitted, trip=trip, corridors=(first, *fitted.corridors[1:]))
    return JoinedPlan(joined, Assessment(trip.value, trip.lower_bound, share, trip.expected_length,
                                         sum(leg.length_budget for leg in trip.legs),
                                         moved.travel_unit))


def other_rest(ground: ChangedGround, newest: OccupancyMap, ends: Ends, leg: int,
               ahead: IndexArray, source: Sequence[int],
               spacing: float = 0.0) -> DrawnRoute | None:
    """Draw another rest of the route for a convoy at ``ends[0]`` [m] that is driving a ``leg``.

    The convoy drives straight to the first of the nodes ``ahead`` (K,) from which a rest of the leg
    is clear on the newest map; that rest is drawn, and later legs are drawn again. ``source`` and
    ``spacing`` are those of ``draw_route``. The route is that of this leg and later ones, with the
    source of the leg in place of the convoy. Returns None if no rest is clear.
    """
    rng, network = np.random.default_rng(source), ground.plan.legs[leg].network
    lost, place = ground.by_leg(ground.compare(newest).lost)[leg], np.array([ends[0]])
    for node in ahead.tolist():
        join = network.points[[node]]
        if (join == place).all() or not ground.clear(place, join, newest).all():
            continue
        rest = ground.conditioned[leg].draw_rest(node, lost, rng)
        later = ground.draw(rng, newest, leg + 1)
        if rest is not None and later is not None:
            route = (np.concatenate(([network.source], rest)), *later)
            fitted = ground.fit_plan(newest, ends, np.array([node]), leg)
            path = departure_path(fitted, route, spacing or fitted.spacing, ends)
            return DrawnRoute(route, path, rng)
    return None


def whole_route(left: Route, drawn: Route) -> Route:
    """Return the whole route of a convoy that changed from a route to a ``drawn`` rest.

    ``drawn`` is the route of ``other_rest``. Raises ValueError if it does not join the route that
    was ``left``.
    """
    leg = len(left) - len(drawn)
    (join,) = np.flatnonzero(left[leg] == drawn[0][1])
    return (*left[:leg], frozen_array(np.concatenate((left[leg][:join], drawn[0][1:])), np.int64),
            *drawn[1:])


def rest_strategy(ground: ChangedGround, newest: OccupancyMap, route: Route,
                  drawn: Route) -> TripStrategy:
    """Return the strategies from which a whole ``route`` was drawn, given its beginning.

    ``drawn`` is its rest, by ``other_rest`` on the newest map, as in ``whole_route``. Raises
    ValueError if no rest could be drawn from there.
    """
    trip, number = ground.plan.trip, len(route) - len(drawn)
    legs, lost = list(trip.legs), ground.by_leg(ground.compare(newest).lost)
    for k, nodes in enumerate(route[: number + 1]):
        rest = drawn[0] if k == number else nodes[-2:]
        legs[k] = _leg_given(legs[k], ground.conditioned[k], lost[k], nodes, rest)
    return replace(trip, legs=tuple(legs))


def _leg_given(strategy: Strategy, conditioned: ConditionedStrategy, lost: BoolArray,
               nodes: IndexArray, drawn: IndexArray) -> Strategy:
    """Strategy of a leg, given how its route ``nodes`` (K,) begins before the rest ``drawn``."""
    network = strategy.network
    start = np.zeros(len(network.points))
    start[drawn[1]] = 1.0
    finished = drawn[1] == network.target
    p = np.zeros(len(lost)) if finished else conditioned.rest_flow(start, lost)
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


def _join_nodes(ground: ChangedGround, newest: OccupancyMap, place: tuple[float, float],
                p: FloatArray) -> IndexArray:
    """Nodes (K,) on the first leg's routes of p (M,) to which the straight line is clear.

    They are at most ``_MAX_JOINS``, at all distances up to ``_STRAIGHT``.
    """
    network, limit = ground.plan.network, _STRAIGHT * ground.plan.spacing
    distance = np.hypot(*(network.points - place).T)
    on_routes = sums(network.heads, p, len(distance)) > NO_FLOW
    nodes = np.flatnonzero(on_routes & (distance > 0.0) & (distance <= limit))
    lines = np.broadcast_to(place, (len(nodes), 2)), network.points[nodes]
    nodes = nodes[ground.clear(*lines, newest)]
    nodes = nodes[np.argsort(distance[nodes], kind='stable')]
    return np.sort(nodes[::math.ceil(len(nodes) / _MAX_JOINS)]) if len(nodes) else nodes


def _joined_trip(ground: ChangedGround, newest: OccupancyMap, network: Network, p: FloatArray,
                 laws: Sequence[Law]) -> TripStrategy:
    """Certify p (M,) on another network of the first leg, with the laws of the later legs.

    The length of p may exceed the budget, which follows from the shortest route from the new start.
    Raises NoRoute or BudgetInfeasible if no route is within it.
    """
    planned, options = ground.plan.trip, ground.plan.options.strategy
    others = [replace(leg.network, alpha=network.alpha) for leg in planned.legs[1:]]
    games = make_games((network, *others), planned.game.options, planned.ambusher.q > 0.0)
    budgets = (length_budget(games[0], options.max_detour), *(
        Budget(game, leg.length_budget, leg.shortest_length)
        for game, leg in zip(games[1:], planned.legs[1:], strict=True)))
    legs = Legs(games, budgets)
    ambusher = replace(planned.ambusher, circulations=())
    laws = (chain_of(network, p), *laws[1:])
    law = joint_law(legs, laws)
    value, _ = largest_product(legs.loss, legs.entering, law)
    bound = max(float(lower_bounds(legs, ambusher).sum()), 0.0)
    certificate = ground.value_at_cells(Certificate(value, min(bound, value)), newest, law,
                                        moved=legs)
    strategies = [
        Strategy(game, frozen_array(leg_law.uses(len(game.playable)), np.float64), leg_ambusher,
                 budget, certificate, leg_law if isinstance(leg_law, RouteMixture) else None)
        for game, budget, leg_ambusher, leg_law in zip(
            games, budgets, ambusher.by_leg(), laws, strict=True)]
    return TripStrategy(tuple(strategies), certificate)
