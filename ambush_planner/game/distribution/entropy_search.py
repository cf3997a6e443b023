# SPDX-License-Identifier: Apache-2.0
"""The multipliers of the Gibbs distribution: the most unpredictable strategy within limits.

Among all strategies p on an acyclic network with C p <= 1, the Gibbs distribution with weights
c = b + C' v has the greatest route entropy less b' p if v >= 0 minimises the convex function

    log Z(b + C' v) + sum v,    gradient 1 - C p,   Hessian the covariance of the rows' costs.

This function is at least the entropy less b' p of any strategy with C p <= 1. So a value below
-max b' p proves that no such strategy exists. The given multipliers are first doubled as long as
that lowers the function. L-BFGS-B goes on from there, with multipliers scaled to bring the
Hessian's diagonal near 1. Newton's method ends the search, in the multipliers of the tight limits,
with Levenberg-Marquardt damping. Both take turns as long as they lower the function noticeably.
"""

from __future__ import annotations

import contextlib
import time
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.sparse import csr_matrix

from ...arrays import ROUNDING, FloatArray
from .gibbs import AcyclicNetwork


class EntropySearch(NamedTuple):
    """The constants of the search for the multipliers."""

    evaluations: int = 50  # of L-BFGS before Newton's method, and in each round after it
    turns: int = 8  # of the two methods; limits that take more are hardly feasible
    newton_limits: int = 500  # that Newton's method moves at once
    newton_steps: int = 8  # most steps in these limits before the others are looked at again
    damping: float = 1e-2  # Newton's first damping, as a share of the Hessian's diagonal
    floor: float = 1e-3  # share of the diagonal's mean that is added to it for the damping
    max_weight: float = 1.0 / np.finfo(float).eps  # of an edge; beyond it, sums lose all digits
    max_scaled: float = 1.0 / ROUNDING  # of a multiplier; beyond it, limits are infeasible


ENTROPY = EntropySearch()


class Accuracy(NamedTuple):
    """Stopping rule of the search.

    ``excess`` is the share by which limits may be exceeded, ``missing`` the missing entropy as a
    share of 1 + the value of the dual function [nats].
    """

    excess: float
    missing: float


class _SearchEnded(Exception):
    """Raised from within an evaluation to end the search."""


@dataclass
class GibbsStrategy:
    """Best evaluation of a search: the strategy p (m,) and the multipliers v (R,).

    ``violation`` is max(C p) - 1. ``infeasible`` says that no strategy is known within the limits.
    """

    p: FloatArray
    multipliers: FloatArray
    violation: float = np.inf
    infeasible: bool = False
    evaluations: int = 0


def maximize_entropy(network: AcyclicNetwork, rows: csr_matrix, weights: FloatArray,
                     start: FloatArray, accuracy: Accuracy, deadline: float) -> GibbsStrategy:
    """Minimise log Z(b + C' v) + sum v over v >= 0, with b = ``weights`` (m,).

    C is ``rows`` (R, m). Every evaluation is a strategy. The search ends when one satisfies the
    ``accuracy`` in both the limits C p <= 1 and the entropy; when the limits are proved infeasible,
    or not kept after many turns; when the function hardly falls any more; or at ``deadline``
    (``time.monotonic``).
    """
    if rows.shape[0] == 0:
        _, p, _ = network.distribution(weights)
        return GibbsStrategy(p, start, 0.0, False, 1)
    search = _DualSearch(network, rows, weights, accuracy, deadline)
    with contextlib.suppress(_SearchEnded):
        search.run(start)
    search.found.evaluations = search.count
    return search.found


class _DualSearch:
    """Minimisation of the dual function; ``found`` is its least evaluation."""

    def __init__(self, network: AcyclicNetwork, rows: csr_matrix, weights: FloatArray,
                 accuracy: Accuracy, deadline: float) -> None:
        self.network, self.rows, self.columns = network, rows, rows.T.tocsr()
        self.weights, self._least_possible = weights, -network.largest_sum(weights)
        self.accuracy, self.deadline = accuracy, deadline
        self.found, self.least, self.count = GibbsStrategy(np.empty(0), np.empty(0)), np.inf, 0
        self.p = self.share = self.gradient = np.empty(0)
        # A limit used in portions of c has a use with a variance of about c.
        portion = np.asarray(rows.sum(axis=1)).ravel() / np.maximum(rows.getnnz(axis=1), 1)
        self.unit = 1.0 / np.sqrt(np.where(portion > 0.0, portion, 1.0))

    def __call__(self, v: FloatArray) -> tuple[float, FloatArray]:
        """Evaluate the function and its gradient at v (R,), or end the search."""
        weights = self.weights + self.columns @ v
        if not np.abs(weights).max() < ENTROPY.max_weight:  # the line search diverges
            raise _SearchEnded
        log_z, self.p, self.share = self.network.distribution(weights)
        used, total = self.rows @ self.p, float(v.sum())
        violation = float(used.max()) - 1.0
        self.count += 1
        value = log_z + total
        # The value bounds the greatest entropy from above; p's entropy is v' (1 - C p) below it.
        missing = float(v @ (1.0 - used))
        near = missing <= self.accuracy.missing * (1.0 + value - missing)
        reached = violation <= self.accuracy.excess and near
        infeasible = not reached and value < self._least_possible - ROUNDING * (1.0 + total)
        if reached or infeasible or not value > self.least:
            self.least = value
            self.found = GibbsStrategy(self.p, v.copy(), violation, infeasible, 0)
        if reached or infeasible or time.monotonic() > self.deadline:
            raise _SearchEnded
        self.gradient = 1.0 - used
        return value, self.gradient

    def run(self, start: FloatArray) -> None:
        """Alternate L-BFGS and Newton's method until a turn gains next to nothing."""
        self.quasi_newton(self.doubled(start))
        # Least gain of an evaluation with which a turn of them can find the missing entropy.
        previous, gain = np.inf, self.accuracy.missing / ENTROPY.evaluations
        for _ in range(ENTROPY.turns):
            if self.least >= previous - gain * (1.0 + abs(self.least)):
                break
            previous = self.least
            self.newton()
            self.quasi_newton(self.found.multipliers)
        else:
            self.found.infeasible = self.found.violation > self.accuracy.excess

    def doubled(self, start: FloatArray) -> FloatArray:
        """Double ``start`` (R,) as long as that lowers the function."""
        largest = float((self.columns @ start).max(initial=0.0))
        if not 0.0 < largest < ENTROPY.max_weight / 4.0:
            return np.zeros_like(start)
        value, _ = self(start)
        while largest < ENTROPY.max_weight / 4.0:
            lower, _ = self(2.0 * start)
            if not lower < value:
                break
            start, value, largest = 2.0 * start, lower, 2.0 * largest
        return start

    def quasi_newton(self, start: FloatArray) -> None:
        """Run L-BFGS-B on the scaled multipliers."""
        # Imported only here because it takes a seventh of the package's loading time.
        from scipy.optimize import fmin_l_bfgs_b

        def function(scaled: FloatArray) -> tuple[float, FloatArray]:
            value, gradient = self(np.minimum(scaled, ENTROPY.max_scaled) * self.unit)
            return value, gradient * self.unit

        most = ENTROPY.evaluations  # and correction pairs
        fmin_l_bfgs_b(function, start / self.unit, bounds=[(0.0, None)] * len(start), m=most,
                      factr=0.0, pgtol=0.0, maxfun=most, maxiter=most)

    def newton(self) -> None:
        """Take damped Newton steps in the largest multipliers while they gain.

        These are the multipliers that are largest now, or after a step in each alone. The damping
        follows H. B. Nielsen, Damping parameter in Marquardt's method, Technical University of
        Denmark, IMM-REP-1999-05, 1999.
        """
        v, damping, rise = self.found.multipliers, ENTROPY.damping, 2.0
        value, gradient = self(v)
        for _ in range(ENTROPY.newton_steps):
            weight = np.maximum(v, -gradient * self.unit**2)
            moved = np.argsort(-weight)[:ENTROPY.newton_limits]
            moved = moved[weight[moved] > 0.0]
            if not len(moved):
                return
            hessian = self.network.covariance(self.share, self.p, self.rows[moved])
            while True:
                step = _bounded_step(hessian, gradient[moved], v[moved], damping)
                predicted = -float(gradient[moved] @ step + step @ hessian @ step / 2.0)
                scale = 1.0 + abs(value)
                if abs(predicted) <= np.spacing(scale):
                    return
                tried = v.copy()
                tried[moved] += step
                new_value, new_gradient = self(tried)
                ratio = (value - new_value) / predicted if predicted > 0.0 else -np.inf
                if ratio > 0.0:
                    break
                damping, rise = damping * rise, 2.0 * rise
            damping *= max(1.0 / 3.0, 1.0 - (2.0 * ratio - 1.0)**3)
            damping, rise = max(damping, ROUNDING), 2.0
            v, value, gradient = tried, new_value, new_gradient


def _bounded_step(hessian: FloatArray, gradient: FloatArray, v: FloatArray,
                  damping: float) -> FloatArray:
    """Step (K,) to the minimum of the damped model that keeps v + step >= 0."""
    diagonal = np.diag(hessian)
    damped = hessian + np.diag(damping * (diagonal + ENTROPY.floor * diagonal.mean()))
    step, free = np.zeros(len(v)), np.ones(len(v), dtype=bool)
    while free.any():
        inner = np.flatnonzero(free)
        try:
            factor = cho_factor(damped[np.ix_(inner, inner)])
        except LinAlgError:
            return np.zeros(len(v))
        pull = -gradient[inner] - damped[np.ix_(inner, np.flatnonzero(~free))] @ step[~free]
        step[inner] = cho_solve(factor, pull)
        negative = free & (v + step < 0.0)
        if not negative.any():
            break
        step[negative] = -v[negative]
        free &= ~negative
    return np.maximum(step, -v)
