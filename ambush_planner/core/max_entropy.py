"""The default strategy: least risk within the budgets, then the most unpredictable routes.

1. The least value z: by a cut where that is exact, otherwise by a linear program.
2. Values up to (1 + slack) z are accepted.
3. Of these, on an acyclic part of the network that holds an optimal strategy, the one of greatest
   route entropy: a Gibbs law. What is left over its limits when the search ends is taken off by
   mixing in the optimal strategy of stage 1.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix, diags, vstack

from .acyclic import forward_part, order_potential, rank_around, rank_by
from .arrays import FloatArray, IndexArray, sums
from .certificate import ROUNDING, Budget, lower_bound, upper_bound
from .cut import GameValue, indifferent_ambusher, solve_by_cut
from .errors import SolverFailed, TimeLimit
from .game import Game
from .gibbs import AcyclicNetwork
from .least_risk import at_most_one, least_risk, near_budgets
from .most_entropy import SMALL_START, GibbsStrategy, most_entropy
from .routes import always_shortest

# The least slack: values this near to the bound, relative, count as optimal.
LEAST_SLACK = 9e-6
# The law aims at these shares of its limits, so that it may end a little over its aim.
AIM, BUDGET_AIM, ROUGHNESS = 0.95, 0.999, 0.04
# A program's strategy keeps its budgets within this, relative, and a mixture as well as that one;
# its share is found in so many halvings.
FITS, HALVINGS = 5e-7, 30
# Sites where an ambush costs this many times the value are driven past only if nothing else is
# left: a strategy may use them so little that rounding alone would break the limit.
BARRED = 1e7
# The program's value and bound may be apart by this share of the slack.
CLOSED = 0.02
# Hits below this are rounding; with several ambushers the level of a site may be 0.
LEAST_HITS = 1e-9
# Share of the time left that the program may take; the rest is for the law.
PROGRAM_SHARE = 0.6
# Without a program: rounds, evaluations a round, and how the softness falls from round to round.
SOFT_ROUNDS, SOFT_EVALUATIONS, SOFTER = 8, 80, 0.25
# There the limits are at this share of the shortest route's value, unless more is known.
REFERENCE, FIRST_ENTROPY = 0.01, 30.0
# Largest first multiplier of a site or budget.
FIRST_PRICE = 300.0


@dataclass(frozen=True, eq=False)
class Law:
    """Multipliers of the Gibbs law: per hit of each site (N,), per unit of each budget's cost."""

    sites: FloatArray
    budgets: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a solver hands on: p (M,), q (N,), the budgets' prices [loss / unit], effort, law."""

    p: FloatArray
    q: FloatArray
    prices: tuple[float, ...]
    iterations: int
    law: Law | None = None


def max_entropy_strategy(
    game: Game, budgets: tuple[Budget, ...], risk_slack: float, deadline: float,
    warm: Law | None = None,
) -> Outcome:
    """Solve the three stages; at the deadline, return the best strategy so far.

    Raises
    ------
    BudgetInfeasible
        No strategy fits all budgets.
    TimeLimit
        The deadline passed before the first strategy.
    """
    search = _Search(game, budgets, max(risk_slack, LEAST_SLACK), deadline, warm)
    return search.past_all_sites() or search.by_cut() or search.by_program()


def least_value(
    game: Game, budgets: tuple[Budget, ...], closed: float, deadline: float
) -> float:
    """The least value within the budgets alone, from below and no further off than ``closed``.

    At the deadline it is the value without budgets, and 0 where no cut tells that.

    Raises
    ------
    BudgetInfeasible
        No strategy fits all budgets.
    """
    return _Search(game, budgets, closed, deadline, None).value_alone()


class _Search:
    """The stages for one game."""

    def __init__(
        self, game: Game, budgets: tuple[Budget, ...], slack: float, deadline: float,
        warm: Law | None,
    ) -> None:
        self.game, self.budgets, self.slack = game, budgets, slack
        self.deadline, self.warm = deadline, warm
        self.evaluations = 0
        self.least = 0.0

    @cached_property
    def potential(self) -> FloatArray:
        """What decides the order of nodes that nothing else decides, (N,)."""
        return order_potential(self.game)

    def value_alone(self) -> float:
        """The least value: of a cut whose flow fits the budgets, else of the program."""
        safe = self.game.past_all_sites()
        if safe is not None and self._fits(always_shortest(safe)):
            return 0.0
        exact = self._cut()
        if exact is not None and self._fits(exact.p):
            least = self.game.ambushers * exact.value
            if upper_bound(self.game, exact.p) <= least * (1.0 + self.slack):
                return least
        try:
            risk = least_risk(
                self.game, self._first_part(), self.budgets, self.slack, self.deadline
            )
        except (TimeLimit, SolverFailed):
            return self.least
        return risk.bound

    def past_all_sites(self) -> Outcome | None:
        """Value 0: routes past every ambush, where they fit the budgets."""
        safe = self.game.past_all_sites()
        if safe is None:
            return None
        rank, shortest = rank_by(self.potential), always_shortest(safe)
        part = forward_part(safe, rank)
        if part is None:
            rank = rank_around(safe, shortest, self.potential)
            part = forward_part(safe, rank)
        assert part is not None  # it holds a shortest route
        found = self._law(part, rank, np.zeros(len(self.game.sites)))
        return self._within(replace(found, q=indifferent_ambusher(self.game)), shortest, 0.0)

    def by_cut(self) -> Outcome | None:
        """The plain game where the budgets leave the least value as it is.

        With several legs the cut is that of the costliest leg, a lower bound; it is attained where
        the other legs need not pass that leg's sites.
        """
        exact = self._cut()
        if exact is None:
            return None
        k = self.game.ambushers
        lean = self._lean(exact.value)
        flow = exact if lean is self.game else solve_by_cut(replace(lean, ambushers=1))
        if flow.value > exact.value * (1.0 + self.slack / 4.0):
            return None
        rank = rank_around(lean, flow.p, self.potential)
        part = forward_part(lean, rank)
        assert part is not None  # it holds the flow
        level = np.full(len(self.game.sites), exact.value)
        found = replace(self._law(part, rank, level), q=k * exact.q)
        return self._within(found, flow.p, k * exact.value)

    def _cut(self) -> GameValue | None:
        """The plain game with one ambusher; None where it is another one, or its value is 0.

        With k of them it is the same game k times over, if none of k q is over 1. q is that of
        the places.
        """
        if self.game.ambush_radius > 0.0:
            return None
        exact = solve_by_cut(replace(self.game, ambushers=1))
        self.least = exact.value
        q = sums(self.game.network.places, exact.q, self.game.node_count)
        if exact.value == 0.0 or self.game.ambushers * q.max() > 1.0:
            return None
        return replace(exact, q=q)

    def by_program(self) -> Outcome:
        """Budgets that raise the value, a reach, several ambushers: a linear program first."""
        try:
            closed = CLOSED * self.slack
            first, now = self._first_part(), time.monotonic()
            until = now + PROGRAM_SHARE * max(self.deadline - now, 0.0)
            risk = least_risk(self.game, first, self.budgets, closed, until)
        except (TimeLimit, SolverFailed):
            return self._anytime(forward_part(self.game, rank_by(self.potential)) or self.game)
        rank = rank_around(self.game, risk.p, self.potential)
        part = forward_part(self._lean(risk.bound, risk.p), rank)
        assert part is not None  # it holds the program's strategy
        found = self._law(part, rank, risk.level)
        found = replace(found, q=risk.q, prices=risk.prices)
        return self._within(found, risk.p, risk.bound) or replace(found, p=risk.p)

    def _first_part(self) -> Game:
        """Edges that the program begins with: forward in an order around a maximum flow.

        The flow is the plain game's on edges that some route not too far over the budgets uses.
        """
        near = self.game.restricted_to(near_budgets(self.game, self.budgets)) or self.game
        rank = rank_by(self.potential)
        if self.game.ambush_radius == 0.0:
            rank = rank_around(near, solve_by_cut(replace(near, ambushers=1)).p, self.potential)
        return forward_part(near, rank) or near

    def _lean(self, value: float, p: FloatArray | None = None) -> Game:
        """The game without the sites far too costly ever to pass, if a route is left (with p's)."""
        barred = self.game.loss[self.game.sites] > BARRED * value
        if not barred.any():
            return self.game
        open_edges = np.asarray(self.game.hits[barred].getnnz(axis=0) == 0)
        if p is not None:
            open_edges |= p > 0.0
        return self.game.restricted_to(open_edges) or self.game

    def _law(
        self, part: Game, rank: IndexArray, level: FloatArray
    ) -> Outcome:
        """Stage 3 on an acyclic part: mean losses up to (1 + slack) level (S,)."""
        network = AcyclicNetwork(part, rank)
        limits = _Limits(self.game, network, level * (1.0 + AIM * self.slack), self.budgets)
        roughness = min(ROUGHNESS * self.slack, 1.0 - BUDGET_AIM)
        found = most_entropy(
            network, limits.rows, limits.start(self.warm), roughness, self.deadline
        )
        return self._outcome(network, limits, found)

    def _outcome(
        self, network: AcyclicNetwork, limits: _Limits, found: GibbsStrategy
    ) -> Outcome:
        self.evaluations += found.evaluations
        p = np.zeros(len(self.game.network.edges))
        p[network.edge] = found.p
        q = np.zeros(self.game.node_count)
        law = None if found.infeasible else limits.law(found.multipliers)
        return Outcome(p, q, (0.0,) * len(self.budgets), self.evaluations, law)

    def _within(self, found: Outcome, partner: FloatArray, bound: float) -> Outcome | None:
        """Mix in just so much of ``partner`` that value and budgets hold; None if none does."""
        limit = bound * (1.0 + self.slack)
        most = [b.limit * (1.0 + ROUNDING) for b in self.budgets]
        if self._fits(partner):
            most = [max(m, b.mean(partner)) for m, b in zip(most, self.budgets, strict=True)]
        priced = [(c, b) for c, b in zip(found.prices, self.budgets, strict=True) if c > 0.0]

        def holds(p: FloatArray) -> bool:
            kept = all(b.mean(p) <= m for m, b in zip(most, self.budgets, strict=True))
            over = sum(price * budget.overrun(p) for price, budget in priced)
            return kept and upper_bound(self.game, p) + over <= limit

        if found.law is not None and holds(found.p):
            return found
        if not holds(partner):
            return None
        low, high = 0.0, 1.0
        for _ in range(HALVINGS):
            share = (low + high) / 2.0
            if holds((1.0 - share) * found.p + share * partner):
                high = share
            else:
                low = share
        return replace(found, p=(1.0 - high) * found.p + high * partner)

    def _fits(self, p: FloatArray) -> bool:
        return all(b.mean(p) <= b.limit * (1.0 + FITS) for b in self.budgets)

    def _anytime(self, part: Game) -> Outcome:
        """Where no program could be solved: soft limits, ever harder, and the best of each side.

        The multipliers, scaled to an ambusher's strategy, give a bound at every step.
        """
        p = always_shortest(part)
        if not self._fits(p):
            raise TimeLimit("time is up before a strategy within the budgets was found")
        best = Outcome(p, indifferent_ambusher(self.game), (0.0,) * len(self.budgets), 0)
        value, bound = upper_bound(self.game, p), 0.0
        network = AcyclicNetwork(part, rank_by(self.potential))
        reference = max(self.least, REFERENCE * value)
        level = np.full(len(self.game.sites), reference)
        limits = _Limits(self.game, network, level, self.budgets)
        start, softness = limits.start(self.warm), value / reference / FIRST_ENTROPY
        for _ in range(SOFT_ROUNDS):
            found = most_entropy(
                network, limits.rows, start, 0.0, self.deadline, softness, SOFT_EVALUATIONS
            )
            start, softness = found.multipliers, softness * SOFTER
            tried = self._outcome(network, limits, found)
            inside = self._shortened(tried.p, p)
            if upper_bound(self.game, inside) < value:
                value = upper_bound(self.game, inside)
                best = replace(best, p=inside, law=tried.law, iterations=tried.iterations)
            q, prices = limits.ambusher(found.multipliers)
            reached = lower_bound(self.game, q, self.budgets, prices)
            if reached > bound:
                bound = reached
                best = replace(best, q=q, prices=prices)
            if time.monotonic() > self.deadline:
                break
        return best

    def _shortened(self, p: FloatArray, shortest: FloatArray) -> FloatArray:
        """Mix in just so much of the shortest route that the budgets hold."""
        share = 0.0
        for budget in self.budgets:
            over = budget.mean(p) - budget.limit
            if over > 0.0:
                share = max(share, over / (budget.mean(p) - budget.mean(shortest)))
        return (1.0 - share) * p + share * shortest


class _Limits:
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
        self._room = np.array([BUDGET_AIM * b.room for b in self._binding])
        over = [csr_matrix(b.excess[network.edge]) for b in self._binding]
        scale = np.concatenate((self._most, self._room))
        self.rows = csr_matrix(diags(1.0 / scale) @ vstack([hits[self._row], *over]))
        edge = network.edge
        mean = np.array([float(b.cost[edge].mean()) for b in self._binding])
        self._first = np.minimum(self._room / np.maximum(mean, 1e-300), FIRST_PRICE)

    def start(self, warm: Law | None) -> FloatArray:
        """Multipliers (R,) to start from: those of another law, or small ones."""
        if warm is None or len(warm.sites) != self._game.node_count:
            return np.concatenate((np.full(len(self._row), SMALL_START), self._first))
        sites = warm.sites[self._game.sites[self._row]] * self._most
        pairs = zip(warm.budgets, self._budgets, strict=True)
        budgets = np.array([price for price, b in pairs if b.binds]) * self._room
        return np.minimum(np.concatenate((sites, budgets)), FIRST_PRICE)

    def law(self, multipliers: FloatArray) -> Law:
        """The multipliers (R,) per hit and per unit of cost."""
        sites = np.zeros(self._game.node_count)
        count = len(self._row)
        sites[self._game.sites[self._row]] = multipliers[:count] / self._most
        price = iter(multipliers[count:] / self._room)
        return Law(sites, tuple(float(next(price)) if b.binds else 0.0 for b in self._budgets))

    def ambusher(self, multipliers: FloatArray) -> tuple[FloatArray, tuple[float, ...]]:
        """The ambusher's strategy and prices that the multipliers stand for."""
        law, game = self.law(multipliers), self._game
        q = np.zeros(game.node_count)
        q[game.sites] = law.sites[game.sites] / game.loss[game.sites]
        total = float(q.sum()) / game.ambushers
        if not total > 0.0:
            return indifferent_ambusher(game), (0.0,) * len(law.budgets)
        return at_most_one(q / total, game.ambushers), tuple(b / total for b in law.budgets)


def _most_hits(game: Game) -> float:
    """Hits of one site by one route: once a leg at its node; a leg may come back to a disc."""
    return (1.0 if game.ambush_radius == 0.0 else 3.0) * game.network.legs
