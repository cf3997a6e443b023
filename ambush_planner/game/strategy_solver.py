"""The default strategy: least risk within the budgets, then the most unpredictable routes.

1. The least value z: by a cut where that is exact, otherwise by a linear program (``least_risk``).
2. Values up to (1 + slack) z are accepted.
3. Of these, on an acyclic part of the network that holds an optimal strategy, the one of greatest
   route entropy: a Gibbs law. What is left over its limits when the search ends is taken off by
   mixing in the optimal strategy of stage 1.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix, diags, vstack

from ..arrays import FloatArray
from ..errors import SolverFailed, TimeLimit
from .acyclic import forward_part, order_potential, rank_around
from .certificate import BUDGET_TOLERANCE, ROUNDING, Budget, lower_bound, upper_bound
from .cut import uniform_ambusher
from .entropy_search import MAX_EVALUATIONS, GibbsStrategy, maximize_entropy
from .flow_program import capped_at_one
from .game import Game
from .gibbs import AcyclicNetwork
from .least_risk import (
    LeastRisk,
    initial_part,
    least_risk,
    least_risk_by_cut,
    without_excessive_sites,
)
from .route_sampler import shortest_route_strategy

# The least slack: values this near to the bound, relative, count as optimal.
LEAST_SLACK = 9e-6
# The law aims at these shares of its limits, so that it may end a little over its aim.
LEVEL_AIM, BUDGET_AIM, LIMIT_TOLERANCE = 0.95, 0.999, 0.04
# The share of a mixture is found in so many halvings.
BISECTIONS = 30
# The program's value and bound may be apart by this share of the slack.
PROGRAM_GAP = 0.02
# Hits below this are rounding; with several ambushers the level of a site may be 0.
LEAST_HITS = 1e-9
# Share of the time left that the program may take; the rest is for the law.
PROGRAM_SHARE = 0.6
# Without a program: rounds, evaluations a round, and how the softness falls from round to round.
SOFT_ROUNDS, SOFT_EVALUATIONS, SOFTNESS_FACTOR = 8, 80, 0.25
# There the limits are at this share of the shortest route's value, unless more is known.
REFERENCE_SHARE, FIRST_ENTROPY = 0.05, 30.0
# Largest first multiplier of a site or budget.
MAX_FIRST_MULTIPLIER = 300.0


@dataclass(frozen=True, eq=False)
class Multipliers:
    """Multipliers of the Gibbs law: per hit of each site (N,), per unit of each budget's cost."""

    sites: FloatArray
    budgets: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Solution:
    """What a solver hands on: p (M,), q (N,), the budgets' prices [loss / unit], effort, law."""

    p: FloatArray
    q: FloatArray
    prices: tuple[float, ...]
    iterations: int
    multipliers: Multipliers | None = None


def max_entropy_strategy(
    game: Game, budgets: tuple[Budget, ...], risk_slack: float, deadline: float,
    warm: Multipliers | None = None,
) -> Solution:
    """Solve the three stages; at the deadline, return the best strategy so far.

    Raises
    ------
    BudgetInfeasible
        No strategy fits all budgets.
    TimeLimit
        The deadline passed before the first strategy.
    """
    slack = max(risk_slack, LEAST_SLACK)
    search, least = _EntropyStage(game, budgets, slack, deadline, warm), 0.0
    if loose := least_risk_by_cut(game):
        if found := search.most_unpredictable(loose):
            return found
        least = loose.bound / game.ambushers
    now = time.monotonic()
    until = now + PROGRAM_SHARE * max(deadline - now, 0.0)
    try:
        part = initial_part(game, budgets, search.potential)
        risk = least_risk(game, part, budgets, PROGRAM_GAP * slack, until)
    except (TimeLimit, SolverFailed):
        return search.without_linear_program(least)
    return search.most_unpredictable(risk) or Solution(risk.p, risk.q, risk.prices, search.evaluations)


class _EntropyStage:
    """Stages 2 and 3 for one game."""

    def __init__(
        self, game: Game, budgets: tuple[Budget, ...], slack: float, deadline: float,
        warm: Multipliers | None,
    ) -> None:
        self.game, self.budgets, self.slack = game, budgets, slack
        self.deadline, self.warm = deadline, warm
        # What decides the order of nodes that nothing else decides.
        self.potential = order_potential(game)
        self.evaluations = 0

    def most_unpredictable(self, least: LeastRisk) -> Solution | None:
        """The most entropy at the least risk; None if value or budgets cannot be kept so."""
        network = self._around(without_excessive_sites(self.game, least.bound, least.p), least.p)
        limits = _LimitRows(
            self.game, network, least.level * (1.0 + LEVEL_AIM * self.slack), self.budgets
        )
        tolerance = min(LIMIT_TOLERANCE * self.slack, 1.0 - BUDGET_AIM)
        p, found = self._gibbs_strategy(network, limits, limits.start(self.warm), tolerance)
        law = None if found.infeasible else limits.unscaled(found.multipliers)
        return self._mixed_to_fit(Solution(p, least.q, least.prices, self.evaluations, law), least)

    def _around(self, game: Game, p: FloatArray) -> AcyclicNetwork:
        """The edges that go forward in an order of the nodes in which those of p (M,) do."""
        rank = rank_around(game, p, self.potential)
        part = forward_part(game, rank)
        assert part is not None  # it holds p
        return AcyclicNetwork(part, rank)

    def _gibbs_strategy(
        self, network: AcyclicNetwork, limits: _LimitRows, start: FloatArray, tolerance: float,
        softness: float = 0.0, evaluations: int = MAX_EVALUATIONS,
    ) -> tuple[FloatArray, GibbsStrategy]:
        """The law's p (M,), and how ``maximize_entropy`` ended the search for it."""
        found = maximize_entropy(
            network, limits.rows, start, tolerance, self.deadline, softness, evaluations
        )
        self.evaluations += found.evaluations
        p = np.zeros(len(self.game.network.edges))
        p[network.edge] = found.p
        return p, found

    def _mixed_to_fit(self, found: Solution, least: LeastRisk) -> Solution | None:
        """Mix in so much of the least risk's p that value and budgets hold; None if nothing does.

        Where rounding puts p itself over a budget, the mixture may be over it by as much.
        """
        limit = least.bound * (1.0 + self.slack)
        most = [
            np.clip(b.mean(least.p), b.limit * (1.0 + ROUNDING), b.limit * (1.0 + BUDGET_TOLERANCE))
            for b in self.budgets
        ]
        priced = [(c, b) for c, b in zip(found.prices, self.budgets, strict=True) if c > 0.0]

        def holds(p: FloatArray) -> bool:
            kept = all(b.mean(p) <= m for m, b in zip(most, self.budgets, strict=True))
            over = sum(price * budget.overrun(p) for price, budget in priced)
            return kept and upper_bound(self.game, p) + over <= limit

        p = _mixture(found.p, least.p, holds)
        return None if p is None else replace(found, p=p)

    def without_linear_program(self, least: float) -> Solution:
        """Where no program could be solved: soft limits, ever harder, and the best of each side.

        ``least`` is what the worst site is known to cost at least. The multipliers, scaled to an
        ambusher's strategy, give a bound at every step.
        """
        shortest = shortest_route_strategy(self.game)
        if not self._within_budgets(shortest):
            raise TimeLimit('time is up before a strategy within the budgets was found')
        best = Solution(
            shortest, uniform_ambusher(self.game), (0.0,) * len(self.budgets), 0
        )
        value, bound = upper_bound(self.game, shortest), 0.0
        network, reference = self._around(self.game, shortest), max(least, REFERENCE_SHARE * value)
        level = np.full(len(self.game.sites), reference)
        limits = _LimitRows(self.game, network, level, self.budgets)
        start, softness = limits.start(self.warm), value / reference / FIRST_ENTROPY
        for _ in range(SOFT_ROUNDS):
            p, found = self._gibbs_strategy(network, limits, start, 0.0, softness, SOFT_EVALUATIONS)
            start, softness = found.multipliers, softness * SOFTNESS_FACTOR
            short = _mixture(p, shortest, self._within_budgets)
            if short is not None and upper_bound(self.game, short) < value:
                value = upper_bound(self.game, short)
                best = replace(
                    best, p=short, multipliers=limits.unscaled(start), iterations=self.evaluations
                )
            q, prices = limits.ambusher(start)
            reached = lower_bound(self.game, q, self.budgets, prices)
            if reached > bound:
                bound = reached
                best = replace(best, q=q, prices=prices)
            if time.monotonic() > self.deadline:
                break
        return best

    def _within_budgets(self, p: FloatArray) -> bool:
        """Whether p (M,) is within all budgets."""
        return all(budget.keeps(p) for budget in self.budgets)


def _mixture(
    p: FloatArray, partner: FloatArray, holds: Callable[[FloatArray], bool]
) -> FloatArray | None:
    """p (M,) with just so much of its partner that it ``holds``; None if neither does."""
    if holds(p):
        return p
    if not holds(partner):
        return None
    low, high = 0.0, 1.0
    for _ in range(BISECTIONS):
        share = (low + high) / 2.0
        if holds((1.0 - share) * p + share * partner):
            high = share
        else:
            low = share
    return (1.0 - high) * p + high * partner


class _LimitRows:
    """The limits of stage 3 as rows C p <= 1: sites that can be over theirs, then the budgets."""

    def __init__(
        self, game: Game, network: AcyclicNetwork, level: FloatArray, budgets: tuple[Budget, ...]
    ) -> None:
        self._game, self._budgets = game, budgets
        hits = game.hits[:, network.edge]
        most = np.maximum(level / game.loss[game.sites], LEAST_HITS)
        self._row = np.flatnonzero((hits.getnnz(axis=1) > 0) & (most < _most_hits(game)))
        self._most = most[self._row]
        self._binding = [b for b in budgets if b.binds]
        self._margin = np.array([BUDGET_AIM * b.margin for b in self._binding])
        over = [csr_matrix(b.excess[network.edge]) for b in self._binding]
        scale = np.concatenate((self._most, self._margin))
        self.rows = csr_matrix(diags(1.0 / scale) @ vstack([hits[self._row], *over]))
        edge = network.edge
        mean = np.array([float(b.cost[edge].mean()) for b in self._binding])
        self._first = np.minimum(self._margin / np.maximum(mean, 1e-300), MAX_FIRST_MULTIPLIER)

    def start(self, warm: Multipliers | None) -> FloatArray:
        """Multipliers (R,) to start from: those of another law, or 0 for sites."""
        if warm is None or len(warm.sites) != self._game.node_count:
            return np.concatenate((np.zeros(len(self._row)), self._first))
        sites = warm.sites[self._game.sites[self._row]] * self._most
        pairs = zip(warm.budgets, self._budgets, strict=True)
        budgets = np.array([price for price, b in pairs if b.binds]) * self._margin
        return np.minimum(np.concatenate((sites, budgets)), MAX_FIRST_MULTIPLIER)

    def unscaled(self, multipliers: FloatArray) -> Multipliers:
        """The multipliers (R,) per hit and per unit of cost."""
        sites = np.zeros(self._game.node_count)
        count = len(self._row)
        sites[self._game.sites[self._row]] = multipliers[:count] / self._most
        price = iter(multipliers[count:] / self._margin)
        budgets = (float(next(price)) if b.binds else 0.0 for b in self._budgets)
        return Multipliers(sites, tuple(budgets))

    def ambusher(self, multipliers: FloatArray) -> tuple[FloatArray, tuple[float, ...]]:
        """The ambusher's strategy and prices that the multipliers stand for."""
        law, game = self.unscaled(multipliers), self._game
        q = np.zeros(game.node_count)
        q[game.sites] = law.sites[game.sites] / game.loss[game.sites]
        total = float(q.sum()) / game.ambushers
        if not total > 0.0:
            return uniform_ambusher(game), (0.0,) * len(law.budgets)
        return capped_at_one(q / total, game.ambushers), tuple(b / total for b in law.budgets)


def _most_hits(game: Game) -> float:
    """Hits of one site by one route: once a leg at its node; a leg may come back to a disc."""
    return (1.0 if game.ambush_radius == 0.0 else 3.0) * game.network.legs
