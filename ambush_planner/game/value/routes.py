# SPDX-License-Identifier: Apache-2.0
"""The least value by a linear program over whole routes, each hit once by each site.

Column generation: the best mixture of the known routes of each leg gives an ambusher's strategy and
prices of the budgets (``mixtures``). Pricing finds routes of each leg that cost less against these
than those in use: first the shortest ones with every entry counted, then by label setting, which
also proves bounds (``best_response``), but is slow. So it begins once the sites that matter are
known, after ``rough`` rounds.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix, vstack

from ...arrays import NEGLIGIBLE, ROUNDING, FloatArray, IndexArray
from ...errors import TimeLimit
from ..ambusher import Ambush
from ..certificate.best_response import SEARCHES, Searches, Subnetwork
from ..distribution.chain import RouteMixture, conserved_strategy
from ..legs import Legs
from ..tolerance import ROUNDS, within
from .mixtures import Mixture, Mixtures


class ColumnGeneration(NamedTuple):
    """The constants of the linear program over routes."""

    # Relative gap at which rough rounds end, from what any routes cost if every entry counts.
    rough: float = 0.02
    gain: float = 0.25  # share of the wanted gap by which a route must cost less to join
    comparisons: int = 1_000_000  # of labels in a search
    apart: float = 0.25  # minimum distance of sites that join at once, as a share of the reach


ROUTES = ColumnGeneration()
LABELS: Searches = tuple((kept, ROUTES.comparisons) for kept, _ in SEARCHES[:2])


class Routes:
    """The least value by a linear program over the routes of legs; it only grows.

    Attributes
    ----------
    bound : float
        No strategy has a smaller value, as the ambusher proves who waits at the sites by ``q``
        (S,) and has the ``prices`` (legs,) of the budgets.
    value : float
        That of the ``mixture`` found.
    rough : bool
        Whether ``solve`` ends near the least value, without a proof.
    """

    apart = ROUTES.apart

    def __init__(self, legs: Legs, gap: float) -> None:
        self.legs, self._gap, count = legs, gap, len(legs.games)
        self._margins = [budget.used_margin for budget in legs.budgets]
        self._mixtures, self.rough = Mixtures(count), False
        self.bound, self.value, self._shares = 0.0, math.inf, np.zeros(0)
        self.q, self.prices = np.zeros(0), np.zeros(count)
        self.entering = csr_matrix((0, legs.edge_count))
        self.add_sites(legs.entering, legs.loss)
        free = np.zeros(len(self.loss))
        for leg, network in enumerate(self._networks):
            base = self._margins[leg]
            if not legs.budgets[leg].is_limited:
                base = legs.games[leg].network.lengths
            self.add_route(leg, network.shortest(base, free))
        self._shares = np.ones(count)
        self.value = self._mixtures.value(self._shares)

    def add_sites(self, entering: csr_matrix, loss: FloatArray) -> None:
        """Add sites with losses (K,) and the edges (K, M) that enter their discs."""
        self.entering = csr_matrix(vstack((self.entering, entering)))
        self._networks = [Subnetwork(game, rows) for game, rows in zip(
            self.legs.games, self.legs.rows_by_leg(self.entering), strict=True)]
        self._mixtures.add_sites(entering, loss)
        self.loss = self._mixtures.loss
        self.q = np.append(self.q, np.zeros(len(loss)))
        if len(self._shares):
            self.value = self._mixtures.value(self._shares)

    def add_route(self, leg: int, route: IndexArray) -> bool:
        """Add a route of a leg, given by that leg's edges; return whether it is new."""
        return self._mixtures.add(route + self.legs.first[leg], leg,
                                  self._networks[leg].met(route),
                                  float(self._margins[leg][route].sum()))

    @property
    def mixture(self) -> RouteMixture:
        """The routes and their shares."""
        return self._mixtures.law(self._shares)

    @property
    def flow(self) -> FloatArray:
        """The mixture as acyclic strategies (M,) of the legs, within their budgets."""
        found = []
        used = self.mixture.uses(self.legs.edge_count)
        for leg, (game, p) in enumerate(zip(self.legs.games, self.legs.split(used), strict=True)):
            over = float(self._margins[leg] @ p) - 1.0
            if over > 0.0:  # as far as the LP's precision allows
                inside = np.zeros(len(p))
                inside[self._networks[leg].shortest(self._margins[leg],
                                                    np.zeros(len(self.loss)))] = 1.0
                p = inside + 1.0 / (1.0 + over) * (p - inside)
            conserved = conserved_strategy(game, p, NEGLIGIBLE)
            assert conserved is not None  # one route of n has a share of 1 / n or more
            found.append(conserved)
        return np.concatenate(found)

    @property
    def ambush(self) -> Ambush:
        """The ambusher who proves the bound."""
        return Ambush(self.q, self.prices)

    def solve(self, deadline: float) -> None:
        """Let routes join until the value is within the gap of the bound, or none costs less.

        Or until the bound and the value have hardly come nearer to each other in ``ROUNDS`` rounds.
        Raises TimeLimit at the ``deadline`` (``time.monotonic``), or SolverFailed; what was found
        until then counts.
        """
        if not len(self.loss):
            self.value = 0.0
            return
        by_labels = not (self.rough or self.legs.no_reentry)
        open_gap, stalled, by_entries = math.inf, 0, 0.0
        while stalled <= ROUNDS:
            mixture = self._mixtures.solve(deadline)
            self._shares = mixture.shares
            self.value = self._mixtures.value(self._shares)
            if self._done(deadline) or self.rough and within(self.value, by_entries, ROUTES.rough):
                return
            stalled += 1
            if self.value - self.bound < open_gap - ROUTES.gain * self._gap * self.value:
                open_gap, stalled = self.value - self.bound, 0
            least, joined = self._price(mixture, self._by_entries, deadline)
            by_entries = max(by_entries, least)
            if not joined and by_labels:
                joined = self._price(mixture, self._by_labels, deadline)[1]
            if self._done(deadline) or not joined:
                return

    def _done(self, deadline: float) -> bool:
        rounding = ROUNDING * float(self.loss.max(initial=0.0))
        if within(self.value, max(self.bound, rounding), self._gap):
            return True
        if time.monotonic() > deadline:
            raise TimeLimit('the time limit passed before the value was proved')
        return False

    def _price(self, mixture: Mixture, best_route: BestRoute, deadline: float) -> tuple[float, int]:
        """Add routes of each leg that cost less than those in use.

        Returns what all legs cost at least, as ``best_route`` counts, and the number of new routes.
        A proof is kept.
        """
        q, prices, site_prices = mixture.q, mixture.prices, mixture.q * self.loss
        # A route must cost less than what its leg pays, by its share of the gain.
        most = mixture.costs - ROUTES.gain * self._gap * self.value / len(self._networks)
        added, least = 0, -float(prices.sum())
        for leg, network in enumerate(self._networks):
            base = prices[leg] * self._margins[leg]
            bound, route = best_route(network, base, site_prices, deadline)
            least += bound
            if route is not None and network.cost(route, base, site_prices) < most[leg]:
                added += self.add_route(leg, route)
        waits, proved = float(q.sum()), best_route == self._by_labels or self.legs.no_reentry
        if proved and least > self.bound * waits:
            margins = np.array([budget.margin for budget in self.legs.budgets])
            self.bound, self.q = least / waits, q / waits
            self.prices = np.where(np.isfinite(margins), prices / margins, 0.0) / waits
        return least, added

    def _by_entries(self, network: Subnetwork, base: FloatArray, site_prices: FloatArray,
                    deadline: float) -> tuple[float, IndexArray]:
        """The shortest route, and its cost, with every entry counted."""
        route = network.shortest(base, site_prices)
        return float(base[route].sum() + (site_prices @ network.hits)[route].sum()), route

    def _by_labels(self, network: Subnetwork, base: FloatArray, site_prices: FloatArray,
                   deadline: float) -> tuple[float, IndexArray | None]:
        return network.least_cost(base, site_prices, LABELS, deadline)


# Finds the least cost of a leg's routes, or a lower bound, and a route that costs little.
BestRoute = Callable[[Subnetwork, FloatArray, FloatArray, float],
                     tuple[float, 'IndexArray | None']]
