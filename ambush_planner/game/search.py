# SPDX-License-Identifier: Apache-2.0
"""The state of a search: the problem, the program for its value, the sites and the incumbent."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
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
    """Violated sites, the worst first, with the edges (K, M) that enter their discs.

    ``points`` (K, 2) are their positions [m], ``alpha`` (K,) the loss that an ambush there causes,
    and ``mean_loss`` (K,) what it costs the strategy that violates them.
    """

    points: FloatArray
    alpha: FloatArray
    mean_loss: FloatArray
    entering: csr_matrix


class SiteSearch(Protocol):
    """Separation on a map: finds violated sites, also between the network's nodes."""

    def worst(self, law: Law, threshold: float, spacing: float) -> FoundSites:
        """Find sites whose mean loss exceeds ``threshold``, no two within ``spacing`` [m]."""


# Called with the phase of a plan and its value, ``inf`` before a strategy is finished.
Progress = Callable[[str, float], None]


def no_progress(phase: str, value: float) -> None:
    """Report nothing."""


@dataclass(frozen=True, eq=False)
class SearchProblem:
    """The legs of a trip, the tolerance of the value, and the deadlines of search and proof.

    Deadlines are times of ``time.monotonic``. The search for the value begins at ``first_value``.
    """

    legs: Legs
    tolerance: float
    deadline: float
    site_search: SiteSearch | None = None
    certificate_deadline: float = math.inf
    first_value: float = math.inf

    @property
    def search_tolerance(self) -> float:
        """Tolerance at which the search stops; never 0, so that it can be reached."""
        return max(self.tolerance, MIN_TOLERANCE)

    @property
    def out_of_time(self) -> bool:
        """Return whether the deadline has passed."""
        return time.monotonic() > self.deadline


@dataclass(frozen=True, eq=False)
class Incumbent:
    """The best strategies of all legs found so far.

    Attributes
    ----------
    law
        The probability law of their routes.
    value, worst
        Largest mean loss at a known site, and the row of that site; -1: there is none.
    entropy_bound
        Upper bound of the entropy that a distribution within the same limits can have [nats]; NaN
        if unknown.
    rating
        Sort key: first, whether the value is within the tolerance; then the entropy if it is, else
        minus the value.
    """

    law: Law
    value: float
    worst: int = -1
    entropy_bound: float = np.nan
    rating: tuple[bool, float] = (False, -np.inf)

    @property
    def within_tolerance(self) -> bool:
        """Return whether the value is within the tolerance of the bound."""
        return self.rating[0]


class Program(Protocol):
    """A mathematical program for the least value at the known sites."""

    @property
    def bound(self) -> float:
        """Lower bound of the value of every strategy, certified by ``ambush``."""

    @property
    def value(self) -> float:
        """Largest mean loss of the strategies of ``flow`` at the known sites."""

    @property
    def flow(self) -> FloatArray:
        """Acyclic strategies (M,) of the legs that nearly attain the bound."""

    @property
    def ambush(self) -> Ambush:
        """The ambusher's strategy that certifies the bound."""

    def solve(self, deadline: float) -> None:
        """Resume until solved; raises TimeLimit or SolverFailed, but keeps what it found."""

    def add_sites(self, entering: csr_matrix, loss: FloatArray) -> None:
        """Add sites with losses (K,) and the edges (K, M) that enter their discs."""


class Search:
    """State of a search: the problem, the program for its value, and the known sites.

    ``points`` (S, 2), ``loss`` (S,) and ``entering`` (S, M) belong to the sites. ``earlier`` has
    the ambushers of programs that were replaced, ``reason`` says why the program ended last, and
    ``evaluations`` counts the Gibbs distributions that were computed. ``distribution`` is the
    latest one of chains, if there is one; ``proved`` is the bound of a certificate, ``inf`` before.
    """

    def __init__(self, problem: SearchProblem, program: Program) -> None:
        self.problem, self.program = problem, program
        self.tolerance = problem.search_tolerance
        self.legs = legs = problem.legs
        self.points, self.loss, self.entering = legs.site_points, legs.loss, legs.entering
        self.evaluations = 0
        self.earlier: list[Ambush] = []
        self.reason: Reason = 'stalled'
        self.distribution: RouteDistribution | None = None
        self.proved = math.inf

    @property
    def bound(self) -> float:
        """Lower bound of the value: the program's, or less if a certificate has proved less."""
        return min(self.program.bound, self.proved)

    @property
    def deadline(self) -> float:
        """The end of the search (``time.monotonic``)."""
        return self.problem.deadline

    def solve_program(self) -> None:
        """Resume the program; after a failure or the deadline, what it found still counts."""
        try:
            self.program.solve(self.deadline)
        except TimeLimit:
            self.reason = 'time'
        except SolverFailed:
            self.reason = 'solver'
        else:
            self.reason = 'stalled'

    def move_deadlines(self, deadline: float, certificate_deadline: float) -> None:
        """Set other deadlines of the search and of proofs (``time.monotonic``)."""
        self.problem = replace(self.problem, deadline=deadline,
                               certificate_deadline=certificate_deadline)

    def add_violated_sites(self, law: Law, threshold: float, spacing: float) -> FoundSites | None:
        """Separation: add the sites whose mean loss exceeds ``threshold``; None if there are none.

        No two of them are within ``spacing`` times the reach.
        """
        if self.problem.site_search is None:
            return None
        found = self.problem.site_search.worst(law, threshold, spacing * self.legs.reach)
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
        """Return the better of an incumbent and a distribution, unless that exceeds a budget."""
        chain, value, good = distribution.chain, distribution.value, distribution.good
        rating = good, distribution.entropy if good else -value
        if best and rating <= best.rating:
            return best
        uses = self.legs.split(chain.uses(self.legs.edge_count))
        if not all(budget.keeps(p) for budget, p in zip(self.legs.budgets, uses, strict=True)):
            return best
        return Incumbent(chain, value, distribution.worst, distribution.entropy_bound, rating)

    def value_everywhere(self, best: Incumbent) -> Incumbent:
        """Return the incumbent with its value at all known sites and everywhere on the map."""
        value, worst = largest_product(self.loss, self.entering, best.law)
        if self.problem.site_search is not None:
            threshold = value * (1.0 + ROUNDING)
            found = self.problem.site_search.worst(best.law, threshold, 0.0)
            if len(found.points):
                value, worst = float(found.mean_loss[0]), len(self.loss)
                self._add(found)
                self.program.add_sites(found.entering, found.alpha)
        return replace(best, value=value, worst=worst)
