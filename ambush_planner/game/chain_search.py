# SPDX-License-Identifier: Apache-2.0
"""The search for one chain: the value, the sites that matter for it, the distribution around it.

1. *Value.* An LP finds the least value, a flow that attains it, and an ambusher who proves it.
2. *Constraint generation.* With a reach, the sites of the map that cost the flow most join the LP,
   which goes on from where it is.
3. *Route distribution.* On an acyclic network around the flow, the distribution of greatest entropy
   within the slack of the bound. Sites that cost it more join both the LP and the distribution.
"""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray
from .distribution.acyclic import acyclic_subnetwork, order_potential, topological_order
from .distribution.chain import MarkovChain, chain_of
from .distribution.gibbs import acyclic_network
from .distribution.route_distribution import AIM, RouteDistribution
from .game import Game
from .hits import hits_can_differ
from .search import GROWTH, ROUNDS, Incumbent, Search
from .slack import ceiling
from .value.routes import APART, MIN_FLOW

# Rounds of constraint generation before the distribution, in the last of them with sites at any
# distance from each other; more while the value is 0.
SWEEPS = 3
# Sites join that cost more than the bound by this share of the slack; if rows are not exact for
# every chain, a distribution aims at less.
JOINING, EARLY_AIM = 0.8, 0.7


def find_flow(search: Search) -> None:
    """Find the least value at the sites that matter for the LP's flow."""
    search.solve_lp()
    lp = search.lp
    for sweep in range(ROUNDS):
        if search.problem.late or (sweep >= SWEEPS and lp.bound > 0.0):
            break
        flow = chain_of(search.game.network, lp.flow)
        above, apart = ceiling(lp.bound, search.slack), APART * (sweep < SWEEPS - 1)
        if not _join(search, flow, above, apart, rough=sweep == 0):
            break


def _join(search: Search, chain: MarkovChain, above: float, apart: float, rough: bool = False,
          distribution: RouteDistribution | None = None) -> bool:
    """Let sites that cost a chain more than ``above`` join LP and distribution; solve again."""
    found = search.join_worst(chain, above, apart, rough)
    if found is None:
        return False
    if distribution:
        distribution.add_sites(found.entering, found.alpha)
    search.solve_lp()
    return True


def find_chain(search: Search) -> Incumbent | None:
    """The distribution of most entropy within the slack, else of least value; None if none is.

    It is found in rounds around the LP's flow; each strategy on the way counts.
    """
    lp, distribution, before = search.lp, _distribution_around(search, search.lp.flow), 0.0
    best: Incumbent | None = None
    distribution.measure(search.caps())
    if search.problem.site_search is None:  # otherwise other sites may cost the flow more
        best = search.better(best, distribution)
    for _ in range(ROUNDS):
        if search.problem.late or not distribution.round():
            break
        above = ceiling(lp.bound, JOINING * search.slack)
        joined = _join(search, distribution.chain, above, APART, distribution=distribution)
        if joined and lp.bound == 0.0:
            search.evaluations += distribution.evaluations
            # Without edges that those sites hit.
            distribution = _distribution_around(search, lp.flow)
            distribution.measure(search.caps())
            continue
        distribution.measure(search.caps())
        best = search.better(best, distribution)
        grew, before = distribution.entropy > before * (1.0 + GROWTH), distribution.entropy
        if distribution.good and (distribution.exact or not grew):
            break
    search.evaluations += distribution.evaluations
    return best


def _distribution_around(search: Search, flow: FloatArray) -> RouteDistribution:
    problem = search.problem
    game = _noticeable(search, flow)
    safe = game.avoiding(search.entering) if search.lp.bound == 0.0 else None
    if safe and not flow[~safe.playable].any():  # no route is hit at all
        game = safe
    position = topological_order(game, flow, order_potential(game))
    part = acyclic_subnetwork(game, position)
    assert part is not None  # it contains the flow
    network = acyclic_network(game.network, np.flatnonzero(part.playable), position)
    exact = not hits_can_differ(game)
    distribution = RouteDistribution(network, flow[network.edge], problem.budgets, game.ambushers,
                                     search.slack, exact, problem.deadline,
                                     AIM if exact else EARLY_AIM)
    distribution.add_sites(search.entering, search.loss)
    if problem.warm:
        prices = zip(problem.warm.budgets, problem.budgets, strict=True)
        distribution.start_from(problem.warm.sites[search.game.sites],
                                np.array([price for price, b in prices if b.binds]), search.caps())
    return distribution


def _noticeable(search: Search, flow: FloatArray) -> Game:
    """The game without edges that the budgets leave to less than ``MIN_FLOW`` of the routes.

    So all best routes for a budget that allows no others are in one order of the nodes.
    """
    game, binding = search.game, [b for b in search.problem.budgets if b.binds]
    used = [game.through(b.reduced_cost) <= b.slack / MIN_FLOW for b in binding]
    return game.restricted_to(np.all([game.playable, *used], axis=0) | (flow > 0.0)) or game
