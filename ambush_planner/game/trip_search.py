# SPDX-License-Identifier: Apache-2.0
"""The search on a trip: a mixture of routes and its proof, then a distribution on layers.

One leg goes the same way if a chain costs more than the slack.
"""

from __future__ import annotations

import contextlib
import math
import time
from typing import NamedTuple

import numpy as np

from ..arrays import NEGLIGIBLE, FloatArray
from ..errors import SolverFailed, TimeLimit
from .chain_search import find_sites
from .distribution.chain import SeparateLegs, chain_of, conserved_strategy
from .distribution.route_distribution import RouteDistribution
from .layered_graph import LayeredGraph
from .search import FLOW_SLACK, Incumbent, Search
from .slack import ROUNDS, ceiling, within
from .value.mixtures import Mixtures
from .value.routes import ROUTES, Routes


class TripSearch(NamedTuple):
    """The constants of the search on a trip."""

    # Share of the time limit for the first proof, if sites join later; for the last one, if they
    # joined until then; and for the distribution.
    proof: float = 0.1
    lines: int = 64  # level lines of each leg from which the first routes are made
    fewest: int = 4  # routes with a layer of their own at first
    width: int = 32  # the number of these routes times the width of their layers in edges


TRIP = TripSearch()


def find_legs(search: Search, lp: Routes) -> None:
    """Find what each leg proves by itself, and the sites that matter for that."""
    assert lp.planar is not None  # else it takes as long as ``find_mixture``
    planar, network = lp.planar, search.game.network
    leg = network.leg[network.tails]
    find_sites(search, lp.prove_by_legs,
               lambda: SeparateLegs(chain_of(network, planar.flow), leg))


def find_mixture(search: Search, lp: Routes) -> None:
    """Let sites join a mixture of routes, then prove its value: a proof takes seconds."""
    begin, end = time.monotonic(), search.problem.deadline
    if not lp.planar and search.game.reach > 0.0 and end < math.inf:
        lp.deadline = begin + TRIP.proof * (end - begin)
        with contextlib.suppress(TimeLimit, SolverFailed):
            lp.prove_by_legs(end)
    lp.deadline = begin + (1.0 - 2.0 * TRIP.proof) * (end - begin)
    with search.keep_incumbent():
        if lp.planar:
            lp.add_level_lines(TRIP.lines)
        elif search.game.reach == 0.0:
            lp.prove_by_legs()
        lp.solve(prove=False)
    apart, before = 1.0, lp.value
    for _ in range(ROUNDS):
        above = ceiling(lp.value, FLOW_SLACK * search.slack)
        if time.monotonic() > lp.deadline or (
                search.join_worst(lp.mixture, above, apart) is None and apart == ROUTES.apart):
            break
        with search.keep_incumbent():
            lp.solve(prove=False)
            if within(lp.value, before, FLOW_SLACK / 2.0 * search.slack):  # the bound may be near
                lp.prove_by_legs()
        apart, before = max(apart / 2.0, ROUTES.apart), lp.value
    late = time.monotonic() > lp.deadline
    if late:
        lp.deadline = begin + (1.0 - TRIP.proof) * (end - begin)
    with search.keep_incumbent():
        lp.prove_by_legs(end)
        if not late:
            lp.solve()
    lp.deadline = end


def find_trip(search: Search, lp: Routes, best: Incumbent | None = None) -> Incumbent | None:
    """The distribution of least value on a layered graph, or the best so far; None without any.

    It is found around few routes of a solved LP, or more if it costs too much. Its value is at most
    (1 + slack) times the bound if possible, or (1 + slack / 2) times that of the mixture. No
    labels are needed if the bound is 0: one chain on the edges that no site hits will do.
    """
    count, most, next_takes = TRIP.fewest, 2 * len(lp.routes), 0.0
    while (lp.bound > 0.0 and count < max(most, 2 * TRIP.fewest)
           and time.monotonic() + next_takes < search.problem.deadline):
        begin = time.monotonic()
        around = _around(search, lp, count)
        next_takes = 2.0 * (time.monotonic() - begin)
        count *= 2
        if around is None:
            continue
        found = _rounds(search, lp, *around)
        if found and (best is None or found.value < best.value):
            best = found
        if best and best.value <= ceiling(lp.bound, search.slack):
            break
        with search.keep_incumbent():  # sites have joined
            lp.solve(prove=False)
    return best


def _around(search: Search, lp: Routes, count: int
            ) -> tuple[RouteDistribution, LayeredGraph, Mixtures, FloatArray] | None:
    """A distribution on layers around the best ``count`` routes; these routes, and their shares.

    None if these routes cost too much more than all of them, or exceed the budget.
    """
    game, slack, deadline = search.game, search.slack, search.problem.deadline
    few = lp.mixtures.among(np.argsort(-lp.shares, kind='stable')[:count])
    try:
        shares = few.solve(ROUTES.tight, deadline).shares
    except (SolverFailed, TimeLimit):
        return None
    if not within(few.value(shares), lp.value, FLOW_SLACK * slack) and count < len(lp.shares):
        return None
    flow = conserved_strategy(game, few.flow(shares, len(game.playable)), NEGLIGIBLE)
    assert flow is not None  # one route of n has a share of 1 / n or more
    layers = LayeredGraph(game, flow, few.routes, shares, max(TRIP.width // count, 1))
    distribution = RouteDistribution(layers.network, layers.p, search.problem.budget,
                                     slack, False, deadline)
    distribution.add_sites(lp.entering, lp.loss)
    return distribution, layers, few, shares


def _rounds(search: Search, lp: Routes, distribution: RouteDistribution, layers: LayeredGraph,
            few: Mixtures, shares: FloatArray) -> Incumbent | None:
    """The best distribution of rounds in which sites that it costs too much join."""
    best: Incumbent | None = None
    slack = search.slack
    limit = max(ceiling(lp.bound, slack), ceiling(few.value(shares), FLOW_SLACK * slack))
    for _ in range(ROUNDS):
        distribution.measure(limit / ceiling(1.0, slack))
        best = search.better(best, distribution, layers)
        done = distribution.rounds and distribution.good
        if done or search.problem.late:
            break
        feasible = distribution.round()
        search.evaluations += distribution.evaluations
        if not feasible or search.problem.late:  # a round cut short costs much at other sites
            break
        found = search.join_worst(distribution.chain, limit, ROUTES.apart)
        if found:
            distribution.add_sites(found.entering, found.alpha)
    return best
