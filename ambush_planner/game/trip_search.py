# SPDX-License-Identifier: Apache-2.0
"""The search on a trip: a mixture of routes and its proof, then a distribution on layers."""

from __future__ import annotations

import math
import time

import numpy as np

from ..errors import SolverFailed, TimeLimit
from .distribution.chain import conserved_strategy
from .distribution.route_distribution import RouteDistribution
from .layered_graph import LayeredGraph
from .search import GROWTH, ROUNDS, Incumbent, Search
from .slack import ceiling, within
from .value.routes import APART, MIN_FLOW, TIGHT, Routes

# Shares of the time limit after which the LP ends, as a distribution takes seconds; its first
# proof, if sites join later; and its last one, if they joined until then.
SOLVED, FIRST_PROOF, LAST_PROOF = 0.8, 0.1, 0.9
# Sites join that cost more than the mixture by JOINING slacks. A mixture that is better by less
# than SMALL slacks is no better.
JOINING, SMALL = 0.5, 0.25
# Routes with a layer of their own at first, and their number times the layers' width in edges.
FEWEST, WIDTH = 16, 128
# Share of the slack that few routes may cost more than all.
FEW_LOSE = 1.0 / 3.0


def find_mixture(search: Search, lp: Routes) -> None:
    """Let sites join a mixture of routes, then prove its value: a proof takes seconds."""
    begin, end = time.monotonic(), search.problem.deadline
    if search.game.reach > 0.0 and end < math.inf:
        _prove_until(search, lp, begin + FIRST_PROOF * (end - begin))
    lp.deadline = begin + SOLVED * (end - begin)
    with search.keep_incumbent():
        if search.game.reach == 0.0:
            lp.prove_by_legs()
        lp.solve(prove=False)
    apart, before = 1.0, lp.value
    for _ in range(ROUNDS):
        above = ceiling(lp.value, JOINING * search.slack)
        if time.monotonic() > lp.deadline or (
                search.join_worst(lp.mixture, above, apart) is None and apart == APART):
            break
        with search.keep_incumbent():
            lp.solve(prove=False)
            if within(lp.value, before, SMALL * search.slack):  # the bound may be near
                lp.prove_by_legs()
        apart, before = max(apart / 2.0, APART), lp.value
    if time.monotonic() > lp.deadline:
        _prove_until(search, lp, begin + LAST_PROOF * (end - begin))
    else:
        with search.keep_incumbent():
            lp.prove_by_legs()
            lp.solve()
    lp.deadline = end


def _prove_until(search: Search, lp: Routes, deadline: float) -> None:
    lp.deadline = deadline
    with search.keep_incumbent():
        lp.prove_by_legs()


def find_trip(search: Search, lp: Routes) -> Incumbent | None:
    """The distribution of least value on a layered graph; None if there is none.

    It is found in rounds around the LP's mixture, which go on while sites that cost it too
    much join, or the LP finds a better mixture.
    """
    problem = search.problem
    best: Incumbent | None = None
    least = math.inf
    for _ in range(ROUNDS):
        found = distribution_on_layers(search, lp)
        if found is None or best and problem.late:
            break
        above, mixed = max(found.value, ceiling(lp.bound, search.slack)), lp.value
        joined = search.join_worst(found.chain, above, APART)
        most = found.value if joined is None else float(joined.mean_loss.max())
        if most < least:
            best, least = found, most
        if problem.late or not joined and within(found.value, lp.bound, search.slack):
            break
        with search.keep_incumbent():
            lp.solve(prove=not joined)
        if not joined and within(mixed, lp.value, SMALL * search.slack):
            break
    return best


def distribution_on_layers(search: Search, lp: Routes) -> Incumbent | None:
    """The distribution on layers around few routes of a solved LP, or more if it costs too much.

    Its value is at most (1 + slack) times the bound if possible, or (1 + slack / 2) times that of
    the mixture. The last layers have all routes. Returns the distribution of least value if none is
    within the slack; None after the deadline, or if the bound is 0: one chain on the edges that no
    site hits needs no labels.
    """
    order, count = np.argsort(-lp.shares, kind='stable'), FEWEST
    game, slack, deadline = search.game, search.slack, search.problem.deadline
    best: Incumbent | None = None
    while lp.bound > 0.0 and time.monotonic() < deadline:
        few, every = lp.mixtures.among(order[:count]), count >= len(order)
        count *= 2
        try:
            shares = few.solve(TIGHT, deadline).shares
        except SolverFailed:  # these routes exceed a budget
            continue
        except TimeLimit:
            break
        value = few.value(shares)
        if within(value, lp.value, FEW_LOSE * slack) or every:
            flow = conserved_strategy(game, few.flow(shares, len(game.playable)), MIN_FLOW)
            assert flow is not None  # a route has a share of at least one in their number
            layers = LayeredGraph(game, flow, few.routes, shares, max(2 * WIDTH // count, 1))
            distribution = RouteDistribution(layers.network, layers.p, search.problem.budgets,
                                             few.ambushers, slack, False, deadline)
            distribution.add_sites(lp.entering, lp.loss)
            limit = max(ceiling(lp.bound, slack), ceiling(value, slack / 2.0))
            caps = few.caps(shares, lp.gap) * (limit / ceiling(value, slack))
            before = 0.0
            for _ in range(ROUNDS):
                distribution.measure(caps)
                best = search.better(best, distribution, layers)
                grew, before = distribution.entropy > before * (1.0 + GROWTH), distribution.entropy
                done = distribution.rounds and distribution.good and not grew
                if search.problem.late or done or not distribution.round():
                    break
            search.evaluations += distribution.evaluations
            if every or best and best.value <= limit:
                break
    return best
