# SPDX-License-Identifier: Apache-2.0
"""The search for one chain: the value, the sites that matter for it, the distribution around it.

1. *Value.* An LP finds the least value, a flow that attains it, and an ambusher who proves it.
2. *Constraint generation.* With a reach, the sites of the map that cost the flow most join the LP,
   which goes on from where it is.
3. *Route distribution.* On an acyclic network around the flow, the distribution of greatest entropy
   within the slack of the bound. Sites that cost it more join both the LP and the distribution.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ..arrays import NEGLIGIBLE, FloatArray
from .distribution.acyclic import acyclic_subnetwork, order_potential, topological_order
from .distribution.chain import chain_of
from .distribution.gibbs import acyclic_network
from .distribution.route_distribution import DISTRIBUTION, RouteDistribution
from .game import Game
from .search import Drawn, Incumbent, Search
from .slack import ROUNDS, ceiling
from .value.routes import ROUTES


class ChainSearch(NamedTuple):
    """The constants of the search for one chain."""

    # How often sites join before the distribution is sought; more often while the value is 0. In
    # the last of these rounds and later, sites may be as near to each other as the LP allows.
    sweeps: int = 3
    joining: float = 0.8  # share of the slack beyond which sites join a distribution
    # Least relative growth of the entropy for another round: what a rough one may miss.
    growth: float = DISTRIBUTION.early_accuracy.missing
    # Share of the time until the deadline after which the flow is improved, if no distribution is
    # within the slack by then.
    rounds: float = 0.8


CHAIN = ChainSearch()


def find_flow(search: Search, sweeps: int = CHAIN.sweeps) -> None:
    """Find the least value at the sites that matter for the LP's flow."""
    find_sites(search, search.lp.solve, lambda: chain_of(search.game.network, search.lp.flow),
               sweeps)


def find_sites(search: Search, solve: Callable[[], None], drawn: Callable[[], Drawn],
               sweeps: int = CHAIN.sweeps) -> None:
    """Let the LP ``solve``, and the sites that matter for what is then ``drawn`` join, by turns."""
    for sweep in range(ROUNDS):
        with search.keep_incumbent():
            solve()
        if search.problem.late or (sweep >= sweeps and search.lp.bound > 0.0):
            break
        apart = ROUTES.apart if sweep < CHAIN.sweeps - 1 else 0.0
        above = ceiling(search.lp.bound, search.slack)
        if search.join_worst(drawn(), above, apart, rough=sweep == 0) is None:
            break


def find_chain(search: Search) -> Incumbent | None:
    """The distribution of most entropy within the slack, else of least value; None if none is.

    It is found in rounds around the LP's flow; each strategy on the way counts. Rounds can lead to
    a chain from which no distribution keeps the limits of sites that joined: then they begin again.
    """
    lp, distribution, before = search.lp, _around_flow(search), 0.0
    best: Incumbent | None = None
    end, begin = search.problem.deadline, time.monotonic()
    latest = begin + CHAIN.rounds * (end - begin)
    if search.problem.site_search is None:  # otherwise other sites may cost the flow more
        best = search.better(best, distribution)
    for _ in range(ROUNDS):
        distribution.deadline = end if best and best.good else latest
        if time.monotonic() > distribution.deadline:
            search.reason = 'time'
            break
        found, feasible = None, distribution.round()
        search.evaluations += distribution.evaluations
        if not feasible and not distribution.rounds:
            break
        if feasible:
            above = ceiling(lp.bound, CHAIN.joining * search.slack)
            found = search.join_worst(distribution.chain, above, ROUTES.apart)
        if found:
            distribution.add_sites(found.entering, found.alpha)
            with search.keep_incumbent():
                lp.solve()
        if not feasible or (found and lp.bound == 0.0):
            # The flow keeps to the cap at all sites: begin again there, and if the bound is 0,
            # without edges that they hit.
            distribution = _around_flow(search)
            continue
        distribution.measure(search.cap())
        best = search.better(best, distribution)
        grew, before = distribution.entropy > before * (1.0 + CHAIN.growth), distribution.entropy
        kept = best is not None and best.good  # one that was over the budget is not
        if distribution.good and (distribution.exact or kept and not grew):
            break
    if best and not best.good:
        find_flow(search, ROUNDS)
        best = search.better(best, _around_flow(search))
    return best


def _around_flow(search: Search) -> RouteDistribution:
    """The LP's flow as the first strategy of rounds."""
    problem, flow = search.problem, search.lp.flow
    game = _noticeable(search, flow)
    safe = game.avoiding(search.entering) if search.lp.bound == 0.0 else None
    if safe and not flow[~safe.playable].any():  # no route is hit at all
        game = safe
    position = topological_order(game, flow, order_potential(game))
    part = acyclic_subnetwork(game, position)
    assert part is not None  # it contains the flow
    network = acyclic_network(game.network, np.flatnonzero(part.playable), position)
    exact = game.entries_are_hits
    distribution = RouteDistribution(network, flow[network.edge], problem.budget,
                                     search.slack, exact, problem.deadline, rough=True)
    distribution.add_sites(search.entering, search.loss)
    distribution.measure(search.cap())
    return distribution


def _noticeable(search: Search, flow: FloatArray) -> Game:
    """The game without edges that the budget leaves to less than ``NEGLIGIBLE`` of the routes.

    So all shortest routes for a budget that allows no others are in one order of the nodes.
    """
    game, budget = search.game, search.problem.budget
    if not budget.binds:
        return game
    used = game.through(budget.reduced_cost) <= budget.slack / NEGLIGIBLE
    return game.restricted_to((game.playable & used) | (flow > 0.0)) or game
