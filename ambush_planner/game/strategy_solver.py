"""The default strategy: least risk within the budgets, then the most unpredictable routes.

1. Find the least value z, by a cut if that is exact, else by a linear program (``least_risk``).
2. Accept values up to (1 + slack) z.
3. Find the strategy of greatest route entropy (a Gibbs law) on an acyclic part of the network that
   contains an optimal strategy. If it still exceeds a limit when the search ends, mix in the
   optimal strategy of stage 1.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix, diags, vstack

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
from .face_program import solve_on_faces
from .faces import Faces, make_faces
from .flow_program import capped_at_one
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
from .route_sampler import shortest_route_strategy

# Smallest risk slack of the search, relative to the value.
LEAST_SLACK = 9e-6
# Share of the slack that the search aims at, and its tolerance as a share of the slack.
LEVEL_AIM, LIMIT_TOLERANCE = 0.95, 0.04
# Most that the search keeps below a budget: a share of its margin, and a share of the slack by the
# budget's price.
KEPT_MARGIN, KEPT_SLACK = 1e-3, 0.02
# Smallest tolerance of the search, relative to a limit.
LEAST_TOLERANCE = 1e-6
# Bisection steps for the share of a mixture.
BISECTIONS = 30
# Relative gap of the linear program, as a share of the slack.
PROGRAM_GAP = 0.02
# The same for the program in potentials of the faces.
FACES_GAP = 0.1
# Smallest limit of a site's hits; with several ambushers its level may be 0.
LEAST_HITS = 1e-9
# Share of the remaining time for the linear program; the rest is for the entropy search.
PROGRAM_SHARE = 0.6
# The search with soft limits: rounds, evaluations per round, factor of the softness per round.
SOFT_ROUNDS, SOFT_EVALUATIONS, SOFTNESS_FACTOR = 8, 80, 0.25
# Its limits, at least this share of the shortest route's value, and a typical entropy [nats].
REFERENCE_SHARE, FIRST_ENTROPY = 0.05, 30.0
# Largest initial multiplier of a site or budget, scaled to its limit.
MAX_FIRST_MULTIPLIER = 300.0


@dataclass(frozen=True, eq=False)
class Multipliers:
    """Multipliers of the Gibbs law: per hit of each site (N,), per unit of each budget's cost."""

    sites: FloatArray
    budgets: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Solution:
    """A solver's p (M,), q (N,), prices of the budgets [loss / unit], effort and multipliers.

    ``entropy_bound`` is the most entropy [nats] that a strategy on the same acyclic part can have.
    """

    p: FloatArray
    q: FloatArray
    prices: tuple[float, ...]
    iterations: int
    multipliers: Multipliers | None = None
    entropy_bound: float = np.nan


def max_entropy_strategy(stage: EntropyStage) -> Solution:
    """Solve the three stages; at the deadline, return the best strategy so far.

    Raises BudgetInfeasible if no strategy fits all budgets, and TimeLimit if the deadline passed
    before the first strategy.
    """
    game, budgets, least = stage.game, stage.budgets, 0.0
    free = without_forbidden_edges(game, budgets)
    if free is not game:
        inner = EntropyStage(free, budgets, stage.slack, stage.deadline, stage.warm)
        return _with_forbidden_edges_priced(game, max_entropy_strategy(inner), budgets)
    if loose := least_risk_by_cut(game, budgets):
        if found := stage.most_unpredictable(loose):
            return found
        least = loose.bound / game.ambushers
    elif found := stage.along_chain() or stage.along_level_lines():
        return found
    try:
        part = initial_part(game, stage.budgets, stage.potential)
        risk = least_risk(game, part, stage.budgets, PROGRAM_GAP * stage.slack,
                          stage.program_deadline())
    except (TimeLimit, SolverFailed):
        return stage.without_linear_program(least)
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


class EntropyStage:
    """Stages 2 and 3 for one game."""

    def __init__(self, game: Game, budgets: tuple[Budget, ...], risk_slack: float, deadline: float,
                 warm: Multipliers | None) -> None:
        self.game, self.budgets = game, budgets
        self.slack = max(risk_slack, LEAST_SLACK)
        self.deadline, self.warm = deadline, warm
        self.potential = order_potential(game)
        self.evaluations = 0
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

    def most_unpredictable(self, least: LeastRisk) -> Solution | None:
        """The strategy of greatest entropy at the least risk; None if it cannot keep the limits."""
        game = without_excessive_sites(self.game, least.bound, least.p)
        network = self.acyclic_part(game, least.p)
        kept = self._kept_margins(least.bound, least.prices), (0.0,) * len(self.budgets)
        solution = self._law(network, least.level, kept, least.q, least.prices)
        return self._mixed_to_fit(solution, least)

    @cached_property
    def faces(self) -> Faces | None:
        """The faces of a planar network, if there is a reach."""
        game = self.game
        plain = game.reach == 0.0 or game.network.legs > 1
        faces = None if plain else make_faces(game)
        return faces if faces and faces.touched.nnz else None

    @cached_property
    def chain(self) -> tuple[float, FloatArray] | None:
        """The value without budgets and q (N,) by the cheapest chain of discs."""
        q = chain_ambusher(self.faces) if self.faces else None
        return None if q is None else (self.hit_bound(q, (0.0,) * len(self.budgets)), q)

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
        assert self.faces is not None  # it has a chain
        bound, q = self.chain
        try:
            found = solve_on_faces(self.faces, binding[0], bound, FACES_GAP * self.slack,
                                   self.program_deadline())
        except SolverFailed:
            return None
        p = conserved_strategy(game, found.p, NEGLIGIBLE)
        short = None if p is None else mixture(p, shortest_route_strategy(game),
                                               self.within_budgets)
        if short is None:
            return None
        self.level_lines = without_cycles(game.network, short)
        prices = tuple(found.price if b is binding[0] else 0.0 for b in self.budgets)
        return Solution(self.level_lines, q if found.q is None else found.q, prices,
                        self.evaluations)

    def along_chain(self) -> Solution | None:
        """The strategy of greatest entropy at the value of the cheapest chain of discs.

        None if the law on the harmonic part cannot keep to it, perhaps because a budget binds.
        """
        if self.chain is None:
            return None
        (bound, q), prices = self.chain, (0.0,) * len(self.budgets)
        game, rank = without_excessive_sites(self.game, bound), rank_by(self.potential)
        part = forward_part(game, rank)
        if part is None:
            return None
        level = np.full(len(self.game.sites), bound / self.game.ambushers)
        kept = (self._kept_margins(bound, prices),)
        found = self._law(AcyclicNetwork(part, rank), level, kept, q, prices)
        value = worst_loss(self.game, found.p)
        fits = value <= bound * (1.0 + self.slack) and self.within_budgets(found.p)
        return found if fits else None

    def _law(self, network: AcyclicNetwork, level: FloatArray, kept: Sequence[tuple[float, ...]],
             q: FloatArray, prices: tuple[float, ...]) -> Solution:
        """Search at the level (S,), with the first kept margins that are not infeasible."""
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
                       softness: float = 0.0,
                       evaluations: int = 0) -> tuple[FloatArray, GibbsStrategy]:
        """The p (M,) of the entropy search, and its result."""
        found = maximize_entropy(network, limits.rows, start,
                                 min(LIMIT_TOLERANCE * self.slack, limits.tolerance), self.deadline,
                                 softness, evaluations)
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

    def without_linear_program(self, least: float) -> Solution:
        """Search with ever harder soft limits; return the best strategy of each side.

        ``least`` is a lower bound of the worst site's mean loss. The multipliers, scaled to an
        ambusher's strategy, give a bound at every step.
        """
        shortest = shortest_route_strategy(self.game)
        if not self.within_budgets(shortest):
            raise TimeLimit('the time limit passed before a strategy within the budgets was found')
        best = Solution(shortest, uniform_ambusher(self.game), (0.0,) * len(self.budgets), 0)
        value, bound = entry_value(self.game, shortest), 0.0
        for law in self.laws:
            short = mixture(law.p, shortest, self.within_budgets)
            if short is not None and entry_value(self.game, short) < value:
                short = without_cycles(self.game.network, short)
                value, best = entry_value(self.game, short), replace(best, p=short)
        network = self.acyclic_part(self.game, best.p)
        reference = max(least, REFERENCE_SHARE * value)
        level = np.full(len(self.game.sites), reference)
        limits = LimitRows(self.game, network, level, self.budgets)
        start, softness = limits.start(self.warm), value / reference / FIRST_ENTROPY
        for _ in range(SOFT_ROUNDS):
            p, found = self.gibbs_strategy(network, limits, start, softness, SOFT_EVALUATIONS)
            start, softness = found.multipliers, softness * SOFTNESS_FACTOR
            short = mixture(p, shortest, self.within_budgets)
            if short is not None and entry_value(self.game, short) < value:
                value = entry_value(self.game, short)
                best = replace(best, p=short, multipliers=limits.unscaled(start),
                               iterations=self.evaluations)
            q, prices = limits.ambusher(start)
            reached = entry_bound(self.game, q, self.budgets, prices)
            if reached > bound:
                bound = reached
                best = replace(best, q=q, prices=prices)
            if time.monotonic() > self.deadline:
                break
        known = self.chain or self._ambusher_at_nodes()
        if known is not None and known[0] > bound:
            best = replace(best, q=known[1], prices=(0.0,) * len(self.budgets))
        return best

    def _ambusher_at_nodes(self) -> tuple[float, FloatArray] | None:
        """Bound and q (N,) of the plain game on the same sites, which a reach can only raise."""
        game = self.game
        at_nodes = replace(game.options, ambush_radius=0.0, tube=0.0)
        plain = least_risk_by_cut(replace(game, options=at_nodes))
        return None if plain is None else (plain.bound, plain.q)

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


class LimitRows:
    """The limits of stage 3 as rows C p <= 1: sites that can exceed theirs, then the budgets."""

    def __init__(self, game: Game, network: AcyclicNetwork, level: FloatArray,
                 budgets: tuple[Budget, ...], kept: tuple[float, ...] | None = None) -> None:
        self._game, self._budgets = game, budgets
        hits = game.hits[:, network.edge]
        most = np.maximum(level / game.loss[game.sites], LEAST_HITS)
        self._row = np.flatnonzero((hits.getnnz(axis=1) > 0) & (most < _most_hits(game)))
        self._most = most[self._row]
        self._binding = [b for b in budgets if b.binds]
        whole = np.array([b.margin for b in self._binding])
        if kept is None:
            kept = tuple(KEPT_MARGIN * b.margin for b in budgets)
        self._margin = whole - [k for k, b in zip(kept, budgets, strict=True) if b.binds]
        self._whole = whole / self._margin
        # What the search may exceed a limit by, relative: no more than what is kept of a budget.
        self.tolerance = max(float((self._whole - 1.0).min(initial=1.0)), LEAST_TOLERANCE)
        over = [csr_matrix(b.excess[network.edge]) for b in self._binding]
        scale = np.concatenate((self._most, self._margin))
        self.rows = csr_matrix(diags(1.0 / scale) @ vstack([hits[self._row], *over]))
        edge = network.edge
        mean = np.array([float(b.cost[edge].mean()) for b in self._binding])
        self._first = np.minimum(self._margin / np.maximum(mean, 1e-300), MAX_FIRST_MULTIPLIER)

    def start(self, warm: Multipliers | None) -> FloatArray:
        """Scaled multipliers (R,) to start from: those of ``warm``, or 0 for sites."""
        if warm is None or len(warm.sites) != self._game.node_count:
            return np.concatenate((np.zeros(len(self._row)), self._first))
        sites = warm.sites[self._game.sites[self._row]] * self._most
        pairs = zip(warm.budgets, self._budgets, strict=True)
        budgets = np.array([price for price, b in pairs if b.binds]) * self._margin
        return np.asarray(np.minimum(np.concatenate((sites, budgets)), MAX_FIRST_MULTIPLIER))

    def unscaled(self, multipliers: FloatArray) -> Multipliers:
        """The scaled multipliers (R,) as multipliers per hit and per unit of cost."""
        sites = np.zeros(self._game.node_count)
        count = len(self._row)
        sites[self._game.sites[self._row]] = multipliers[:count] / self._most
        price = iter(multipliers[count:] / self._margin)
        budgets = (float(next(price)) if b.binds else 0.0 for b in self._budgets)
        return Multipliers(sites, tuple(budgets))

    def entropy_bound(self, found: GibbsStrategy, slack: float) -> float:
        """Most entropy within ``slack`` times the limits of the sites and the whole budgets."""
        limits = np.concatenate((np.full(len(self._row), slack), self._whole))
        return found.log_partition + float(found.multipliers @ limits)

    def ambusher(self, multipliers: FloatArray) -> tuple[FloatArray, tuple[float, ...]]:
        """The ambusher's strategy q (N,) and the prices in proportion to the multipliers (R,)."""
        found, game = self.unscaled(multipliers), self._game
        q = np.zeros(game.node_count)
        q[game.sites] = found.sites[game.sites] / game.loss[game.sites]
        total = float(q.sum()) / game.ambushers
        if not total > 0.0:
            return uniform_ambusher(game), (0.0,) * len(found.budgets)
        return capped_at_one(q / total, game.ambushers), tuple(b / total for b in found.budgets)


def _most_hits(game: Game) -> float:
    """Largest number of hits of one site by one route; a leg may come back to a disc."""
    return (1.0 if game.reach == 0.0 else 3.0) * game.network.legs
