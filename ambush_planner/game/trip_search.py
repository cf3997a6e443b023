# SPDX-License-Identifier: Apache-2.0
"""The search on a trip: a mixture of routes and its proof, then a law on labelled copies."""

from __future__ import annotations

import math
import time

import numpy as np

from ..errors import SolverFailed, TimeLimit
from .copies import Copies
from .law.chain import conserved_strategy
from .law.law import Law
from .search import GROWTH, ROUNDS, Incumbent, Search
from .slack import ceiling, within
from .value.routes import APART, MIN_FLOW, TIGHT, Routes

# Shares of the time limit after which the program ends, as its law takes seconds; its first proof,
# if places join later; and its last one, if they joined until then.
SOLVED, FIRST_PROOF, LAST_PROOF = 0.8, 0.1, 0.9
# Places join that cost more than the mixture by JOINING slacks. A mixture that is better by less
# than SMALL slacks is no better.
JOINING, SMALL = 0.5, 0.25
# Routes with a copy of their own at first, and their number times the copies' width in edges.
FEWEST, WIDTH = 16, 128
# Share of the slack that few routes may cost more than all.
FEW_LOSE = 1.0 / 3.0


def find_mixture(search: Search, program: Routes) -> None:
    """Let places join a mixture of routes, then prove its value: a proof takes seconds."""
    begin, end = time.monotonic(), search.problem.deadline
    if search.game.reach > 0.0 and end < math.inf:
        _prove_until(search, program, begin + FIRST_PROOF * (end - begin))
    program.deadline = begin + SOLVED * (end - begin)
    with search.keep_incumbent():
        if search.game.reach == 0.0:
            program.prove_by_legs()
        program.solve(prove=False)
    apart, before = 1.0, program.value
    for _ in range(ROUNDS):
        above = ceiling(program.value, JOINING * search.slack)
        if time.monotonic() > program.deadline or (
                search.join_worst(program.mixture, above, apart) is None and apart == APART):
            break
        with search.keep_incumbent():
            program.solve(prove=False)
            if within(program.value, before, SMALL * search.slack):  # the bound may be near
                program.prove_by_legs()
        apart, before = max(apart / 2.0, APART), program.value
    if time.monotonic() > program.deadline:
        _prove_until(search, program, begin + LAST_PROOF * (end - begin))
    else:
        with search.keep_incumbent():
            program.prove_by_legs()
            program.solve()
    program.deadline = end


def _prove_until(search: Search, program: Routes, deadline: float) -> None:
    program.deadline = deadline
    with search.keep_incumbent():
        program.prove_by_legs()


def find_trip(search: Search, program: Routes) -> Incumbent | None:
    """The law of least value on labelled copies of the ground; None if there is none.

    It is found in rounds around the program's mixture, which go on while places that cost it too
    much join, or the program finds a better mixture.
    """
    problem = search.problem
    best: Incumbent | None = None
    least = math.inf
    for _ in range(ROUNDS):
        found = law_on_copies(search, program)
        if found is None or best and problem.late:
            break
        above, mixed = max(found.value, ceiling(program.bound, search.slack)), program.value
        joined = search.join_worst(found.chain, above, APART)
        most = found.value if joined is None else float(joined.mean_loss.max())
        if most < least:
            best, least = found, most
        if problem.late or not joined and within(found.value, program.bound, search.slack):
            break
        with search.keep_incumbent():
            program.solve(prove=not joined)
        if not joined and within(mixed, program.value, SMALL * search.slack):
            break
    return best


def law_on_copies(search: Search, program: Routes) -> Incumbent | None:
    """The law on copies around few routes of a solved program, or around more if it costs too much.

    Its value is at most (1 + slack) times the bound if possible, or (1 + slack / 2) times that of
    the mixture. The last copies have all routes. Returns the law of least value if none is within
    the slack; None after the deadline, or if the bound is 0: one chain on the edges that no site
    hits needs no labels.
    """
    order, count = np.argsort(-program.shares, kind='stable'), FEWEST
    game, slack, deadline = search.game, search.slack, search.problem.deadline
    best: Incumbent | None = None
    while program.bound > 0.0 and time.monotonic() < deadline:
        few, every = program.mixtures.among(order[:count]), count >= len(order)
        count *= 2
        try:
            shares = few.solve(TIGHT, deadline).shares
        except SolverFailed:  # these routes exceed a budget
            continue
        except TimeLimit:
            break
        value = few.value(shares)
        if within(value, program.value, FEW_LOSE * slack) or every:
            ground = conserved_strategy(game, few.flow(shares, len(game.playable)), MIN_FLOW)
            assert ground is not None  # a route has a share of at least one in their number
            copies = Copies(game, ground, few.routes, shares, max(2 * WIDTH // count, 1))
            law = Law(copies.network, copies.p, search.problem.budgets, few.ambushers, slack,
                      False, deadline)
            law.add_sites(program.entering, program.loss)
            limit = max(ceiling(program.bound, slack), ceiling(value, slack / 2.0))
            level = few.level(shares, program.gap) * (limit / ceiling(value, slack))
            before = 0.0
            for _ in range(ROUNDS):
                law.measure(level)
                best = search.better(best, law, copies)
                grew, before = law.entropy > before * (1.0 + GROWTH), law.entropy
                if search.problem.late or (
                        law.rounds and law.good and not grew) or not law.round():
                    break
            search.evaluations += law.evaluations
            if every or best and best.value <= limit:
                break
    return best
