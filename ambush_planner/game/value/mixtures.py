# SPDX-License-Identifier: Apache-2.0
"""The restricted master problem: the best mixture of the known routes of each leg.

    minimise z   subject to   mean loss at site j, added up over the legs, <= z,
                              mean used margin of each leg's length budget <= 1,
                              the shares of each leg's routes add up to 1,

each route hit once by each site. The duals are the ambusher's strategy, the prices of the budgets,
and what a route of each leg costs at the optimum. The program stays in HiGHS' memory: routes join
as columns, and sites as rows once a mixture's losses there come near the value.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix, hstack, vstack

from ...arrays import ROUNDING, FloatArray, IndexArray, sums
from ..distribution.chain import RouteMixture
from . import highs
from .growing_program import ANY_SIMPLEX, GrowingProgram

# Share of the largest loss from which on sites join the program.
NEAR = 0.95
# Share of the program's unit below which the value becomes its unit: the solver's tolerances are
# relative to that.
SMALL = 0.1


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
    """The routes that are known, each of one of ``legs``, and the losses (S,) at the sites."""

    def __init__(self, legs: int) -> None:
        self.loss, self._legs = np.zeros(0), legs
        self._columns: list[_Column] = []
        self._known: set[bytes] = set()
        # The program has z in this unit, and these sites.
        self._unit, self._sites = math.inf, np.zeros(0, dtype=np.int64)

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
        for k, each in enumerate(self._columns):
            more = np.unique(met_by[each.route].indices) + count
            self._columns[k] = each._replace(met=np.append(each.met, more))

    def value(self, shares: FloatArray) -> float:
        """The largest mean loss that a site causes a mixture with the given shares."""
        return float(self._losses(shares).max(initial=0.0))

    def law(self, shares: FloatArray) -> RouteMixture:
        """The routes, drawn with their shares."""
        known = self._columns[: len(shares)]  # routes may have joined since
        return RouteMixture([each.route for each in known], shares,
                            np.array([each.leg for each in known]))

    def solve(self, deadline: float = math.inf) -> Mixture:
        """The mixture of least value, a vertex of the program.

        Raises TimeLimit at ``deadline`` (``time.monotonic``), or SolverFailed.
        """
        leg, legs = np.array([each.leg for each in self._columns]), self._legs
        if not len(self._sites):
            self._begin(float(self.loss.max(initial=0.0)) or 1.0)
            self._add_sites(self._losses(1.0 / np.bincount(leg)[leg]), 0.0)
        self._add_columns()
        while True:
            found = self._program.solve(deadline)
            z, shares = found.x[0] * self._unit, np.maximum(found.x[1:], 0.0)
            shares /= np.bincount(leg, shares)[leg]
            losses = self._losses(shares)
            if not self._add_sites(losses, z * (1.0 + ROUNDING) + ROUNDING * self._unit):
                break
        q, (costs, prices) = np.zeros(len(self.loss)), found.duals[: 2 * legs].reshape(2, legs)
        q[self._sites] = np.maximum(-found.duals[2 * legs :], 0.0)
        mixture = Mixture(shares, q, np.maximum(-prices, 0.0) * self._unit, costs * self._unit)
        if 0.0 < z < SMALL * self._unit:
            self._begin(z)
            self._add_sites(losses, 0.0)
        return mixture

    def _losses(self, shares: FloatArray) -> FloatArray:
        known = self._columns[: len(shares)]
        weight = np.repeat(shares, [len(each.met) for each in known])
        hits = sums(np.concatenate([each.met for each in known]), weight, len(self.loss))
        return np.asarray(self.loss * hits)

    def _begin(self, unit: float) -> None:
        """Begin the program again, without sites: z, and for each leg shares and a budget."""
        self._unit, self._sites = unit, np.zeros(0, dtype=np.int64)
        self._program, one = GrowingProgram(ANY_SIMPLEX, ROUNDING), np.ones(self._legs)
        rows = self._program.add_rows(np.append(one, np.full(self._legs, -math.inf)),
                                      np.append(one, one), csr_matrix((2 * self._legs, 0)))
        self._program.add_columns(np.ones(1), np.zeros(1), np.array([math.inf]),
                                  csr_matrix((1, len(rows))))

    def _add_columns(self) -> None:
        """Add the routes that are new to the program."""
        first = self._program.columns - 1
        new, none = self._columns[first:], np.zeros(len(self._columns) - first)
        if not new:
            return
        leg, each = np.array([column.leg for column in new]), np.arange(len(new))
        used = np.array([column.used_margin for column in new])
        shares = csr_matrix((np.ones(len(new)), (each, leg)), (len(new), self._legs))
        budgets = csr_matrix((used, (each, leg)), shares.shape)
        self._program.add_columns(none, none, np.full(len(new), math.inf), csr_matrix(
            hstack([shares, budgets, self._hit(first)[self._sites].T])))

    def _add_sites(self, losses: FloatArray, least: float) -> bool:
        """Let the sites join that cause more than ``least`` and nearly the most; True if any do."""
        new = np.setdiff1d(np.flatnonzero(losses > max(least, NEAR * losses.max(initial=0.0))),
                           self._sites)
        if not len(new):
            return False
        known = self._hit(0)[new][:, : self._program.columns - 1]
        self._program.add_rows(np.full(len(new), -math.inf), np.zeros(len(new)), csr_matrix(
            hstack([csr_matrix(-np.ones((len(new), 1))), known])))
        self._sites = np.append(self._sites, new)
        return True

    def _hit(self, first: int) -> csr_matrix:
        """The losses (S, C) that the sites cause each route from ``first`` on, in the unit."""
        met = [each.met for each in self._columns[first:]]
        sites, column = np.concatenate(met), np.repeat(np.arange(len(met)), list(map(len, met)))
        return csr_matrix((self.loss[sites] / self._unit, (sites, column)),
                          (len(self.loss), len(met)))
