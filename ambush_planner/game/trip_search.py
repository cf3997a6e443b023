# SPDX-License-Identifier: Apache-2.0
"""The search on a trip: a mixture of routes and its proof, then a law on labelled copies."""

from __future__ import annotations

import math
import time

from .copies import law_on_copies
from .search import Incumbent, Search
from .slack import ceiling, within
from .value.routes import APART, Routes

# Shares of the time limit after which the program ends, as its law takes seconds; its first proof,
# if places join later; and its last one, if they joined until then.
SOLVED, FIRST_PROOF, LAST_PROOF = 0.8, 0.1, 0.9
# Places join that cost more than the mixture by JOINING slacks. A mixture that is better by less
# than SMALL slacks is no better.
JOINING, SMALL = 0.5, 0.25
# Rounds in which places join the program, and those of the law.
MAX_SWEEPS, ROUNDS = 20, 25


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
    for _ in range(MAX_SWEEPS):
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

    It is found in rounds around the program's mixture. Places that cost it too much join it; new
    copies are made if it then has no strategy, or if the program finds a better mixture.
    """
    problem, law = search.problem, None
    best: Incumbent | None = None
    least = math.inf
    for _ in range(ROUNDS):
        if law is None or not law.run(problem.deadline):
            law = law_on_copies(program, search.slack, problem.deadline)
        if law is None or best and problem.late:
            break
        search.evaluations = law.evaluations
        chain, value, worst, mixed = law.chain, law.value, law.worst, program.value
        joined = search.join_worst(chain, law.limit, APART)
        most = value if joined is None else max(value, float(joined.mean_loss.max()))
        keeps = problem.keeps_budgets(chain.uses(len(search.game.playable)))
        if keeps and most < least:
            best, least = Incumbent(chain, value, worst, copies=law), most
        if joined:
            law.add_sites(joined.entering, joined.alpha)
        if problem.late or not joined and keeps and within(value, program.bound, search.slack):
            break
        with search.keep_incumbent():
            program.solve(prove=not joined)
        if not joined:
            if within(mixed, program.value, SMALL * search.slack):
                break
            law = None
    return best
