# SPDX-License-Identifier: Apache-2.0
"""What a search has: its problem, an LP for the value, the sites so far, the best strategy."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np
from scipy.sparse import csr_matrix, vstack

from ..arrays import ROUNDING, BoolArray, FloatArray
from ..errors import SolverFailed, TimeLimit
from .ambusher import Ambusher, padded
from .budget import Budget
from .certificate.certificate import lower_bound
from .distribution.chain import MarkovChain, chain_of
from .distribution.route_distribution import RouteDistribution
from .faces import Faces
from .game import Game
from .hits import worst_loss
from .layered_graph import LayeredGraph
from .slack import CERTIFICATE_TOLERANCE, Reason, ceiling, within
from .strategy import Strategy, strategy_of
from .value.routes import Progress, no_progress

# Share of the slack that an LP's strategy may use; a distribution around it may use the rest.
FLOW_SLACK = 0.5


class FoundSites(NamedTuple):
    """Sites that a search has found.

    Positions (K, 2) [m], losses (K,), mean losses (K,), and the edges that enter their discs.
    """

    points: FloatArray
    alpha: FloatArray
    mean_loss: FloatArray
    entering: csr_matrix


class Drawn(Protocol):
    """Routes that are drawn in some way."""

    def meets(self, rows: csr_matrix) -> FloatArray:
        """P(hit) (K,) by sites whose discs are entered by the edges of ``rows`` (K, M)."""

    def meets_at_most(self, rows: csr_matrix) -> FloatArray:
        """An upper bound (K,) of ``meets`` that is fast to find."""


class SiteSearch(Protocol):
    """Finds sites of a map, where an ambusher may wait also between the network's nodes."""

    def worst(self, drawn: Drawn, above: float, apart: float, rough: bool) -> FoundSites:
        """The sites that cost drawn routes more than ``above``, no two within ``apart`` [m].

        The worst comes first. A ``rough`` search can miss it.
        """


class ValueLP(Protocol):
    """A linear program for the least value; it goes on from where it is when sites join.

    ``solve`` raises TimeLimit or SolverFailed; what it has found by then counts. Of sites that
    join at once no two are within ``apart`` times the reach.
    """

    bound: float
    apart: float
    deadline: float

    @property
    def faces(self) -> Faces | None:
        """Of the network, if the LP knows them."""

    @property
    def flow(self) -> FloatArray:
        """An acyclic strategy (M,); within the budget unless the LP is a cut."""

    @property
    def cap(self) -> float:
        """Loss that each site may cause."""

    @property
    def q(self) -> FloatArray:
        """How likely the ambusher who proves the bound waits at each site (S,)."""

    def solve(self) -> None:
        """Find the least value."""

    def add_sites(self, entering: csr_matrix, loss: FloatArray) -> None:
        """Add sites with losses (K,) and the edges (K, M) that enter their discs."""

    @property
    def provers(self) -> Sequence[ValueLP]:
        """Those whose ambushers prove the bound, or one below it that is checked faster, first."""

    def ambusher(self, game: Game, kept: BoolArray) -> Ambusher:
        """He who proves the bound, in a game with the ``kept`` ones of the sites (S,)."""


@dataclass(frozen=True, eq=False)
class SearchProblem:
    """A game, its budget, and how far and how long to search.

    The search ends at ``deadline`` and the judge at ``judged`` (``time.monotonic``). ``progress``
    is called with the value and the bound so far.
    """

    game: Game
    budget: Budget
    slack: float
    deadline: float
    site_search: SiteSearch | None = None
    progress: Progress = no_progress
    judged: float = math.inf

    @property
    def late(self) -> bool:
        """Whether the time is up."""
        return time.monotonic() > self.deadline

@dataclass(frozen=True, eq=False)
class Incumbent:
    """The best strategy so far.

    ``value`` is what it costs at the sites so far, ``worst`` the row of the one that costs most
    (-1: none). ``entropy_bound`` [nats] is the most entropy that a distribution within the same
    limits can have; NaN if that is not known. Its chain may be on ``layers``. Of two
    distributions the one of greater ``rating`` is better: whether it is within the slack, then its
    entropy, or else minus its value.
    """

    chain: MarkovChain
    value: float
    worst: int = -1
    entropy_bound: float = np.nan
    layers: LayeredGraph | None = None
    rating: tuple[bool, float] = (False, -np.inf)

    @property
    def good(self) -> bool:
        """Whether it is within the slack."""
        return self.rating[0]


class Search:
    """A problem, an LP for its value, and the sites that are known so far.

    ``points`` (S, 2), ``loss`` (S,) and ``entering`` (S, M) are those of the sites. ``reason`` says
    why the LP ended last, ``evaluations`` how many Gibbs distributions were computed.
    """

    def __init__(self, problem: SearchProblem, lp: ValueLP, slack: float) -> None:
        self.problem, self.lp, self.slack = problem, lp, slack
        self.game = game = problem.game
        self.points, self.loss = game.network.points[game.sites], game.loss[game.sites]
        self.entering, self.evaluations = game.entering, 0
        self.reason: Reason = 'stalled'

    @contextlib.contextmanager
    def keep_incumbent(self) -> Iterator[None]:
        """What an LP has found before the deadline, or before it fails, counts."""
        try:
            yield
        except TimeLimit:
            self.reason = 'time'
        except SolverFailed:
            self.reason = 'solver'
        else:
            if self.reason == 'solver':
                self.reason = 'stalled'

    def go_on_until(self, deadline: float, judged: float) -> None:
        """Move the ends of the search and of its judge (``time.monotonic``)."""
        self.problem = replace(self.problem, deadline=deadline, judged=judged)
        self.lp.deadline, self.reason = deadline, 'stalled'

    def join_worst(self, drawn: Drawn, above: float, apart: float,
                   rough: bool = False) -> FoundSites | None:
        """Let sites that cost more than ``above`` join the others; return them, None if none does.

        No two of them are within ``apart`` times the reach.
        """
        if self.problem.site_search is None:
            return None
        apart = max(apart, self.lp.apart) * self.game.reach
        found = self.problem.site_search.worst(drawn, above, apart, rough)
        if not len(found.points):
            return None
        self._add(found)
        self.lp.add_sites(found.entering, found.alpha)
        return found

    def _add(self, found: FoundSites) -> None:
        self.points = np.concatenate((self.points, found.points))
        self.entering = csr_matrix(vstack((self.entering, found.entering)))
        self.loss = np.append(self.loss, found.alpha)

    def cap(self) -> float:
        """What each site may cause at a slack of 0."""
        least = ceiling(self.lp.cap, FLOW_SLACK * self.slack) / ceiling(1.0, self.slack)
        return max(self.lp.bound, least)

    def better(self, best: Incumbent | None, distribution: RouteDistribution,
               layers: LayeredGraph | None = None) -> Incumbent | None:
        """A distribution as the best strategy if it is better; one over the budget is not."""
        chain, value, good = distribution.chain, distribution.value, distribution.good
        rating = good, distribution.entropy if good else -value
        if best and rating <= best.rating or not self.problem.budget.keeps(
                chain.uses(len(self.game.playable))):
            return best
        self.problem.progress(value, self.lp.bound)
        return Incumbent(chain, value, distribution.worst, distribution.entropy_bound, layers,
                         rating)

    def strategy(self, best: Incumbent | None) -> Strategy:
        """The best strategy, by default the LP's, with its value at any place.

        In a game with the sites that matter for it or its bound; its network can have a layered
        graph's nodes and edges, after its own.
        """
        if best is None:
            p = self.lp.flow
            best = Incumbent(chain_of(self.game.network, p), worst_loss(self.game, p))
        best = self.worst_of(replace(best, chain=best.chain.without_rare()))
        own = np.arange(len(self.loss)) < len(self.game.sites)
        kept = own | np.any([padded(each.q, len(own)) for each in self.lp.provers], axis=0)
        if best.worst >= 0:
            kept[best.worst] = True
        added = np.flatnonzero(kept & ~own)
        game, p, budget = self.game, best.chain.uses(len(self.game.playable)), self.problem.budget
        entering = self.entering[added]
        if best.layers:
            edge = best.layers.edge
            game, p = best.layers.unrolled(best.chain)
            entering = entering[:, edge]
            budget = replace(budget, game=game, cost=budget.cost[edge])
        game = game.with_sites(self.points[added], self.loss[added], csr_matrix(entering))
        bound, ambusher = self.proof(game, kept, budget, best.value / ceiling(1.0, self.slack))
        found = replace(strategy_of(game, p, ambusher, budget, bound),
                        iterations=self.evaluations, entropy_bound=best.entropy_bound)
        if within(found.value, found.lower_bound, self.problem.slack + CERTIFICATE_TOLERANCE):
            return found
        return replace(found, reason='time' if self.problem.late else self.reason)

    def proof(self, game: Game, kept: BoolArray, budget: Budget,
              enough: float) -> tuple[float, Ambusher]:
        """The best bound that an ambusher proves, and he; a bound of ``enough`` will do."""
        found = []
        for prover in self.lp.provers:
            ambusher = prover.ambusher(game, kept)
            bound = 0.0
            if self.lp.bound > 0.0:  # else a search for what he proves can take minutes
                bound = lower_bound(game, ambusher, budget, prover.faces, self.problem.judged,
                                    enough)
            found.append((bound, ambusher))
            if bound >= enough:
                break
        return max(found, key=lambda proved: proved[0])

    def worst_of(self, best: Incumbent) -> Incumbent:
        """The incumbent with its value at any site, also at those that joined for others."""
        if self.problem.site_search is None:
            return best
        value, worst, chain = best.value, best.worst, best.chain
        more = np.flatnonzero(self.loss * chain.meets_at_most(self.entering)
                              > value * (1.0 + ROUNDING))
        losses = self.loss[more] * chain.meets(self.entering[more])
        if losses.max(initial=0.0) > value * (1.0 + ROUNDING):
            value, worst = float(losses.max()), int(more[losses.argmax()])
        found = self.problem.site_search.worst(chain, value * (1.0 + ROUNDING), 0.0, False)
        if len(found.points):
            value, worst = float(found.mean_loss[0]), len(self.loss)
            self._add(found)
        return replace(best, value=value, worst=worst)
