# SPDX-License-Identifier: Apache-2.0
"""The least value by a linear program over whole routes, each hit once by each site.

Column generation: the best mixture of the known routes of each leg gives an ambusher's strategy and
prices of the budgets (``mixtures``). Pricing finds routes of each leg that cost less against these
than those in use: first the shortest ones with every entry counted, then by label setting, which
also proves bounds (``best_response``), against ambushers who wait at few sites.
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

    loose: float = 5e-2  # relative gap of the master problems while routes join
    tight: float = 1e-4  # the same once none does
    gain: float = 0.25  # share of the wanted gap by which a route must cost less to join
    # Where sites can be met twice, it is at least this share of the open gap. After ``ROUNDS``
    # rounds in which that falls by less than ``gain`` of the wanted gap, loose LPs become tight,
    # and tight ones end.
    open_gain: float = 0.5
    comparisons: int = 1_000_000  # of labels in a search
    # Share of the largest site price below which label searches leave out sites. Few sites make a
    # search fast, but each that is left out weakens it.
    small: float = 3e-3
    site_spacing: float = 0.25  # minimum distance between sites added at once [reaches]


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
    """

    site_spacing = ROUTES.site_spacing

    def __init__(self, legs: Legs, gap: float) -> None:
        self.legs, self._gap, count = legs, gap, len(legs.games)
        self._margins = [budget.used_margin for budget in legs.budgets]
        self._mixtures = Mixtures()
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

        Raises TimeLimit at the ``deadline`` (``time.monotonic``), or SolverFailed; what was found
        until then counts.
        """
        if not len(self.loss):
            self.value = 0.0
            return
        precision, tight, rounds = ROUTES.loose, min(ROUTES.tight, self._gap / 2.0), 0
        open_gap, stalled, exact = math.inf, 0, self.legs.no_reentry
        while True:
            mixture = self._mixtures.solve(precision, deadline)
            self._shares = mixture.shares
            self.value = self._mixtures.value(self._shares)
            if self._done(deadline):
                return
            rounds, stalled = rounds + 1, stalled + 1
            if self.value - self.bound < open_gap - ROUTES.gain * self._gap * self.value:
                open_gap, stalled = self.value - self.bound, 0
            if stalled > ROUNDS and precision == tight:
                return
            duals = [mixture]
            if precision == tight and not exact:
                # Searches are faster and prove more for a vertex, which jumps: both take turns.
                vertex = self._mixtures.solve(precision, deadline, vertex=True)
                if not vertex.q.any():  # it meets no site
                    self._shares, self.value = vertex.shares, self._mixtures.value(vertex.shares)
                    return
                duals = [mixture, vertex][:: 1 if rounds % 2 else -1]
            searching = precision == tight and not exact
            if any(searching and self._price(each, self._by_labels, deadline)
                   or self._price(each, self._by_entries, deadline) for each in duals):
                if self._done(deadline):
                    return
                if stalled <= ROUNDS:
                    continue
            if self._done(deadline) or precision == tight:
                return
            precision, stalled = tight, 0

    def _done(self, deadline: float) -> bool:
        rounding = ROUNDING * float(self.loss.max(initial=0.0))
        if within(self.value, max(self.bound, rounding), self._gap):
            return True
        if time.monotonic() > deadline:
            raise TimeLimit('the time limit passed before the value was proved')
        return False

    def _price(self, mixture: Mixture, best_route: BestRoute, deadline: float) -> int:
        """Add routes of each leg that cost less than those in use, and note what is proved."""
        q, total = mixture.q, float(mixture.q.sum())
        if not total > 0.0:
            return 0
        q, prices = q / total, mixture.prices / total
        site_prices = q * self.loss
        if best_route == self._by_labels:
            site_prices = np.where(site_prices > ROUTES.small * site_prices.max(), site_prices, 0.0)
        # A route must cost less than what its leg pays, by its share of the gain.
        gain = ROUTES.gain * self._gap
        if self.bound > 0.0 and not self.legs.no_reentry:
            gain = max(gain, ROUTES.open_gain * (1.0 - self.bound / self.value))
        most = mixture.costs / total - gain * self.value / len(self._networks)
        added, least = 0, 0.0
        for leg, network in enumerate(self._networks):
            base = prices[leg] * self._margins[leg]
            bound, route = best_route(network, base, site_prices, deadline)
            least += bound
            if route is not None and network.cost(route, base, site_prices) < most[leg]:
                added += self.add_route(leg, route)
        kept = np.where(site_prices > 0.0, q, 0.0)
        bound, waits = least - float(prices.sum()), float(kept.sum())
        if bound > self.bound * waits:
            margins = np.array([budget.margin for budget in self.legs.budgets])
            self.bound, self.q = bound / waits, kept / waits
            self.prices = np.where(np.isfinite(margins), prices / margins, 0.0) / waits
        return added

    def _by_entries(self, network: Subnetwork, base: FloatArray, site_prices: FloatArray,
                    deadline: float) -> tuple[float, IndexArray | None]:
        """The shortest route with every entry counted; it proves a bound if entries are hits."""
        route = network.shortest(base, site_prices)
        exact = self.legs.no_reentry
        return network.cost(route, base, site_prices) if exact else -math.inf, route

    def _by_labels(self, network: Subnetwork, base: FloatArray, site_prices: FloatArray,
                   deadline: float) -> tuple[float, IndexArray | None]:
        return network.least_cost(base, site_prices, LABELS, deadline)


# Finds a lower bound of the cost of a leg's routes, and a route that costs little.
BestRoute = Callable[[Subnetwork, FloatArray, FloatArray, float],
                     tuple[float, 'IndexArray | None']]
