"""The default strategy: least risk within the budgets, then the most unpredictable routes.

1. Find the least value z: by a cut without a reach; with one, by the cheapest chain of discs, or by
   a program in potentials of the faces if a budget binds (``least_on_faces``); on trips without a
   reach, leg by leg (``separate_legs``); by a linear program otherwise (``least_risk``).
2. Accept values up to (1 + slack) z.
3. Find the strategy of greatest route entropy (a Gibbs law) on an acyclic part of the network that
   contains an optimal strategy (``entropy_stage``). If it still exceeds a limit when the search
   ends, mix in the optimal strategy of stage 1.
4. Where a site can hit a route more than once, count that once (``hit_once``).
"""

from __future__ import annotations

import time
from dataclasses import replace

from ..errors import SolverFailed, TimeLimit
from .entries import best_prices, entry_value
from .entropy_stage import EntropyStage, Solution
from .hit_once import count_routes_once
from .hits import worst_loss
from .least_on_faces import along_chain, along_level_lines
from .least_risk import least_risk, least_risk_by_cut, without_forbidden_edges
from .separate_legs import along_separate_legs
from .soft_search import SoftSearch

# Relative gap of the linear program, as a share of the slack.
PROGRAM_GAP = 0.02
# Relative gap at which the soft search before the programs ends.
FIRST_GAP = 0.06
# A strategy from the faces is good enough if its relative gap is at most this many times the slack.
NEAR = 2.0


def max_entropy_strategy(stage: EntropyStage) -> Solution:
    """Solve all stages; at the deadline, return the best strategy so far.

    Raises BudgetInfeasible if no strategy fits all budgets, and TimeLimit if the deadline passed
    before the first strategy.
    """
    game, budgets = stage.game, stage.budgets
    free = without_forbidden_edges(game, budgets)
    if free is not game:
        inner = EntropyStage(free, budgets, stage.slack, stage.deadline, stage.warm)
        inside = max_entropy_strategy(inner)
        # Without a price, routes over the forbidden edges would lower the bound to next to nothing.
        value = entry_value(game, inside.p)
        prices, _ = best_prices(game, inside.q, budgets, inside.prices, value)
        return replace(inside, prices=prices)
    soft = SoftSearch(stage)
    if loose := least_risk_by_cut(game, budgets):
        if found := stage.most_unpredictable(loose):
            return count_routes_once(stage, found)
    elif found := along_chain(stage):
        return found
    best = soft.strategy(loose, FIRST_GAP) if stage.in_a_hurry else None
    if best and time.monotonic() > stage.deadline:
        return stage.best_of(best)
    if not loose and (found := along_level_lines(stage)):
        best = stage.best_of(count_routes_once(stage, found), best)
        near = stage.best_proof()[2] * (1.0 + NEAR * stage.slack)
        if worst_loss(game, best.p) <= near or time.monotonic() > stage.deadline:
            return best
    in_time = True
    try:
        found = along_separate_legs(stage) or _by_linear_program(stage)
    except (TimeLimit, SolverFailed) as failure:
        in_time = not isinstance(failure, TimeLimit)
        found = soft.strategy(loose, stage.slack) or best
        if found is None:
            raise TimeLimit('no strategy within the budgets was found in time') from failure
    if best is None or worst_loss(game, found.p) < worst_loss(game, best.p):
        found = count_routes_once(stage, found)
    return replace(stage.best_of(found, best), complete=in_time)


def _by_linear_program(stage: EntropyStage) -> Solution:
    game, budgets = stage.game, stage.budgets
    risk = least_risk(game, budgets, stage.potential, PROGRAM_GAP * stage.slack,
                      stage.program_deadline(), stage.level_lines)
    found = stage.most_unpredictable(risk)
    return found or Solution(risk.p, risk.q, risk.prices, stage.evaluations)
