"""The most unpredictable strategy within limits: the multipliers of the Gibbs law.

Among all strategies p on an acyclic network with C p <= 1, the Gibbs law with weights c = C' v is
the one of greatest route entropy if v >= 0 minimises the convex function

    log Z(C' v) + sum v,        gradient 1 - C p,   Hessian the covariance of the rows' costs.

For every strategy with C p <= 1 that function is at least its entropy, so at least 0: a value
below 0 proves that there is none. The search begins with L-BFGS-B, each multiplier in a unit that
brings the Hessian's diagonal near 1; only limits that are near take part, the others stay at 0.
Where few limits are tight it ends with Newton's method in the multipliers of those, damped as
Levenberg and Marquardt do.
"""

from __future__ import annotations

import contextlib
import time
from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.sparse import csr_matrix

from ..arrays import BoolArray, FloatArray, IndexArray
from .gibbs import AcyclicNetwork

MAX_EVALUATIONS = 1500
# Evaluations before Newton's method takes over, the most limits that it moves at once, and the
# multiplications that its Hessians may take.
FIRST_EVALUATIONS, NEWTON_LIMITS, NEWTON_WORK = 150, 800, 1e11
# The search ends with this share of the entropy, plus as many nats, still to be had.
ENTROPY_TOLERANCE = 2e-3
# The function's value has rounding of this size, relative to its terms.
ROUNDING = 1e-9
# Weights of edges from which on sums along a route have no digit left behind the point.
MAX_WEIGHT = 1e16
# Multipliers below this are as good as 0.
LEAST_MULTIPLIER = 1e-7
# The most that a line search may make of one, in its unit: far enough out to prove what cannot be.
MAX_SCALED = 1e10
# Limits with less than this to spare take part in the search.
NEAR_LIMIT = 0.7
# Correction pairs of L-BFGS.
CORRECTIONS = 30
# Damping of Newton's method: at first, its range, how it rises after a bad step and falls after a
# good one; a step is good when the function falls by this share of what the model says.
DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-2, 1e-9, 1e6
RISE, FALL, ACCEPTED, TRUSTED = 6.0, 0.2, 0.01, 0.5
# Limits with less excess than this share of the tolerance, and edges used less than this, are left
# out of the model.
MODEL_EXCESS, NEGLIGIBLE_USE = 0.1, 1e-7


class _SearchEnded(Exception):
    """Ends a search from within."""


class _LimitJoins(Exception):
    """Another limit joins the search."""


@dataclass
class GibbsStrategy:
    """The last evaluation of the law: p (m,), multipliers v (R,), how far it is over its limits.

    ``excess`` is max(C p) - 1; ``infeasible`` says that no strategy is within the limits.
    """

    p: FloatArray
    multipliers: FloatArray
    excess: float = np.inf
    infeasible: bool = False
    evaluations: int = 0


def maximize_entropy(
    network: AcyclicNetwork, rows: csr_matrix, start: FloatArray, tolerance: float,
    deadline: float, softness: float = 0.0, evaluations: int = MAX_EVALUATIONS,
) -> GibbsStrategy:
    """Minimise log Z(C' v) + sum v + softness / 2 (sum v)^2 over v >= 0.

    Every evaluation is a strategy. The search ends at one that is over its limits C p <= 1, C =
    ``rows`` (R, m), by no more than ``tolerance`` and has all but ``ENTROPY_TOLERANCE`` of the entropy that the
    minimum has, when the limits are proved infeasible, after so many ``evaluations``, or at
    ``deadline`` (``time.monotonic``). ``softness`` lets the strategy be over its limits by
    softness * sum v: then there always is a minimum.
    """
    if rows.shape[0] == 0:
        _, p, _ = network.law(np.zeros(len(network.edge)))
        return GibbsStrategy(p, start, 0.0, False, 1)
    search = _DualSearch(network, rows, tolerance, deadline, softness, evaluations)
    with contextlib.suppress(_SearchEnded):
        first = min(FIRST_EVALUATIONS, evaluations)
        search.quasi_newton(start, first)
        if softness == 0.0:
            search.newton()
        search.quasi_newton(search.found.multipliers, evaluations)
    return search.found


class _DualSearch:
    """The function, its last evaluation, and the ways down."""

    def __init__(
        self, network: AcyclicNetwork, rows: csr_matrix, tolerance: float, deadline: float,
        softness: float, evaluations: int,
    ) -> None:
        self.network, self.rows, self.columns = network, rows, rows.T.tocsr()
        self.tolerance, self.deadline, self.softness = tolerance, deadline, softness
        self.evaluations = evaluations
        self.found = GibbsStrategy(np.empty(0), np.empty(0))
        self.share = self.gradient = np.empty(0)
        # Where a limit is used up in portions of c, its use has a variance of about c.
        portion = np.asarray(rows.sum(axis=1)).ravel() / np.maximum(rows.getnnz(axis=1), 1)
        self.unit = 1.0 / np.sqrt(np.where(portion > 0.0, portion, 1.0))

    def __call__(self, v: FloatArray) -> tuple[float, FloatArray]:
        """Value and gradient at v; ends the search where it can end."""
        weights = self.columns @ v
        if not np.abs(weights).max() < MAX_WEIGHT:  # a line search that ran away
            raise _SearchEnded
        log_z, p, self.share = self.network.law(weights)
        used, total, found = self.rows @ p, float(v.sum()), self.found
        found.p, found.multipliers = p, v.copy()
        found.excess = float(used.max()) - 1.0
        found.evaluations += 1
        value = log_z + total + self.softness / 2.0 * total**2
        hard = self.softness == 0.0
        # The value is at least the most entropy there is; p's own is less by v' (1 - C p).
        missing = float(v @ (1.0 - used))
        near = missing <= ENTROPY_TOLERANCE * (1.0 + value - missing)
        reached = hard and found.excess <= self.tolerance and near
        found.infeasible = hard and not reached and value < -ROUNDING * (1.0 + total)
        late = found.evaluations >= self.evaluations or time.monotonic() > self.deadline
        if reached or found.infeasible or late:
            raise _SearchEnded
        self.gradient = 1.0 - used + self.softness * total
        return value, self.gradient

    def quasi_newton(self, start: FloatArray, evaluations: int) -> None:
        """L-BFGS-B in the limits that are near; when another is the worst, it joins."""
        last, moved = self.found.evaluations + evaluations, np.zeros(len(start), dtype=bool)
        self(start)
        while self.found.evaluations < last:
            moved |= (self.found.multipliers > 0.0) | (self.gradient < NEAR_LIMIT)
            with contextlib.suppress(_LimitJoins):
                self._descend(moved, last - self.found.evaluations)
                return

    def _descend(self, moved: BoolArray, evaluations: int) -> None:
        """L-BFGS-B in the limits ``moved`` (R,), from where the search is."""
        # Who solves nothing does without it: it is a seventh of what loading the package takes.
        from scipy.optimize import fmin_l_bfgs_b

        part, v = np.flatnonzero(moved), self.found.multipliers.copy()
        unit = self.unit[part]

        def function(scaled: FloatArray) -> tuple[float, FloatArray]:
            v[part] = np.minimum(scaled, MAX_SCALED) * unit
            value, gradient = self(v)
            worst = gradient.argmin()
            if not moved[worst] and gradient[worst] < -self.tolerance:
                raise _LimitJoins
            return value, gradient[part] * unit

        fmin_l_bfgs_b(
            function, v[part] / unit, bounds=[(0.0, None)] * len(part), m=CORRECTIONS, factr=5.0,
            pgtol=1e-12, maxfun=evaluations, maxiter=evaluations,
        )

    def newton(self) -> None:
        """Damped Newton steps in the limits that count most."""
        v, damping = self.found.multipliers, DAMPING
        v = np.where(v > LEAST_MULTIPLIER, v, 0.0)
        value, gradient = self(v)
        work = 0.0
        while work < NEWTON_WORK:
            weight = np.maximum(v, -gradient / (MODEL_EXCESS * self.tolerance) - 1.0)
            counts = np.argsort(-weight)[:NEWTON_LIMITS]
            counts = counts[weight[counts] > 0.0]
            work += float(len(self.found.p)) * len(counts) ** 2
            hessian = self._hessian(counts)
            while True:
                step = _bounded_step(hessian, gradient[counts], v[counts], damping)
                foreseen = -float(gradient[counts] @ step + step @ hessian @ step / 2.0)
                tried = v.copy()
                tried[counts] += step
                new_value, new_gradient = self(tried)
                ratio = (value - new_value) / foreseen if foreseen > 0.0 else -np.inf
                if ratio > ACCEPTED:
                    break
                damping *= RISE
                if damping > MOST_DAMPING:
                    return
            if ratio > TRUSTED:
                damping = max(damping * FALL, LEAST_DAMPING)
            v, value, gradient = tried, new_value, new_gradient

    def _hessian(self, counts: IndexArray) -> FloatArray:
        """Covariance (K, K) of the costs of the limits ``counts`` (K,) along a route."""
        used = np.flatnonzero(self.found.p > NEGLIGIBLE_USE)
        costs = np.asarray(self.rows[counts][:, used].T.toarray())
        moved = self.network.deviations(self.share, used, costs)
        moved *= np.sqrt(self.found.p[used])[:, None]
        return np.asarray(moved.T @ moved)


def _bounded_step(
    hessian: FloatArray, gradient: FloatArray, v: FloatArray, damping: float
) -> FloatArray:
    """Step (K,) to the minimum of the damped model; multipliers that would fall below 0 stop."""
    diagonal = np.diag(hessian)
    damped = hessian + np.diag(damping * (diagonal + 1e-3 * diagonal.mean()))
    step, free = np.zeros(len(v)), np.ones(len(v), dtype=bool)
    for _ in range(6):
        inner = np.flatnonzero(free)
        try:
            factor = cho_factor(damped[np.ix_(inner, inner)])
        except LinAlgError:
            return np.zeros(len(v))
        pull = -gradient[inner] - damped[np.ix_(inner, np.flatnonzero(~free))] @ step[~free]
        step[inner] = cho_solve(factor, pull)
        below = free & (v + step < 0.0)
        if not below.any():
            break
        step[below] = -v[below]
        free &= ~below
        if not free.any():
            break
    return np.maximum(step, -v)
