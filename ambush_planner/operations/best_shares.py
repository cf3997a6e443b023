# SPDX-License-Identifier: Apache-2.0
"""Best shares of given paths: the LP over them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix

from ..arrays import FloatArray, IndexArray
from ..errors import BudgetInfeasible
from ..game.value import highs

# Sites with which the LP begins, those that join at once, and its relative precision.
FIRST_SITES, MORE_SITES, PRECISE = 20, 10, 1e-4


class BestShares(NamedTuple):
    """The best shares (k,) of some paths, the ``columns`` (k,), and their value.

    What path j would add is priced by ``column_costs[j]``: less than the value is a gain. No
    mixture of any paths has a value below ``bound``.
    """

    columns: IndexArray
    value: float
    shares: FloatArray
    column_costs: FloatArray
    bound: float = 0.0

    def of_all(self, count: int, least: float = 0.0) -> FloatArray:
        """The shares of all paths (``count``,), those up to ``least`` left out.

        Raises BudgetInfeasible if no shares are within the budget.
        """
        if math.isinf(self.value):
            raise BudgetInfeasible(f'no mixture of {len(self.columns)} routes was found within the '
                                   'budget; raise max_detour')
        shares = np.zeros(count)
        shares[self.columns] = np.where(self.shares > least, self.shares, 0.0)
        return np.asarray(shares / shares.sum())


class SharesLP:
    """Paths that cause ``losses`` (S, K) at sites; each row of ``costs`` (B, K) has a mean <= 1.

    A site has a row in the LP once it matters. More sites may join ``losses`` at its end.
    ``solve`` raises TimeLimit at the ``deadline`` (``time.monotonic``).
    """

    def __init__(self, losses: FloatArray | csr_matrix, costs: FloatArray,
                 deadline: float = math.inf) -> None:
        self.losses, self.costs, self.deadline = losses, costs, deadline
        self.sites = np.argsort(-np.asarray(losses.mean(axis=1)).ravel())[:FIRST_SITES]

    def solve(self, columns: IndexArray | None = None) -> BestShares:
        """The best shares of ``columns`` (k,), by default of all; the value is inf if none fit."""
        columns = np.arange(self.costs.shape[1]) if columns is None else columns
        losses, costs = self.losses[:, columns], self.costs[:, columns]
        while True:
            sites = self.sites
            value, shares, q, prices = vertex(csr_matrix(losses[sites]), costs, self.deadline)
            if not self.misses(losses @ shares, value):
                break
        column_costs = q @ self.losses[sites] + prices @ self.costs
        bound = float(column_costs.min() - prices.sum()) / max(float(q.sum()), 1.0)
        return BestShares(columns, value, shares, column_costs, max(bound, 0.0))

    def misses(self, losses: FloatArray, value: float) -> bool:
        """Let some sites join that cause more than a value found without them."""
        worst = np.argsort(-losses)[:MORE_SITES]
        worst = np.setdiff1d(worst[losses[worst] > value * (1.0 + PRECISE)], self.sites)
        self.sites = np.append(self.sites, worst)
        return len(worst) > 0


def vertex(losses: csr_matrix, costs: FloatArray,
           deadline: float = math.inf) -> tuple[float, FloatArray, FloatArray, FloatArray]:
    """Value and shares (K,) of the LP with a row for each site, its duals q (S,) and prices (B,).

    The value is inf if no shares are within the budgets. Raises TimeLimit.
    """
    count = losses.shape[1]
    unit = float(losses.max()) if losses.nnz else 1.0
    sites = np.column_stack((losses.toarray() / unit, -np.ones(losses.shape[0])))
    rows = csr_matrix(np.vstack((sites, np.pad(costs, ((0, 0), (0, 1))))))
    limits = np.repeat([0.0, 1.0], [losses.shape[0], len(costs)])
    total = csr_matrix(np.append(np.ones(count), 0.0)[None, :])
    lp = highs.LP(np.append(np.zeros(count), 1.0), rows, limits, total, np.ones(1))
    solved = highs.run(lp, 'simplex', deadline)
    if solved.x is None:
        return math.inf, np.zeros(count), np.zeros(losses.shape[0]), np.ones(len(costs))
    shares = np.maximum(solved.x[:count], 0.0)
    duals = np.maximum(-np.asarray(solved.ineqlin.marginals), 0.0)
    q, prices = np.split(duals, [losses.shape[0]])
    return float(solved.fun) * unit, shares / shares.sum(), q, prices * unit
