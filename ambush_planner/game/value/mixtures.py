# SPDX-License-Identifier: Apache-2.0
"""The linear program over mixtures of known routes.

    minimise k b + sum of b_j   subject to   mean loss at site j <= b + b_j,
                                             mean reduced cost <= 1 (in budget slacks),
                                             the shares are a unit flow through the stops,

each route hit once by each site. Whole routes flow from the source to the target, the legs of trips
also from stop to stop. The duals are the ambusher's strategy and the prices of the budgets. HiGHS'
interior point method without crossover gives *central* duals, which price many routes at once; a
vertex would jump from one extreme ambusher to another.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.sparse import csr_matrix, hstack, identity, vstack

from ...arrays import FloatArray, IndexArray, sums
from ...errors import SolverFailed
from ..certificate.best_response import NEGLIGIBLE
from . import highs

if TYPE_CHECKING:
    from scipy.optimize import OptimizeResult

# Uniform floor of all sites' caps, as a share of the value per relative gap.
EVEN = 0.3
# Share of the value from which on a site's losses are near it.
NEAR = 0.9


class Mixture(NamedTuple):
    """Its value, the shares (C,) of the routes, and the duals: q (groups, S), prices (B,)."""

    value: float
    shares: FloatArray
    q: FloatArray
    prices: FloatArray


class Mixtures:
    """Routes in groups, each with the sites (S,) that it meets and its reduced costs (B,).

    Sites have shares of their own for each group: the first, second, ... legs of trips; or there is
    one group of whole routes.
    """

    def __init__(self, groups: int) -> None:
        self.loss, self.ambushers, self.limit, self._groups = np.zeros(0), 0, 1.0, groups
        self._unit, self._near = 0.0, np.zeros((groups, 0), dtype=bool)
        self.routes: list[IndexArray] = []
        self._met: list[IndexArray] = []
        self._counts: list[FloatArray] = []  # what each of them counts
        self._reduced_cost: list[FloatArray] = []
        self._group: list[int] = []
        self._between: list[tuple[int, int]] = []
        self._known: set[bytes] = set()

    def add(self, route: IndexArray, met: FloatArray, reduced_cost: FloatArray, group: int = 0,
            between: tuple[int, int] = (0, 1)) -> bool:
        """Add a route, given by its edges and what each site counts; return whether it is new.

        It leads ``between`` two stops, numbered from the source on; no leg ends at the source.
        """
        key = route.tobytes()
        if key in self._known:
            return False
        self._known.add(key)
        self._between.append(between)
        self.routes.append(route)
        self._met.append(np.flatnonzero(met))
        self._counts.append(met[self._met[-1]])
        self._reduced_cost.append(reduced_cost)
        self._group.append(group)
        return True

    def add_sites(self, entering: csr_matrix, loss: FloatArray) -> None:
        """Add sites with losses (K,) and the edges (K, M) that enter their discs."""
        met_by, count = csr_matrix(entering.T), len(self.loss)
        self.loss = np.append(self.loss, loss)
        self._near = np.pad(self._near, ((0, 0), (0, len(loss))))
        for k, route in enumerate(self.routes):
            some, counts = met_by[route], np.zeros(len(loss))
            np.maximum.at(counts, some.indices, some.data)
            met = np.flatnonzero(counts)
            self._met[k] = np.append(self._met[k], count + met)
            self._counts[k] = np.append(self._counts[k], counts[met])

    def among(self, columns: IndexArray) -> Mixtures:
        """The LP over some of the routes, by their numbers."""
        some = Mixtures(self._groups)
        some.loss, some.ambushers, some.limit = self.loss, self.ambushers, self.limit
        some._near = self._near
        for k in columns.tolist():
            some.routes.append(self.routes[k])
            some._met.append(self._met[k])
            some._counts.append(self._counts[k])
            some._reduced_cost.append(self._reduced_cost[k])
            some._group.append(self._group[k])
            some._between.append(self._between[k])
        return some

    def losses(self, shares: FloatArray) -> FloatArray:
        """Mean loss (S,) that each site causes a mixture."""
        known = len(shares)  # routes may have joined since
        sites, counts = (np.concatenate(each[:known]) for each in (self._met, self._counts))
        weight = np.repeat(shares, list(map(len, self._met[:known]))) * counts
        return self.loss * np.bincount(sites, weight, len(self.loss))

    def caps(self, shares: FloatArray, gap: float) -> FloatArray:
        """Caps (S,): loss that each site may cause; the k largest add up to the mixture's value.

        With several ambushers the mixture may miss a site altogether, which no route distribution
        can; so all sites may cause a small share of the value alike, which grows with the relative
        ``gap``.
        """
        losses, even = self.losses(shares), EVEN * gap
        largest = np.sort(losses)[-self.ambushers :]
        caps = np.maximum(losses, largest.min(initial=math.inf))
        return np.asarray((1.0 - even) * caps + even * largest.sum() / max(self.ambushers, 1))

    def value(self, shares: FloatArray) -> float:
        """The sum of the k largest losses."""
        return float(np.sort(self.losses(shares))[len(self.loss) - self.ambushers :].sum())

    def flow(self, shares: FloatArray, edges: int) -> FloatArray:
        """Expected uses (M,) of the edges."""
        routes = self.routes[: len(shares)]
        return sums(np.concatenate(routes), np.repeat(shares, list(map(len, routes))), edges)

    def of_least_reduced_cost(self) -> Mixture:
        """The mixture whose greatest reduced cost is least: that is its value.

        Its prices are how much each budget counts in it.
        """
        reduced_cost = np.array(self._reduced_cost).T
        rows = np.column_stack((reduced_cost, -np.ones(len(reduced_cost))))
        cost, each = np.zeros(rows.shape[1]), np.ones((1, rows.shape[1]))
        cost[-1], each[0, -1] = 1.0, 0.0
        result = _solved(highs.LP(cost, csr_matrix(rows), np.zeros(len(reduced_cost)),
                                       csr_matrix(each), np.ones(1)), highs.OPTIMALITY[0], math.inf)
        weights = np.maximum(-np.asarray(result.ineqlin.marginals), 0.0)
        return Mixture(float(result.fun), np.maximum(result.x[:-1], 0.0),
                       np.zeros((self._groups, len(self.loss))), weights)

    def solve(self, precision: float, deadline: float = math.inf) -> Mixture:
        """The mixture of least value, to a relative gap of ``precision``.

        A site has a row in the LP once its losses have come near the value. Raises TimeLimit
        at ``deadline`` (``time.monotonic``), or SolverFailed.
        """
        group, near, cap = np.array(self._group), self._near.ravel(), math.inf
        # In a unit near the value, to which the solver's tolerances are relative.
        most = float(self.loss.max(initial=0.0)) or 1.0
        unit = self._unit if self._unit > NEGLIGIBLE * most else most
        hit, shares = self._hits(group) / unit, 1.0 / np.bincount(group)[group]
        losses = hit @ shares
        while True:
            largest = np.sort(losses)[-self.ambushers :]
            if cap < math.inf or not near.any():
                near = near | (losses > min(NEAR * largest.min(initial=math.inf), cap))
            result = self._solve_on(hit[near], group, precision, deadline)
            shares, cap = np.maximum(result.x[: len(group)], 0.0), float(result.x[len(group)])
            shares /= np.bincount(group, shares)[group]
            losses = hit @ shares
            if not (losses > cap * (1.0 + precision))[~near].any():
                break
        self._near = (losses > NEAR * cap).reshape(self._groups, -1)
        self._unit = float(result.fun) * unit
        duals, q = np.maximum(-np.asarray(result.ineqlin.marginals), 0.0), np.zeros(len(near))
        q[near], prices = np.split(duals, [np.count_nonzero(near)])
        return Mixture(self._unit, shares, q.reshape(self._groups, -1), prices * unit)

    def _hits(self, group: IndexArray) -> csr_matrix:
        """The loss (groups * S, C) that each route has at each site of its group."""
        size, sites = list(map(len, self._met)), np.concatenate(self._met)
        column, count = np.repeat(np.arange(len(size)), size), len(self.loss)
        losses = self.loss[sites] * np.concatenate(self._counts)
        return csr_matrix((losses, (group[column] * count + sites, column)),
                          (self._groups * count, len(size)))

    def _solve_on(self, hit: csr_matrix, group: IndexArray, precision: float,
                  deadline: float) -> OptimizeResult:
        """Solve the LP with the rows (R, C) of some sites."""
        (rows, count), extra = hit.shape, hit.shape[0] * (self.ambushers > 1)
        limits = csr_matrix(hstack([hit, csr_matrix(-np.ones((rows, 1))),
                                    -identity(rows, format='csr')[:, :extra]]))
        reduced_cost = csr_matrix(np.array(self._reduced_cost).T)
        reduced_cost.resize(reduced_cost.shape[0], limits.shape[1])
        begin, end = np.array(self._between).T
        stops, inner = end.max(), np.flatnonzero(end < end.max())
        flow = csr_matrix((np.append(np.ones(count), -np.ones(len(inner))),
                           (np.append(begin, end[inner]), np.append(np.arange(count), inner))),
                          (stops, limits.shape[1]))
        cost = np.repeat([0.0, self.ambushers, 1.0], [count, 1, extra])
        bounds = np.repeat([0.0, self.limit], [rows, reduced_cost.shape[0]])
        return _solved(highs.LP(cost, csr_matrix(vstack([limits, reduced_cost])), bounds, flow,
                                     np.eye(1, stops)[0]), precision, deadline)


def _solved(lp: highs.LP, precision: float, deadline: float) -> OptimizeResult:
    try:
        result = highs.run(lp, 'interior_point', deadline, False, precision)
    except SolverFailed:
        result = highs.run(lp, 'simplex', deadline)
    if result.x is None:
        raise SolverFailed('no mixture of the known routes is within the budgets')
    return result
