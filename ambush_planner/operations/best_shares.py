# SPDX-License-Identifier: Apache-2.0
"""Best shares of given paths of a trip's legs: the LP over them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix

from ..arrays import FloatArray, IndexArray
from ..errors import BudgetInfeasible
from ..game.value import highs
from ..game.value.mixtures import mixture_lp

# Sites with which the LP begins, those that join at once, and its relative precision.
FIRST_SITES, MORE_SITES, PRECISE = 20, 10, 1e-4


class BestShares(NamedTuple):
    """The best shares (k,) of some paths, the ``columns`` (k,), and their value.

    A path j with ``reduced_costs[j]`` < 0 lowers the value if it joins. No mixture of any paths has
    a value below the sum of ``bounds`` (legs,).
    """

    columns: IndexArray
    value: float
    shares: FloatArray
    reduced_costs: FloatArray
    bounds: FloatArray

    def of_all(self, leg: IndexArray, least: float = 0.0) -> FloatArray:
        """The shares of all paths, given their legs (K,), those up to ``least`` left out.

        Raises BudgetInfeasible if no shares are within the budget.
        """
        if math.isinf(self.value):
            raise BudgetInfeasible(f'no mixture of {len(self.columns)} routes was found within the '
                                   'budget; raise max_detour')
        shares = np.zeros(len(leg))
        shares[self.columns] = np.where(self.shares > least, self.shares, 0.0)
        return np.asarray(shares / np.bincount(leg, shares)[leg])


class SharesLP:
    """Paths of some legs (K,) that cause ``losses`` (S, K) at sites; losses of legs add up.

    Each leg has a budget, and the mean of its paths' ``costs`` (K,) is at most 1. A site has a row
    in the LP once it matters. More sites may join ``losses`` at its end. ``solve`` raises TimeLimit
    at the ``deadline`` (``time.monotonic``).
    """

    def __init__(self, losses: FloatArray | csr_matrix, costs: FloatArray, leg: IndexArray,
                 deadline: float = math.inf) -> None:
        self.losses, self.costs, self.leg, self.deadline = losses, costs, leg, deadline
        self.sites = np.argsort(-np.asarray(losses.mean(axis=1)).ravel())[:FIRST_SITES]

    def solve(self, columns: IndexArray | None = None) -> BestShares:
        """The best shares of ``columns`` (k,), by default of all; the value is inf if none fit."""
        columns = np.arange(len(self.costs)) if columns is None else columns
        losses = self.losses[:, columns]
        while True:
            sites = self.sites
            value, shares, q, prices = self._vertex(csr_matrix(losses[sites]), columns)
            if not self.misses(losses @ shares, value):
                break
        column_costs = q @ self.losses[sites] + prices[self.leg] * self.costs
        bounds = self._least(column_costs, np.arange(len(self.costs))) - prices
        reduced = column_costs - self._least(column_costs, columns)[self.leg]
        return BestShares(columns, value, shares, reduced,
                          np.maximum(bounds, 0.0) / max(float(q.sum()), 1.0))

    def _least(self, column_costs: FloatArray, columns: IndexArray) -> FloatArray:
        """The least cost (legs,) of each leg's columns among some."""
        least = np.full(self.leg.max() + 1, np.inf)
        np.minimum.at(least, self.leg[columns], column_costs[columns])
        return least

    def misses(self, losses: FloatArray, value: float) -> bool:
        """Let some sites join that cause more than a value found without them."""
        worst = np.argsort(-losses)[:MORE_SITES]
        worst = np.setdiff1d(worst[losses[worst] > value * (1.0 + PRECISE)], self.sites)
        self.sites = np.append(self.sites, worst)
        return len(worst) > 0

    def _vertex(self, losses: csr_matrix, columns: IndexArray
                ) -> tuple[float, FloatArray, FloatArray, FloatArray]:
        """Value and shares (k,) of the LP with a row for each site, and duals: q (S,), prices.

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
