"""A primal-dual interior point method for separable convex programs on networks.

Problem. With f (K,) >= 0,

    minimise    c' f + sum of f_k ln f_k over the entropic k
    subject to  rows f = rhs            sparse, few entries a column,
                dense' f <= budget      one dense row, left out when the budget is infinite.

Method. Mehrotra's predictor-corrector (S. Mehrotra, On the implementation of a primal-dual
interior point method, SIAM Journal on Optimization 2, 1992). Entropy is a barrier of its own, so
entropic variables carry no dual variable w; the others do. Each iteration factorises the normal
matrix ``rows W rows'`` once, W = 1 / (Hessian's diagonal), in an order found once by geometric
nested dissection; the dense row is kept out of it (bordered system).
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from .errors import SolverFailed, TimeLimit
from .game import BoolArray
from .normal_matrix import NormalMatrix
from .risk_map import FloatArray

MAX_ITERATIONS = 150
# Residuals of the rows, in their own units (flows of size 1).
ROW_TOLERANCE = 1e-10
# Weighted dual residual and complementarity, relative to 1 + |objective|.
GAP_TOLERANCE = 1e-9
# Where rounding keeps it from these, tolerances so much larger will do after some iterations, and
# still larger ones at the very end: rows are polished afterwards, and the certificate decides.
ROUGH, PATIENCE, LAST_RESORT = 100.0, 3, 1000.0
# Afterwards the rows are met to this, in so many attempts at the most.
POLISHED, POLISHING, POLISHING_CHANGE = 1e-14, 3, 3e-3
# The last iterations aim at this share of the tolerated complementarity.
LEAST_CENTRING = 0.1
# Share of the way to the boundary that a step may go.
BOUNDARY = 0.99
# Entropic variables below this may miss a step's end: no row notices, and none waits for them.
NEGLIGIBLE = 1e-16
# Changes of ln f that one step looks ahead to.
MAX_RISE, MAX_FALL = 1.0, 20.0
# A slack far from its bound makes W huge and costs digits in every row that it stands in. It only
# delays such a slack, which the next iterations make up for, to pretend that W is smaller.
MAX_WEIGHT = 1e4


@dataclass(frozen=True, eq=False)
class Program:
    """The data of one problem; ``places`` (R, 2) says where each row lies in the plane."""

    rows: csr_matrix
    rhs: FloatArray
    cost: FloatArray
    entropic: BoolArray
    dense: FloatArray
    budget: float
    places: FloatArray

    @property
    def has_budget(self) -> bool:
        """Whether the dense row is part of the problem."""
        return bool(np.isfinite(self.budget))


@dataclass(frozen=True, eq=False)
class Solution:
    """Primal f, duals y of the rows and ``price`` >= 0 of the dense row, iterations used."""

    f: FloatArray
    y: FloatArray
    price: float
    iterations: int


@dataclass
class _Point:
    """An iterate: f > 0 with w >= 0; slack > 0 of the dense row with its price > 0."""

    f: FloatArray
    w: FloatArray
    y: FloatArray
    slack: float
    price: float

    def step(self, move: _Point, primal: float, dual: float) -> _Point:
        return _Point(
            np.maximum(self.f + primal * move.f, (1.0 - BOUNDARY) * self.f),
            self.w + dual * move.w,
            self.y + dual * move.y,
            self.slack + primal * move.slack,
            self.price + dual * move.price,
        )

    def complementarity(self) -> float:
        return float(self.f @ self.w) + self.slack * self.price


def minimise(program: Program, start: FloatArray, deadline: float = np.inf) -> Solution:
    """Solve the program from a start f (K,) > 0 that need not satisfy any row.

    Parameters
    ----------
    deadline
        Value of ``time.monotonic()`` at which to give up [s].

    Raises
    ------
    TimeLimit
        The deadline passed.
    SolverFailed
        The method does not converge: the program is infeasible or numerically out of reach.
    """
    normal = NormalMatrix(program.rows, program.places)
    point = _first_point(program, start)
    nearly = 0
    for iteration in range(MAX_ITERATIONS):
        residuals = _Residuals(program, point)
        nearly += residuals.small(ROUGH)
        last = iteration == MAX_ITERATIONS - 1 and residuals.small(LAST_RESORT)
        if residuals.small() or nearly > PATIENCE or last:
            f = _polished(program, point.f, normal)
            return Solution(f, point.y, point.price, iteration)
        if time.monotonic() > deadline:
            raise TimeLimit(f"interior point method: time is up after {iteration} iterations")
        newton = _Newton(program, point, residuals, normal)
        point = _advance(program, point, newton)
        if not np.isfinite(point.f).all() or not np.isfinite(point.y).all():
            break
    raise SolverFailed(
        f"interior point method: no convergence in {iteration + 1} iterations "
        f"(rows {residuals.row_error:.1e}, gap {residuals.relative_gap:.1e})"
    )


def _polished(program: Program, f: FloatArray, normal: NormalMatrix) -> FloatArray:
    """Meet the rows and the budget to rounding by small relative changes of f."""
    for _ in range(POLISHING):
        missing = program.rhs - program.rows @ f
        excess = float(program.dense @ f) - program.budget if program.has_budget else 0.0
        if np.abs(missing).max(initial=0.0) < POLISHED and excess <= POLISHED * f.sum():
            break
        weight = np.minimum(f, 1.0)
        solve = normal.factorise(weight)
        change = program.rows.T @ solve(missing)
        if excess > 0.0:
            border = program.rows @ (weight * program.dense)
            along = program.dense - program.rows.T @ solve(border)
            pivot = float(program.dense @ (weight * along))
            excess += float(program.dense @ (weight * change))
            shorter = along * (excess / pivot if pivot > 0.0 else 0.0)
            # Where the rows leave no shorter flow, they go first.
            if np.abs(shorter).max() < POLISHING_CHANGE:
                change -= shorter
        f = f + weight * np.clip(change, -0.5, 0.5)
    return f


def _first_point(program: Program, start: FloatArray) -> _Point:
    w = np.where(program.entropic, 0.0, 1.0)
    y = np.zeros(program.rows.shape[0])
    if not program.has_budget:
        return _Point(start, w, y, 0.0, 0.0)
    slack = max(program.budget - float(program.dense @ start), 0.1 * abs(program.budget), 0.1)
    return _Point(start, w, y, slack, 1.0)


class _Residuals:
    """How far a point is from each of the optimality conditions."""

    def __init__(self, program: Program, point: _Point) -> None:
        f, log = point.f, np.zeros_like(point.f)
        np.log(f, out=log, where=program.entropic)
        gradient = program.cost + np.where(program.entropic, log + 1.0, 0.0)
        self.objective = float(program.cost @ f + (f * log).sum())
        self.dual = program.rows.T @ point.y + point.w - gradient - point.price * program.dense
        self.rows = program.rhs - program.rows @ f
        self.budget = (
            program.budget - float(program.dense @ f) - point.slack if program.has_budget else 0.0
        )
        self.gap = point.complementarity()
        pairs = int(np.count_nonzero(point.w)) + int(program.has_budget)
        self._pairs = max(pairs, 1)
        self.mu = self.gap / self._pairs
        self.row_error = float(np.abs(self.rows).max(initial=0.0))
        weighted = float((f * np.abs(self.dual)).sum())
        self.relative_gap = (weighted + self.gap) / (1.0 + abs(self.objective))
        self._budget_scale = 1.0 + abs(program.budget) if program.has_budget else 1.0

    def least_mu(self) -> float:
        """Complementarity to aim for at the end; below it variables jam at their bounds."""
        return LEAST_CENTRING * GAP_TOLERANCE * (1.0 + abs(self.objective)) / self._pairs

    def small(self, factor: float = 1.0) -> bool:
        """Tell whether all residuals are within ``factor`` times their tolerances."""
        return (
            self.row_error < factor * ROW_TOLERANCE
            and abs(self.budget) < factor * ROW_TOLERANCE * self._budget_scale
            and self.relative_gap < factor * GAP_TOLERANCE
        )


class _Newton:
    """The factorised Newton system at a point; solves for several right-hand sides."""

    def __init__(
        self, program: Program, point: _Point, residuals: _Residuals, normal: NormalMatrix
    ) -> None:
        self.program, self.point, self.residuals = program, point, residuals
        self.weight = _weights(program, point, residuals)
        self._solve = normal.factorise(self.weight)
        if program.has_budget:
            self._border = program.rows @ (self.weight * program.dense)
            self._border_solved = self._solve(self._border)
            self._pivot = (
                float(program.dense**2 @ self.weight)
                + point.slack / point.price
                - float(self._border @ self._border_solved)
            )

    def move(
        self, target: FloatArray, budget_target: float, correction: FloatArray | float = 0.0
    ) -> _Point:
        """Solve for the move that makes f w change by ``target`` to first order.

        ``budget_target`` is the same for the dense row's slack and price; ``correction`` is added
        to the dual residual.
        """
        program, point, weight = self.program, self.point, self.weight
        pull = self.residuals.dual + correction + target / point.f
        y = self._solve(self.residuals.rows - program.rows @ (weight * pull))
        price = slack = 0.0
        if program.has_budget:
            missing = self.residuals.budget - budget_target / point.price
            missing -= float(program.dense @ (weight * pull))
            price = (float(self._border @ y) - missing) / self._pivot
            y = y + self._border_solved * price
            slack = (budget_target - point.slack * price) / point.price
        f = weight * (pull + program.rows.T @ y - price * program.dense)
        w = np.where(program.entropic, 0.0, (target - point.w * f) / point.f)
        return _Point(f, w, y, slack, price)


def _weights(program: Program, point: _Point, residuals: _Residuals) -> FloatArray:
    """How far each variable moves per unit of dual pull: 1 / curvature.

    An entropic f whose dual residual is r should end at f e^r; the secant of the exponential
    from 0 to r, not its tangent, leads there, so that one f far too large cannot hold up all.
    """
    weight = np.empty_like(point.f)
    entropic = program.entropic
    r = np.clip(residuals.dual[entropic], -np.inf, MAX_RISE)
    r = np.where(np.abs(r) < 1e-8, 1e-8, r)
    weight[entropic] = point.f[entropic] * np.expm1(r) / r
    weight[~entropic] = point.f[~entropic] / point.w[~entropic]
    return np.minimum(weight, MAX_WEIGHT)


def _advance(program: Program, point: _Point, newton: _Newton) -> _Point:
    """One predictor-corrector step."""
    residuals = newton.residuals
    mu = residuals.mu
    predictor = newton.move(-point.f * point.w, -point.slack * point.price)
    primal, dual = _step_lengths(point, predictor)
    centring = 0.0
    if mu > 0.0:
        kept = point.step(predictor, primal, dual).complementarity() / residuals.gap
        centring = max(min(1.0, kept) ** 3 * mu, residuals.least_mu())
    both = primal * dual
    target = np.where(program.entropic, 0.0, centring - point.f * point.w)
    target -= both * predictor.f * predictor.w
    budget_target = centring - point.slack * point.price - both * predictor.slack * predictor.price
    # Where the predictor asks ln f to change by a, f changes by the factor e^a.
    wanted = np.clip(predictor.f / newton.weight, -MAX_FALL, MAX_RISE)
    bend = np.where(
        program.entropic, np.expm1(wanted) * point.f / newton.weight - wanted, 0.0
    )
    move = newton.move(target, budget_target, bend)
    primal, dual = _step_lengths(point, move)
    return point.step(move, primal, dual)


def _step_lengths(point: _Point, move: _Point) -> tuple[float, float]:
    """Longest primal and dual steps <= 1 that stay inside the positive variables."""
    inner = point.w > 0.0
    counts = inner | (point.f > NEGLIGIBLE)
    primal = float((-move.f[counts] / point.f[counts]).max(initial=0.0))
    dual = float((-move.w[inner] / point.w[inner]).max(initial=0.0))
    if point.price > 0.0:
        primal = max(primal, -move.slack / point.slack)
        dual = max(dual, -move.price / point.price)
    return _inside(primal), _inside(dual)


def _inside(shrink: float) -> float:
    """Step for a largest relative decrease ``shrink`` per unit step."""
    return 1.0 if shrink <= BOUNDARY else BOUNDARY / shrink
