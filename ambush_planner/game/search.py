# SPDX-License-Identifier: Apache-2.0
"""The state of a search: the problem, the program for its value, the sites and the incumbent."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np
from scipy.sparse import csr_matrix, vstack

from ..arrays import ROUNDING, FloatArray
from ..errors import SolverFailed, TimeLimit
from .ambusher import Ambush
from .distribution.route_distribution import RouteDistribution
from .hits import Law, largest_product
from .legs import Legs
from .tolerance import MIN_TOLERANCE, Reason


class FoundSites(NamedTuple):
    """Sites that a search has found.

    Positions (K, 2) [m], losses (K,), mean losses (K,), and the edges that enter their discs.
    """

    points: FloatArray
    alpha: FloatArray
    mean_loss: FloatArray
    entering: csr_matrix


class SiteSearch(Protocol):
    """Finds sites of a map, where an ambusher may wait also between the network's nodes."""

    def worst(self, law: Law, above: float, apart: float) -> FoundSites:
        """The sites that cost drawn routes more than ``above``, no two within ``apart`` [m].

        The worst comes first.
        """


# Is called with the phase of a plan, and the value, or ``inf`` before a strategy is finished.
Progress = Callable[[str, float], None]


def no_progress(phase: str, value: float) -> None:
    """Report nothing."""


@dataclass(frozen=True, eq=False)
class SearchProblem:
    """The legs of a trip, and how far and how long to search.

    The search ends at ``deadline`` and proofs at ``certificate_deadline`` (``time.monotonic``).
    """

    legs: Legs
    tolerance: float
    deadline: float
    site_search: SiteSearch | None = None
    certificate_deadline: float = math.inf
    first_value: float = math.inf

    @property
    def search_tolerance(self) -> float:
        """The tolerance with which the search ends, so that the certificate's is kept."""
        return max(self.tolerance, MIN_TOLERANCE)

    @property
    def out_of_time(self) -> bool:
        """Return whether the deadline has passed."""
        return time.monotonic() > self.deadline


@dataclass(frozen=True, eq=False)
class Incumbent:
    """The best strategies so far, of all legs.

    ``value`` is what they cost at the sites so far, ``worst`` the row of the one that costs most
    (-1: none). ``entropy_bound`` [nats] is the most entropy that a distribution within the same
    limits can have; NaN if that is not known. Of two, the one of greater ``rating`` is better:
    whether it is within the tolerance, then its entropy, or else minus its value.
    """

    law: Law
    value: float
    worst: int = -1
    entropy_bound: float = np.nan
    rating: tuple[bool, float] = (False, -np.inf)

    @property
    def good(self) -> bool:
        """Return whether the value is within the tolerance."""
        return self.rating[0]


class Program(Protocol):
    """Finds the least value."""

    @property
    def bound(self) -> float:
        """No strategy has a smaller value, as the ``ambush`` proves."""

    @property
    def value(self) -> float:
        """The cost of the strategies of ``flow`` at the sites so far."""

    @property
    def flow(self) -> FloatArray:
        """Strategies (M,) of the legs that nearly attain the bound, without cycles."""

    @property
    def ambush(self) -> Ambush:
        """The ambusher who proves the bound."""

    def solve(self, deadline: float) -> None:
        """Go on from where it is; raises TimeLimit or SolverFailed, what was found counts."""

    def add_sites(self, entering: csr_matrix, loss: FloatArray) -> None:
        """Add sites with losses (K,) and the edges (K, M) that enter their discs."""


class Search:
    """A problem, a program for its value, and the sites that are known so far.

    ``points`` (S, 2), ``loss`` (S,) and ``entering`` (S, M) are those of the sites; ``earlier`` has
    the ambushers of programs before. ``reason`` says why the program ended last, ``evaluations``
    how many Gibbs distributions were computed.
    """

    def __init__(self, problem: SearchProblem, program: Program) -> None:
        self.problem, self.program = problem, program
        self.tolerance = problem.search_tolerance
        self.legs = legs = problem.legs
        self.points, self.loss, self.entering = legs.site_points, legs.loss, legs.entering
        self.evaluations = 0
        self.earlier: list[Ambush] = []
        self.reason: Reason = 'stalled'

    @property
    def deadline(self) -> float:
        """Return the end of the search (``time.monotonic``)."""
        return self.problem.deadline

    def solve_program(self) -> None:
        """Let the program go on; what it has found before the deadline, or a failure, counts."""
        with self._noted_failure():
            self.program.solve(self.deadline)

    @contextlib.contextmanager
    def _noted_failure(self) -> Iterator[None]:
        try:
            yield
        except TimeLimit:
            self.reason = 'time'
        except SolverFailed:
            self.reason = 'solver'
        else:
            self.reason = 'stalled'

    def go_on_until(self, deadline: float, certificate_deadline: float) -> None:
        """Move the ends of the search and of proofs (``time.monotonic``)."""
        self.problem = replace(self.problem, deadline=deadline,
                               certificate_deadline=certificate_deadline)

    def add_violated_sites(self, law: Law, threshold: float, apart: float) -> FoundSites | None:
        """Separation: add the sites that cost more than ``threshold``; None if none does.

        No two of them are within ``apart`` times the reach.
        """
        if self.problem.site_search is None:
            return None
        found = self.problem.site_search.worst(law, threshold, apart * self.legs.reach)
        if not len(found.points):
            return None
        self._add(found)
        self.program.add_sites(found.entering, found.alpha)
        return found

    def _add(self, found: FoundSites) -> None:
        self.points = np.concatenate((self.points, found.points))
        self.entering = csr_matrix(vstack((self.entering, found.entering)))
        self.loss = np.append(self.loss, found.alpha)

    def better(self, best: Incumbent | None, distribution: RouteDistribution) -> Incumbent | None:
        """The better one of the incumbent and a distribution; one over a budget is none."""
        chain, value, good = distribution.chain, distribution.value, distribution.good
        rating = good, distribution.entropy if good else -value
        if best and rating <= best.rating:
            return best
        uses = self.legs.split(chain.uses(self.legs.edge_count))
        if not all(budget.keeps(p) for budget, p in zip(self.legs.budgets, uses, strict=True)):
            return best
        return Incumbent(chain, value, distribution.worst, distribution.entropy_bound, rating)

    def at_any_site(self, best: Incumbent) -> Incumbent:
        """The incumbent with its value at any site, also at those that joined for others."""
        value, worst = largest_product(self.loss, self.entering, best.law)
        if self.problem.site_search is not None:
            threshold = value * (1.0 + ROUNDING)
            found = self.problem.site_search.worst(best.law, threshold, 0.0)
            if len(found.points):
                value, worst = float(found.mean_loss[0]), len(self.loss)
                self._add(found)
        return replace(best, value=value, worst=worst)
