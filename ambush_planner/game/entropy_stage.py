"""Stages 2 and 3 for one game: the most unpredictable strategy within a value and the budgets.

A law of routes is searched for on an acyclic part of the network, at a level of loss for each site.
``strategy_solver`` and the ways that it tries find the level; they share the deadlines, the laws
found so far and the cheapest chain of discs through an ``EntropyStage``.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ..arrays import FloatArray
from .acyclic import forward_part, order_potential, rank_around
from .budget import BUDGET_TOLERANCE, ROUNDING, Budget
from .certificate import hit_bound
from .disc_chain import chain_ambusher
from .entries import entry_value
from .entropy_search import GibbsStrategy, maximize_entropy
from .faces import Faces, make_faces
from .flow_program import capped_at_places
from .game import Game
from .gibbs import AcyclicNetwork, acyclic_network
from .hits import worst_loss
from .least_risk import LeastRisk, without_excessive_sites
from .limit_rows import KEPT_MARGIN, LimitRows, Multipliers
from .route_sampler import route_entropy

# Smallest risk slack of the search, relative to the value.
LEAST_SLACK = 9e-6
# Share of the slack that the search aims at, and its tolerance as a share of the slack.
LEVEL_AIM, LIMIT_TOLERANCE = 0.95, 0.04
# What the search keeps below a budget costs at most this share of the slack, by the budget's price.
KEPT_SLACK = 0.02
# Bisection steps for the share of a mixture.
BISECTIONS = 15
# Share of the remaining time for a linear program; the rest is for the entropy search.
PROGRAM_SHARE = 0.6
# A program may take this many times as long as everything before it.
HURRY = 10.0
# Time of the first law, or of the soft search, after the deadline, as a share of all time before.
FIRST_SHARE = 0.5


@dataclass(frozen=True, eq=False)
class Solution:
    """A solver's p (M,), q (N,), prices of the budgets [loss / unit], effort and multipliers.

    ``entropy_bound`` is the most entropy [nats] that a strategy on the same acyclic part can have;
    ``complete`` is False if a program ran out of time.
    """

    p: FloatArray
    q: FloatArray
    prices: tuple[float, ...]
    iterations: int
    multipliers: Multipliers | None = None
    entropy_bound: float = np.nan
    complete: bool = True


class Chain(NamedTuple):
    """A lower bound, its q (N,), and the mean loss (S,) that each site causes at this value."""

    bound: float
    q: FloatArray
    level: FloatArray


class EntropyStage:
    """Stages 2 and 3 for one game, and what all ways to the least risk need."""

    def __init__(self, game: Game, budgets: tuple[Budget, ...], risk_slack: float, deadline: float,
                 warm: Multipliers | None) -> None:
        self.game, self.budgets = game, budgets
        self.slack = max(risk_slack, LEAST_SLACK)
        self.begin, self.deadline, self.warm = time.monotonic(), deadline, warm
        self.potential = order_potential(game)
        self.law_deadline = deadline
        self.evaluations = 0
        # Searched so far, whether or not they keep the limits.
        self.laws: list[Solution] = []
        # The ambushers that hit_bound judged, and the bounds.
        self._judged: list[tuple[FloatArray, tuple[float, ...], float]] = []
        # A flow (M,) of little loss that one law of its edges may not attain: ``least_on_faces``.
        self.level_lines: FloatArray | None = None

    def program_deadline(self) -> float:
        """When a linear program has to end, so that time is left for the entropy search."""
        now = time.monotonic()
        return now + PROGRAM_SHARE * max(self.deadline - now, 0.0)

    @property
    def in_a_hurry(self) -> bool:
        """Whether a program may not end before the deadline."""
        now = time.monotonic()
        return self.deadline - now < HURRY * (now - self.begin)

    def extend_law_deadline(self) -> None:
        """Let what was prepared for the laws be used, even if the deadline passed meanwhile."""
        now = time.monotonic()
        self.law_deadline = max(self.deadline, now + FIRST_SHARE * (now - self.begin))

    def most_unpredictable(self, least: LeastRisk) -> Solution | None:
        """The strategy of greatest entropy at the least risk; None if it cannot keep the limits."""
        game = without_excessive_sites(self.game, least.bound, least.p)
        network = self.acyclic_part(game, least.p)
        kept = self.kept_margins(least.bound, least.prices), (0.0,) * len(self.budgets)
        solution = self.law(network, least.level, kept, least.q, least.prices)
        return self._mixed_to_fit(solution, least)

    @cached_property
    def faces(self) -> list[Faces]:
        """The faces of a planar network, leg by leg, if there is a reach."""
        found: list[Faces] = []
        for leg in self.game.legs() if self.game.reach > 0.0 else ():
            faces = make_faces(leg)
            if faces is None:
                return []
            found.append(faces)
        return found

    @cached_property
    def chain(self) -> Chain | None:
        """The cheapest chain of discs, if there is one; on a trip, of the costliest leg."""
        hit = [faces for faces in self.faces if faces.touched.nnz]
        found = chain_ambusher(hit) if hit else None
        if found is None:
            return None
        q = np.zeros(self.game.node_count)
        q[self.game.sites] = found.q
        q = capped_at_places(self.game, q)
        bound = self.hit_bound(q, (0.0,) * len(self.budgets))
        return Chain(bound, q, found.level * (bound / found.value))

    def hit_bound(self, q: FloatArray, prices: tuple[float, ...]) -> float:
        """The certificate's bound by an ambusher's strategy q (N,); it is remembered."""
        for judged, at, bound in self._judged:
            if judged is q and at == prices:
                return bound
        self._judged.append((q, prices, hit_bound(self.game, q, self.budgets, prices)))
        return self._judged[-1][2]

    def best_proof(self, *found: Solution) -> tuple[FloatArray, tuple[float, ...], float]:
        """The q (N,) and prices of the greatest bound so far, with those found, and the bound."""
        for each in found:
            self.hit_bound(each.q, each.prices)
        return max(self._judged, key=lambda judged: judged[2])

    def best_of(self, *given: Solution | None) -> Solution:
        """The best strategy of those given, with the ambusher of greatest bound.

        That is the one of most entropy within the slack of the bound, else the one of least value.
        """
        found = [each for each in given if each]
        q, prices, bound = self.best_proof(*found)
        values = [worst_loss(self.game, each.p) for each in found]
        good = [each for each, value in zip(found, values, strict=True)
                if value <= bound * (1.0 + self.slack)]
        best = (max(good, key=lambda each: route_entropy(self.game.network, each.p)) if good
                else found[int(np.argmin(values))])
        return replace(best, q=q, prices=prices)

    def law(self, network: AcyclicNetwork, level: FloatArray, kept: Sequence[tuple[float, ...]],
            q: FloatArray, prices: tuple[float, ...]) -> Solution:
        """Search at the level (S,), with the first kept margins that are not infeasible."""
        if not self.laws:
            self.extend_law_deadline()
        warm = self.warm
        for margins in kept:
            limits = LimitRows(self.game, network, level * (1.0 + LEVEL_AIM * self.slack),
                               self.budgets, margins)
            p, found = self.gibbs_strategy(network, limits, limits.start(warm))
            if not found.infeasible or limits.entropy_bound(found, 1.0) < 0.0:
                break
            warm = limits.unscaled(found.multipliers)
        multipliers = None if found.infeasible else limits.unscaled(found.multipliers)
        most = limits.entropy_bound(found, (1.0 + self.slack) / (1.0 + LEVEL_AIM * self.slack))
        self.laws.append(Solution(p, q, prices, self.evaluations, multipliers, most))
        return self.laws[-1]

    def kept_margins(self, bound: float, prices: tuple[float, ...]) -> tuple[float, ...]:
        """What the search keeps below each budget, so that it may end a little over its aim."""
        worth = KEPT_SLACK * self.slack * bound
        return tuple(min(KEPT_MARGIN * b.margin, worth / price if price > 0.0 else np.inf)
                     for b, price in zip(self.budgets, prices, strict=True))

    def acyclic_part(self, game: Game, p: FloatArray) -> AcyclicNetwork:
        """The edges that go forward in an order of the nodes around the strategy p (M,)."""
        rank = rank_around(game, p, self.potential)
        part = forward_part(game, rank)
        assert part is not None  # it contains p
        return acyclic_network(part, rank)

    def gibbs_strategy(self, network: AcyclicNetwork, limits: LimitRows, start: FloatArray,
                       softness: float = 0.0) -> tuple[FloatArray, GibbsStrategy]:
        """The p (M,) of the entropy search, and its result; the limits of sites may be soft."""
        tolerance = min(LIMIT_TOLERANCE * self.slack, limits.tolerance)
        found = maximize_entropy(network, limits.rows, start, tolerance, self.law_deadline,
                                 softness, limits.sites)
        self.evaluations += found.evaluations
        p = np.zeros(len(self.game.network.edges))
        p[network.edge] = found.p
        return p, found

    def _mixed_to_fit(self, found: Solution, least: LeastRisk) -> Solution | None:
        """Mix in the strategy of least risk until value and budgets hold; None if they cannot.

        If rounding puts that strategy over a budget, the mixture may be over it by as much.
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
            return kept and entry_value(self.game, p) + over <= limit

        p = mixture(found.p, least.p, holds)
        return None if p is None else replace(found, p=p)

    def within_budgets(self, p: FloatArray) -> bool:
        """Whether p (M,) is within all budgets."""
        return all(budget.keeps(p) for budget in self.budgets)


def mixture(p: FloatArray, partner: FloatArray,
            holds: Callable[[FloatArray], bool]) -> FloatArray | None:
    """p (M,) mixed with as little of its partner as ``holds`` requires; None if neither does."""
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
    mixture: FloatArray = (1.0 - high) * p + high * partner
    return mixture
