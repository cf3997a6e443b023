# SPDX-License-Identifier: Apache-2.0
"""The best shares of given paths of a trip's legs: a master LP with constraint generation."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix

from ..arrays import FloatArray, IndexArray
from ..errors import BudgetInfeasible
from ..game.value import highs
from ..game.value.mixtures import mixture_lp

# Number of sites with which the LP begins, number that is added at once, and relative tolerance.
FIRST_SITES, ADDED_SITES, TOLERANCE = 20, 10, 1e-4


class BestShares(NamedTuple):
    """Optimal shares (k,) of some paths, the ``columns`` (k,), and their value.

    Adding a path j with ``reduced_costs[j]`` < 0 lowers the value. The sum of ``bounds`` (legs,) is
    a lower bound for all mixtures of all paths.
    """

    columns: IndexArray
    value: float
    shares: FloatArray
    reduced_costs: FloatArray
    bounds: FloatArray

    def of_all(self, leg: IndexArray, least: float = 0.0) -> FloatArray:
        """Return the shares (K,) of all paths, given their legs (K,); those up to ``least`` are 0.

        Raises BudgetInfeasible if no shares are within the budget.
        """
        if math.isinf(self.value):
            raise BudgetInfeasible(f'no mixture of {len(self.columns)} routes was found within the '
                                   'budget; raise max_detour')
        shares = np.zeros(len(leg))
        shares[self.columns] = np.where(self.shares > least, self.shares, 0.0)
        return np.asarray(shares / np.bincount(leg, shares)[leg])


class SharesLP:
    """LP over paths (K,), each of a ``leg``, with ``losses`` (S, K) at sites.

    Losses are summed over legs. The mean of the ``costs`` (K,) of each leg's paths is at most 1.
    Violated sites get rows in the LP. Sites may be appended to ``losses``. ``solve`` raises
    TimeLimit at the ``deadline`` (``time.monotonic``).
    """

    def __init__(self, losses: FloatArray | csr_matrix, costs: FloatArray, leg: IndexArray,
                 deadline: float = math.inf) -> None:
        self.losses, self.costs, self.leg, self.deadline = losses, costs, leg, deadline
        self.sites = np.argsort(-np.asarray(losses.mean(axis=1)).ravel())[:FIRST_SITES]

    def solve(self, columns: IndexArray | None = None) -> BestShares:
        """Find the best shares of ``columns`` (k,), by default of all; if infeasible, value inf."""
        columns = np.arange(len(self.costs)) if columns is None else columns
        losses = self.losses[:, columns]
        while True:
            sites = self.sites
            value, shares, q, prices = self._vertex(csr_matrix(losses[sites]), columns)
            if not self.add_violated(losses @ shares, value):
                break
        column_costs = q @ self.losses[sites] + prices[self.leg] * self.costs
        bounds = self._least(column_costs, np.arange(len(self.costs))) - prices
        reduced = column_costs - self._least(column_costs, columns)[self.leg]
        return BestShares(columns, value, shares, reduced,
                          np.maximum(bounds, 0.0) / max(float(q.sum()), 1.0))

    def _least(self, column_costs: FloatArray, columns: IndexArray) -> FloatArray:
        """Least cost (legs,) among each leg's ``columns``."""
        least = np.full(self.leg.max() + 1, np.inf)
        np.minimum.at(least, self.leg[columns], column_costs[columns])
        return least

    def add_violated(self, losses: FloatArray, value: float) -> bool:
        """Add the worst sites whose ``losses`` (S,) exceed a value; return whether any does."""
        worst = np.argsort(-losses)[:ADDED_SITES]
        worst = np.setdiff1d(worst[losses[worst] > value * (1.0 + TOLERANCE)], self.sites)
        self.sites = np.append(self.sites, worst)
        return len(worst) > 0

    def _vertex(self, losses: csr_matrix, columns: IndexArray
                ) -> tuple[float, FloatArray, FloatArray, FloatArray]:
        """Solve the LP with given rows: value, shares (k,), and duals q (S,) and prices (legs,).

        The value is inf if no shares are within the budgets. Raises TimeLimit.
        """
        leg, rows = self.leg[columns], losses.shape[0]
        unit = float(losses.max()) if losses.nnz else 1.0
        lp = mixture_lp(losses / unit, leg, self.costs[columns])
        solved = highs.run(lp, 'simplex', self.deadline)
        if solved.x is None:
            return math.inf, np.zeros(len(leg)), np.zeros(rows), np.ones(leg.max() + 1)
        shares = np.maximum(solved.x[:-1], 0.0)
        q, prices = np.split(np.maximum(-np.asarray(solved.ineqlin.marginals), 0.0), [rows])
        return (float(solved.fun) * unit, shares / np.bincount(leg, shares)[leg], q,
                prices * unit)
