"""The default strategy: least risk within the budgets, then the most unpredictable routes.

1. Find the least value z: by a cut without a reach; with one, by the cheapest chain of discs, or by
   a program in potentials of the faces if a budget binds; by a linear program if none of these
   applies (``least_risk``).
2. Accept values up to (1 + slack) z.
3. Find the strategy of greatest route entropy (a Gibbs law) on an acyclic part of the network that
   contains an optimal strategy. If it still exceeds a limit when the search ends, mix in the
   optimal strategy of stage 1.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ..arrays import FloatArray
from ..errors import SolverFailed, TimeLimit
from .acyclic import (
    conserved_strategy,
    forward_part,
    order_potential,
    rank_around,
    rank_by,
    without_cycles,
)
from .budget import BUDGET_TOLERANCE, ROUNDING, Budget
from .certificate import hit_bound
from .cut import uniform_ambusher
from .disc_chain import chain_ambusher
from .entries import entry_bound, entry_value
from .entropy_search import GibbsStrategy, maximize_entropy
from .face_program import FaceProgram, LevelLines
from .faces import Faces, make_faces
from .flow_program import capped_at_places
from .game import Game
from .gibbs import AcyclicNetwork
from .hits import worst_loss
from .least_risk import (
    NEGLIGIBLE,
    PRICES,
    LeastRisk,
    initial_part,
    least_risk,
    least_risk_by_cut,
    without_excessive_sites,
    without_forbidden_edges,
)
from .limit_rows import KEPT_MARGIN, LimitRows, Multipliers
from .route_sampler import shortest_route_strategy
from .separate_legs import join_faces, once_at_each_place, separate_legs
from .two_routes import strategy_within_budgets

# Smallest risk slack of the search, relative to the value.
LEAST_SLACK = 9e-6
# Share of the slack that the search aims at, and its tolerance as a share of the slack.
LEVEL_AIM, LIMIT_TOLERANCE = 0.95, 0.04
# What the search keeps below a budget costs at most this share of the slack, by the budget's price.
KEPT_SLACK = 0.02
# Bisection steps for the share of a mixture.
BISECTIONS = 15
# Relative gap of the linear program, as a share of the slack.
PROGRAM_GAP = 0.02
# The same for the program in potentials of the faces, and for the bound that its ambusher proves.
FACES_GAP, PROVED_GAP = 0.1, 0.2
# Widths of the strips that this program is solved on, in margins of the budget.
STRIPS = (1.0, 2.0, 4.0, np.inf)
# Share of the remaining time for the linear program; the rest is for the entropy search.
PROGRAM_SHARE = 0.6
# The search with soft limits: the softness of each round, and the relative gap at which the search
# before the programs ends.
SOFTNESS, FIRST_GAP = (1e-2, 2.5e-3, 6e-4, 1.5e-4, 4e-5, 1e-5), 0.06
# Factor of its multipliers from round to round; its limits as a share of the first strategy's value
# if no bound is known.
GROWTH, REFERENCE_SHARE = 2.0, 0.05
# A program may take this many times as long as everything before it.
HURRY = 25.0
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


def max_entropy_strategy(stage: EntropyStage) -> Solution:
    """Solve the three stages; at the deadline, return the best strategy so far.

    Raises BudgetInfeasible if no strategy fits all budgets, and TimeLimit if the deadline passed
    before the first strategy.
    """
    game, budgets = stage.game, stage.budgets
    free = without_forbidden_edges(game, budgets)
    if free is not game:
        inner = EntropyStage(free, budgets, stage.slack, stage.deadline, stage.warm)
        return _with_forbidden_edges_priced(game, max_entropy_strategy(inner), budgets)
    if loose := least_risk_by_cut(game, budgets):
        if found := stage.most_unpredictable(loose):
            return found
    elif found := stage.along_chain():
        return found
    first = stage.soft_strategy(loose, FIRST_GAP) if stage.in_a_hurry else None
    if first and time.monotonic() > stage.deadline:
        return first
    if not loose and (found := stage.along_level_lines()):
        # If they were cut short, the better of the two is chosen later.
        return first if first and time.monotonic() > stage.deadline else found
    try:
        if found := stage.along_separate_legs():
            return found
        part = initial_part(game, stage.budgets, stage.potential)
        risk = least_risk(game, part, stage.budgets, PROGRAM_GAP * stage.slack,
                          stage.program_deadline())
    except (TimeLimit, SolverFailed) as failure:
        found = stage.soft_strategy(loose, stage.slack)
        if found is None:
            raise TimeLimit('no strategy within the budgets was found in time') from failure
        return replace(found, complete=not isinstance(failure, TimeLimit))
    found = stage.most_unpredictable(risk)
    return found or Solution(risk.p, risk.q, risk.prices, stage.evaluations)


def _with_forbidden_edges_priced(
    game: Game, found: Solution, budgets: tuple[Budget, ...]
) -> Solution:
    """Choose prices of the budgets of 0 so that the bound holds on the whole game."""
    value = entry_value(game, found.p)
    tried = [found.prices] + [
        tuple(
            price * value / budget.margin if budget.limit == 0.0 else own
            for own, budget in zip(found.prices, budgets, strict=True)
        )
        for price in PRICES
    ]
    best = max(tried, key=lambda prices: entry_bound(game, found.q, budgets, prices))
    return replace(found, prices=best)


class Chain(NamedTuple):
    """A lower bound, its q (N,), and the mean loss (S,) that each site causes at this value."""

    bound: float
    q: FloatArray
    level: FloatArray


class EntropyStage:
    """Stages 2 and 3 for one game."""

    def __init__(self, game: Game, budgets: tuple[Budget, ...], risk_slack: float, deadline: float,
                 warm: Multipliers | None) -> None:
        self.game, self.budgets = game, budgets
        self.slack = max(risk_slack, LEAST_SLACK)
        self.begin, self.deadline, self.warm = time.monotonic(), deadline, warm
        self.potential = order_potential(game)
        self.law_deadline = deadline
        self.evaluations, self.softness = 0, list(SOFTNESS)
        # Searched so far, whether or not they keep the limits.
        self.laws: list[Solution] = []
        # The last ambusher that hit_bound judged, and the bound.
        self._judged: tuple[FloatArray, tuple[float, ...], float] | None = None
        # An optimal flow (M,) that one law of its edges may not attain, see along_level_lines.
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
        kept = self._kept_margins(least.bound, least.prices), (0.0,) * len(self.budgets)
        solution = self._law(network, least.level, kept, least.q, least.prices)
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
        """The certificate's bound by an ambusher's strategy q (N,); the last one is remembered."""
        if not self._judged or self._judged[0] is not q or self._judged[1] != prices:
            self._judged = q, prices, hit_bound(self.game, q, self.budgets, prices)
        return self._judged[2]

    def along_level_lines(self) -> Solution | None:
        """Level lines of the potential of the faces that has the least value within a budget.

        None if that does not apply: it takes one ambusher, and one budget.
        """
        game, binding = self.game, [b for b in self.budgets if b.binds and b.limit > 0.0]
        if not self.chain or game.ambushers > 1 or len(binding) != 1:
            return None
        bound, q, _ = self.chain
        try:
            found = self._least_on_faces(binding[0], bound)
        except SolverFailed:
            return None
        p = conserved_strategy(game, found.p, NEGLIGIBLE)
        short = None if p is None else mixture(p, shortest_route_strategy(game),
                                               self.within_budgets)
        if short is None:
            return None
        self.level_lines = self._or_by_entries(without_cycles(game.network, short))
        prices = self._priced(binding[0], found.price)
        if found.q is None or self.hit_bound(found.q, prices) < bound:
            prices = self._priced(binding[0], 0.0)
        else:
            q = found.q
        return Solution(self.level_lines, q, prices, self.evaluations)

    def _least_on_faces(self, budget: Budget, bound: float) -> LevelLines:
        """Solve on strips around the best route until the ambusher found proves the value.

        Entries show that well enough, and a strip that is too narrow proves next to nothing.
        """
        game = self.game
        faces = self.faces[0]
        if game.network.legs > 1:
            game = separate_legs(game)
            faces = join_faces(game, self.faces)
        program = FaceProgram(faces, budget, bound, FACES_GAP * self.slack,
                              self.program_deadline())
        for width in STRIPS:
            found = program.solve(width)
            if found.q is None or found.value * (1.0 - PROVED_GAP * self.slack) <= entry_bound(
                game, found.q, self.budgets, self._priced(budget, found.price)
            ):
                break
        return found

    def _priced(self, budget: Budget, price: float) -> tuple[float, ...]:
        """The price of one budget, and 0 for the others."""
        return tuple(price if b is budget else 0.0 for b in self.budgets)

    def along_separate_legs(self) -> Solution | None:
        """A trip without a reach: the ambusher who waits for single legs, and a strategy."""
        game = self.game
        if game.network.legs == 1 or game.reach > 0.0:
            return None
        separate = separate_legs(game)
        found = self._by_entries(separate, tuple(replace(b, game=separate) for b in self.budgets))
        self.level_lines = self._or_by_entries(found.p)
        q = once_at_each_place(game, found.q)
        return Solution(self.level_lines, q, found.prices, self.evaluations)

    def _or_by_entries(self, p: FloatArray) -> FloatArray:
        """On a trip, p (M,) or the strategy of least value by entries, whichever is better."""
        if self.game.network.legs == 1:
            return p
        with contextlib.suppress(TimeLimit, SolverFailed):
            other = self._by_entries(self.game, self.budgets).p
            return min(p, other, key=lambda each: worst_loss(self.game, each))
        return p

    def _by_entries(self, game: Game, budgets: tuple[Budget, ...]) -> LeastRisk:
        part = initial_part(game, budgets, self.potential)
        return least_risk(game, part, budgets, FACES_GAP * self.slack, self.program_deadline())

    def along_chain(self) -> Solution | None:
        """The strategy of greatest entropy at the value of the cheapest chain of discs.

        None if the law on the harmonic part cannot keep to it, perhaps because a budget binds.
        """
        if self.chain is None:
            return None
        (bound, q, level), prices = self.chain, (0.0,) * len(self.budgets)
        game, rank = without_excessive_sites(self.game, bound), rank_by(self.potential)
        part = forward_part(game, rank)
        if part is None:
            return None
        kept = (self._kept_margins(bound, prices),)
        found = self._law(AcyclicNetwork(part, rank), level, kept, q, prices)
        value = worst_loss(self.game, found.p)
        fits = value <= bound * (1.0 + self.slack) and self.within_budgets(found.p)
        return found if fits else None

    def _law(self, network: AcyclicNetwork, level: FloatArray, kept: Sequence[tuple[float, ...]],
             q: FloatArray, prices: tuple[float, ...]) -> Solution:
        """Search at the level (S,), with the first kept margins that are not infeasible."""
        if not self.laws:
            self.extend_law_deadline()
        for margins in kept:
            limits = LimitRows(self.game, network, level * (1.0 + LEVEL_AIM * self.slack),
                               self.budgets, margins)
            p, found = self.gibbs_strategy(network, limits, limits.start(self.warm))
            if not found.infeasible or limits.entropy_bound(found, 1.0) < 0.0:
                break
        multipliers = None if found.infeasible else limits.unscaled(found.multipliers)
        most = limits.entropy_bound(found, (1.0 + self.slack) / (1.0 + LEVEL_AIM * self.slack))
        self.laws.append(Solution(p, q, prices, self.evaluations, multipliers, most))
        return self.laws[-1]

    def _kept_margins(self, bound: float, prices: tuple[float, ...]) -> tuple[float, ...]:
        """What the search keeps below each budget, so that it may end a little over its aim."""
        worth = KEPT_SLACK * self.slack * bound
        return tuple(min(KEPT_MARGIN * b.margin, worth / price if price > 0.0 else np.inf)
                     for b, price in zip(self.budgets, prices, strict=True))

    def acyclic_part(self, game: Game, p: FloatArray) -> AcyclicNetwork:
        """The edges that go forward in an order of the nodes around the strategy p (M,)."""
        rank = rank_around(game, p, self.potential)
        part = forward_part(game, rank)
        assert part is not None  # it contains p
        return AcyclicNetwork(part, rank)

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

    def soft_strategy(self, loose: LeastRisk | None, closed: float) -> Solution | None:
        """Search with ever harder soft limits until the relative gap, in entries, is ``closed``.

        ``loose`` is the solution without budgets, if a cut gives it. The multipliers, scaled to an
        ambusher's strategy, give a bound at every step. Returns the best strategy of each side;
        None if rounding leaves no first strategy within the budgets.
        """
        game, first = self.game, strategy_within_budgets(self.game, self.budgets)
        if first is None:
            return None
        none = (0.0,) * len(self.budgets)
        chain = self.chain and self.chain[:2]
        bound, q = (loose.bound, loose.q) if loose else chain or self._ambusher_at_nodes()
        best, reached = Solution(first, q, none, 0), bound
        for law in self.laws:
            best, reached = self._best_of_both(best, reached, law, first)
        self.extend_law_deadline()
        network = self.acyclic_part(game, best.p)
        level = bound / game.ambushers or REFERENCE_SHARE * entry_value(game, best.p)
        limits = LimitRows(game, network, np.full(len(game.sites), level), self.budgets)
        start = limits.start(best.multipliers or self.warm)
        while self.softness and entry_value(game, best.p) > reached * (1.0 + closed):
            p, found = self.gibbs_strategy(network, limits, start, self.softness.pop(0))
            law = Solution(p, *limits.ambusher(found.multipliers), self.evaluations,
                           limits.unscaled(found.multipliers))
            best, reached = self._best_of_both(best, reached, law, first)
            start = found.multipliers * GROWTH
            if time.monotonic() > self.law_deadline:
                break
        self.laws.append(best)
        if reached > bound and self.hit_bound(best.q, best.prices) < bound:
            best = replace(best, q=q, prices=none)
        return best

    def _best_of_both(self, best: Solution, bound: float, law: Solution,
                      partner: FloatArray) -> tuple[Solution, float]:
        """The strategy of least value, the ambusher of greatest bound, and the bound, in entries.

        The law is mixed with its ``partner`` to fit the budgets.
        """
        reached = entry_bound(self.game, law.q, self.budgets, law.prices)
        if reached > bound:
            best, bound = replace(best, q=law.q, prices=law.prices), reached
        p = mixture(law.p, partner, self.within_budgets)
        if p is not None and entry_value(self.game, p) < entry_value(self.game, best.p):
            best = replace(best, p=without_cycles(self.game.network, p), iterations=law.iterations,
                           multipliers=law.multipliers)
        return best, bound

    def _ambusher_at_nodes(self) -> tuple[float, FloatArray]:
        """Bound and q (N,) of the plain game on the same sites, which a reach can only raise."""
        game = self.game
        at_nodes = replace(game.options, ambush_radius=0.0, tube=0.0)
        plain = least_risk_by_cut(replace(game, options=at_nodes))
        return (plain.bound, plain.q) if plain else (0.0, uniform_ambusher(game))

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
