# SPDX-License-Identifier: Apache-2.0
"""The linear program over mixtures of known routes.

    minimise b   subject to   mean loss at site j <= b,
                              mean reduced cost <= 1 (in slacks of the budget),
                              the shares are a unit flow through the stops,

each route hit once by each site. Whole routes flow from the source to the target, the legs of trips
also from stop to stop. The duals are the ambusher's strategy and the price of the budget. HiGHS'
interior point method without crossover gives *central* duals, which price many routes at once; a
vertex jumps from one extreme ambusher to another, but he waits at few sites.
"""

from __future__ import annotations

import math
from copy import copy
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.sparse import csr_matrix, hstack, vstack

from ...arrays import NEGLIGIBLE, BoolArray, FloatArray, IndexArray, sums
from ...errors import SolverFailed
from . import highs

if TYPE_CHECKING:
    from scipy.optimize import OptimizeResult

# Share of the value from which on a site's losses are near it.
NEAR = 0.9


class Mixture(NamedTuple):
    """Its value, the shares (C,) of the routes, and the duals: q (groups, S), and the price."""

    value: float
    shares: FloatArray
    q: FloatArray
    price: float


class _Column(NamedTuple):
    """A route, given by its edges, in a group.

    ``met`` are the sites that it meets, ``reduced_cost`` is in slacks of the budget. It leads
    ``between`` two stops, numbered from the source on; no leg ends at the source.
    """

    route: IndexArray
    met: IndexArray
    reduced_cost: float
    group: int
    between: tuple[int, int]


class Mixtures:
    """Routes in groups, each with the sites (S,) that it meets and its reduced cost.

    Sites have shares of their own for each group: the first, second, ... legs of trips; or there is
    one group of whole routes. Mean reduced costs are at most 1 if they are ``limited``.
    """

    def __init__(self, groups: int, limited: bool) -> None:
        self.loss, self._groups = np.zeros(0), groups
        self._limited = limited
        self._unit, self._near = 0.0, np.zeros((groups, 0), dtype=bool)
        self._columns: list[_Column] = []
        self._known: set[bytes] = set()

    @property
    def routes(self) -> list[IndexArray]:
        """The routes, as edges."""
        return [each.route for each in self._columns]

    def add(self, route: IndexArray, met: BoolArray, reduced_cost: float, group: int = 0,
            between: tuple[int, int] = (0, 1)) -> bool:
        """Add a route, given by its edges, and the sites (S,) it meets; return if it is new."""
        key = route.tobytes()
        if key in self._known:
            return False
        self._known.add(key)
        self._columns.append(_Column(route, np.flatnonzero(met), reduced_cost, group, between))
        return True

    def add_sites(self, entering: csr_matrix, loss: FloatArray) -> None:
        """Add sites with losses (K,) and the edges (K, M) that enter their discs."""
        met_by, count = csr_matrix(entering.T), len(self.loss)
        self.loss = np.append(self.loss, loss)
        self._near = np.pad(self._near, ((0, 0), (0, len(loss))))
        for k, each in enumerate(self._columns):
            met = np.unique(met_by[each.route].indices)
            self._columns[k] = each._replace(met=np.append(each.met, count + met))

    def among(self, columns: IndexArray) -> Mixtures:
        """The LP over some of the routes, by their numbers."""
        some = copy(self)
        some._unit, some._known = 0.0, set()
        some._columns = [self._columns[k] for k in columns.tolist()]
        return some

    def losses(self, shares: FloatArray) -> FloatArray:
        """Mean loss (S,) that each site causes a mixture."""
        met = [each.met for each in self._columns[: len(shares)]]  # routes may have joined since
        return self.loss * sums(np.concatenate(met), np.repeat(shares, list(map(len, met))),
                                len(self.loss))

    def value(self, shares: FloatArray) -> float:
        """The largest loss."""
        return float(self.losses(shares).max(initial=0.0))

    def flow(self, shares: FloatArray, edges: int) -> FloatArray:
        """Expected uses (M,) of the edges."""
        routes = self.routes[: len(shares)]
        return sums(np.concatenate(routes), np.repeat(shares, list(map(len, routes))), edges)

    def solve(self, precision: float, deadline: float = math.inf,
              vertex: bool = False) -> Mixture:
        """The mixture of least value, to a relative gap of ``precision``, with central duals.

        Or a ``vertex`` of the LP, which has few routes and few sites. A site has a row in the LP
        once its losses have come near the value. Raises TimeLimit at ``deadline``
        (``time.monotonic``), or SolverFailed.
        """
        group = np.array([each.group for each in self._columns])
        near, cap, costs = self._near.ravel(), math.inf, self._budget_row
        # In a unit near the value, to which the solver's tolerances are relative.
        most = float(self.loss.max(initial=0.0)) or 1.0
        unit = self._unit if self._unit > NEGLIGIBLE * most else most
        hit, shares = self._hits(group) / unit, 1.0 / np.bincount(group)[group]
        losses = hit @ shares
        while True:
            if cap < math.inf or not near.any():
                near = near | (losses > min(NEAR * losses.max(initial=0.0), cap))
            result = self._solve_on(hit[near], costs, precision, deadline, vertex)
            shares, cap = np.maximum(result.x[: len(group)], 0.0), float(result.x[len(group)])
            shares /= np.bincount(group, shares)[group]
            losses = hit @ shares
            if not (losses > cap * (1.0 + precision))[~near].any():
                break
        self._near = (losses > NEAR * cap).reshape(self._groups, -1)
        self._unit = float(result.fun) * unit
        duals, q = np.maximum(-np.asarray(result.ineqlin.marginals), 0.0), np.zeros(len(near))
        q[near], price = np.split(duals, [np.count_nonzero(near)])
        return Mixture(self._unit, shares, q.reshape(self._groups, -1), float(price.sum()) * unit)

    @property
    def _budget_row(self) -> csr_matrix:
        """The reduced costs (1, C) of the routes, or no row (0, C) if they are not limited."""
        costs = csr_matrix([[each.reduced_cost for each in self._columns]])
        return costs if self._limited else costs[:0]

    def _hits(self, group: IndexArray) -> csr_matrix:
        """The loss (groups * S, C) that each route has at each site of its group."""
        met, count = [each.met for each in self._columns], len(self.loss)
        sites, column = np.concatenate(met), np.repeat(np.arange(len(met)), list(map(len, met)))
        return csr_matrix((self.loss[sites], (group[column] * count + sites, column)),
                          (self._groups * count, len(met)))

    def _solve_on(self, hit: csr_matrix, budget_row: csr_matrix, precision: float,
                  deadline: float, vertex: bool = False) -> OptimizeResult:
        """Solve the LP with the rows (R, C) of some sites, and that of the budget, if any."""
        rows, count = hit.shape
        limits = csr_matrix(hstack([hit, csr_matrix(-np.ones((rows, 1)))]))
        costs = budget_row.copy()
        costs.resize(costs.shape[0], limits.shape[1])
        begin, end = np.array([each.between for each in self._columns]).T
        stops, inner = end.max(), np.flatnonzero(end < end.max())
        flow = csr_matrix((np.append(np.ones(count), -np.ones(len(inner))),
                           (np.append(begin, end[inner]), np.append(np.arange(count), inner))),
                          (stops, limits.shape[1]))
        objective = np.append(np.zeros(count), 1.0)
        bounds = np.repeat([0.0, 1.0], [rows, costs.shape[0]])
        return _solved(highs.LP(objective, csr_matrix(vstack([limits, costs])), bounds, flow,
                                np.eye(1, stops)[0]), precision, deadline, vertex)


def _solved(lp: highs.LP, precision: float, deadline: float, vertex: bool) -> OptimizeResult:
    first = 'simplex' if vertex else 'interior_point'
    result = highs.run_either(lp, first, deadline, False, precision)
    if result.x is None:
        raise SolverFailed('no mixture of the known routes is within the budget')
    return result
