# SPDX-License-Identifier: Apache-2.0
"""The restricted master problem: the best mixture of the known routes of each leg.

    minimise z   subject to   mean loss at site j, added up over the legs, <= z,
                              mean used margin of each leg's length budget <= 1,
                              the shares of each leg's routes add up to 1,

each route hit once by each site. The duals are the ambusher's strategy, the prices of the budgets,
and what a route of each leg costs at the optimum. HiGHS' interior point method without crossover
gives *central* duals, which price many routes at once; a vertex jumps from one extreme ambusher to
another, but waits at few sites.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.sparse import csr_matrix, hstack, vstack

from ...arrays import NEGLIGIBLE, FloatArray, IndexArray, sums
from ...errors import SolverFailed
from ..distribution.chain import RouteMixture
from . import highs

if TYPE_CHECKING:
    from scipy.optimize import OptimizeResult

# Share of the value from which on a site's losses are near it.
NEAR = 0.9


class Mixture(NamedTuple):
    """Shares (C,) of the routes, and the duals.

    These are the ambusher's q (S,), the prices (legs,) of the budgets' margins, and the costs
    (legs,) of the routes that are used.
    """

    shares: FloatArray
    q: FloatArray
    prices: FloatArray
    costs: FloatArray


def mixture_lp(hit: csr_matrix, leg: IndexArray, used: FloatArray) -> highs.LP:
    """The LP in the shares of columns (C,), each of a leg, and z.

    ``hit`` (S, C) is their loss at each site, ``used`` (C,) what they take of their leg's budget.
    """
    (rows, count), legs = hit.shape, int(leg.max()) + 1
    one = csr_matrix((np.ones(count), (leg, np.arange(count))), (legs, count + 1))
    sites = hstack([hit, csr_matrix(-np.ones((rows, 1)))])
    return highs.LP(np.append(np.zeros(count), 1.0),
                    csr_matrix(vstack([sites, one.multiply(np.append(used, 0.0))])),
                    np.append(np.zeros(rows), np.ones(legs)), one, np.ones(legs))


class _Column(NamedTuple):
    """A route of a leg, given by its edges, the sites that it meets, and the margin it uses."""

    route: IndexArray
    leg: int
    met: IndexArray
    used_margin: float


class Mixtures:
    """The routes that are known, each of a leg, and the sites (S,)."""

    def __init__(self) -> None:
        self.loss, self._unit = np.zeros(0), 0.0
        self._near = np.zeros(0, dtype=bool)
        self._columns: list[_Column] = []
        self._known: set[bytes] = set()

    def add(self, route: IndexArray, leg: int, met: IndexArray, used_margin: float) -> bool:
        """Add a route, given by its edges, and the sites that it meets; return if it is new."""
        key = route.tobytes()
        if key in self._known:
            return False
        self._known.add(key)
        self._columns.append(_Column(route, leg, met, used_margin))
        return True

    def add_sites(self, entering: csr_matrix, loss: FloatArray) -> None:
        """Add sites with losses (K,) and the edges (K, M) that enter their discs."""
        met_by, count = csr_matrix(entering.T), len(self.loss)
        self.loss = np.append(self.loss, loss)
        self._near = np.append(self._near, np.zeros(len(loss), dtype=bool))
        for k, each in enumerate(self._columns):
            more = np.unique(met_by[each.route].indices) + count
            self._columns[k] = each._replace(met=np.append(each.met, more))

    def value(self, shares: FloatArray) -> float:
        """The largest mean loss that a site causes a mixture with the given shares."""
        known = self._columns[: len(shares)]  # routes may have joined since
        weight = np.repeat(shares, [len(each.met) for each in known])
        hits = sums(np.concatenate([each.met for each in known]), weight, len(self.loss))
        return float((self.loss * hits).max(initial=0.0))

    def law(self, shares: FloatArray) -> RouteMixture:
        """The routes, drawn with their shares."""
        known = self._columns[: len(shares)]
        return RouteMixture([each.route for each in known], shares,
                            np.array([each.leg for each in known]))

    def solve(self, precision: float, deadline: float = math.inf,
              vertex: bool = False) -> Mixture:
        """The mixture of least value, to a relative gap of ``precision``, with central duals.

        Or a ``vertex`` of the LP, which has few routes and few sites. A site has a row in the LP
        once its losses have come near the value. Raises TimeLimit at ``deadline``
        (``time.monotonic``), or SolverFailed.
        """
        leg = np.array([each.leg for each in self._columns])
        near, cap = self._near, math.inf
        # In a unit near the value, to which the solver's tolerances are relative.
        most = float(self.loss.max(initial=0.0)) or 1.0
        unit = self._unit if self._unit > NEGLIGIBLE * most else most
        met = [each.met for each in self._columns]
        sites, column = np.concatenate(met), np.repeat(np.arange(len(met)), list(map(len, met)))
        hit = csr_matrix((self.loss[sites] / unit, (sites, column)), (len(self.loss), len(met)))
        shares = 1.0 / np.bincount(leg)[leg]
        losses = hit @ shares
        while True:
            if cap < math.inf or not near.any():
                near = near | (losses > min(NEAR * losses.max(initial=0.0), cap))
            result = self._solve_on(hit[near], leg, precision, deadline, vertex)
            shares, cap = np.maximum(result.x[:-1], 0.0), float(result.x[-1])
            shares /= np.bincount(leg, shares)[leg]
            losses = hit @ shares
            if not (losses > cap * (1.0 + precision))[~near].any():
                break
        self._near = losses > NEAR * cap
        self._unit = float(result.fun) * unit
        duals, q = np.maximum(-np.asarray(result.ineqlin.marginals), 0.0), np.zeros(len(near))
        q[near], prices = np.split(duals, [np.count_nonzero(near)])
        return Mixture(shares, q, prices * unit, np.asarray(result.eqlin.marginals) * unit)

    def _solve_on(self, hit: csr_matrix, leg: IndexArray, precision: float, deadline: float,
                  vertex: bool) -> OptimizeResult:
        """Solve the LP with the rows (R, C) of some sites."""
        lp = mixture_lp(hit, leg, np.array([each.used_margin for each in self._columns]))
        first = 'simplex' if vertex else 'interior_point'
        result = highs.run_either(lp, first, deadline, False, precision)
        if result.x is None:
            raise SolverFailed('no mixture of the known routes is within the budgets')
        return result
