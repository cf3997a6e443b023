# SPDX-License-Identifier: Apache-2.0
"""The search for one chain: the value, the places that matter for it, then the law around it.

1. *Value.* A program finds the least value, a flow that attains it, and an ambusher who proves it.
2. *Places.* With a reach, the places of the map that cost the flow most join the program, which
   goes on from where it is.
3. *Law.* On an acyclic network around the flow, the law of greatest entropy within the slack of
   the bound. Places that cost it more join both the program and the law.
"""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray
from .game import Game
from .hits import hits_can_differ
from .law.acyclic import forward_part, order_potential, rank_around
from .law.chain import MarkovChain, chain_of
from .law.gibbs import acyclic_network
from .law.law import AIM, Law
from .search import GROWTH, ROUNDS, Incumbent, Search
from .slack import ceiling
from .value.routes import APART, MIN_FLOW

# Rounds in which places join before the law, in the last of them at any distance from each other;
# more while the value is 0.
SWEEPS = 3
# Places join that cost more than the bound by this share of the slack; if rows are not exact for
# every chain, a law aims at less.
JOINING, EARLY_AIM = 0.8, 0.7


def find_flow(search: Search) -> None:
    """Find the least value at the places that matter for the program's flow."""
    search.solve_program()
    program = search.program
    for sweep in range(ROUNDS):
        if search.problem.late or (sweep >= SWEEPS and program.bound > 0.0):
            break
        flow = chain_of(search.game.network, program.flow)
        above, apart = ceiling(program.bound, search.slack), APART * (sweep < SWEEPS - 1)
        if not _join(search, flow, above, apart, rough=sweep == 0):
            break


def _join(search: Search, chain: MarkovChain, above: float, apart: float, rough: bool = False,
          law: Law | None = None) -> bool:
    """Let the places that cost a chain more than ``above`` join program and law; solve again."""
    found = search.join_worst(chain, above, apart, rough)
    if found is None:
        return False
    if law:
        law.add_sites(found.entering, found.alpha)
    search.solve_program()
    return True


def find_chain(search: Search) -> Incumbent | None:
    """The law of most entropy within the slack, else the one of least value; None if none is.

    It is found in rounds around the program's flow; each strategy on the way counts.
    """
    program, law, before = search.program, _law_around(search, search.program.flow), 0.0
    best: Incumbent | None = None
    law.measure(search.level())
    if search.problem.ground is None:  # otherwise other places may cost the flow more
        best = search.better(best, law)
    for _ in range(ROUNDS):
        if search.problem.late or not law.round():
            break
        above = ceiling(program.bound, JOINING * search.slack)
        if _join(search, law.chain, above, APART, law=law) and program.bound == 0.0:
            search.evaluations += law.evaluations
            law = _law_around(search, program.flow)  # without edges that those places hit
            law.measure(search.level())
            continue
        law.measure(search.level())
        best = search.better(best, law)
        grew, before = law.entropy > before * (1.0 + GROWTH), law.entropy
        if law.good and (law.exact or not grew):
            break
    search.evaluations += law.evaluations
    return best


def _law_around(search: Search, flow: FloatArray) -> Law:
    problem = search.problem
    game = _noticeable(search, flow)
    safe = game.avoiding(search.entering) if search.program.bound == 0.0 else None
    if safe and not flow[~safe.playable].any():  # no route is hit at all
        game = safe
    rank = rank_around(game, flow, order_potential(game))
    part = forward_part(game, rank)
    assert part is not None  # it contains the flow
    network = acyclic_network(game.network, np.flatnonzero(part.playable), rank)
    exact = not hits_can_differ(game)
    law = Law(network, flow[network.edge], problem.budgets, game.ambushers, search.slack, exact,
              problem.deadline, AIM if exact else EARLY_AIM)
    law.add_sites(search.entering, search.loss)
    if problem.warm:
        prices = zip(problem.warm.budgets, problem.budgets, strict=True)
        law.start_from(problem.warm.sites[search.game.sites],
                       np.array([price for price, b in prices if b.binds]), search.level())
    return law


def _noticeable(search: Search, flow: FloatArray) -> Game:
    """The game without edges that the budgets leave to less than ``MIN_FLOW`` of the routes.

    So all best routes for a budget that allows no others are in one order of the nodes.
    """
    game, binding = search.game, [b for b in search.problem.budgets if b.binds]
    used = [game.through(b.excess) <= b.margin / MIN_FLOW for b in binding]
    return game.restricted_to(np.all([game.playable, *used], axis=0) | (flow > 0.0)) or game
