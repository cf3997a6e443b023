# SPDX-License-Identifier: Apache-2.0
"""The least value of legs if every entry into a site's reach is a hit: a linear program in edges.

    minimise z   subject to   alpha_j times the entries of all legs at site j <= z,
                              a unit flow for each leg, within its length budget.

Entries are hits if simple routes enter a site's reach at most once: without a reach.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import block_diag, csr_matrix, hstack, vstack

from ...arrays import NEGLIGIBLE, FloatArray
from ..ambusher import Ambush
from ..certificate.certificate import lower_bounds
from ..distribution.chain import conserved_strategy
from ..legs import Legs
from ..route_sampler import shortest_route_strategy
from ..tolerance import ROUNDS
from . import highs
from .cut import solve_by_min_cut
from .linear_program import ORDINARY, conservation


class EdgeFlows:
    """LP in the edges of all legs; until it is solved, its strategies are the shortest routes."""

    def __init__(self, legs: Legs, gap: float) -> None:
        self._legs, self._gap, self.bound = legs, gap, 0.0
        self._use([shortest_route_strategy(game, budget.cost)
                   for game, budget in zip(legs.games, legs.budgets, strict=True)])
        self.ambush = Ambush(np.zeros(len(legs.loss)), np.zeros(len(legs.games)))
        self._solved = False

    def _use(self, strategies: list[FloatArray]) -> None:
        self.flow = np.concatenate(strategies)
        losses = self._legs.loss * (self._legs.entering @ self.flow)
        self.value = float(losses.max(initial=0.0))

    def add_sites(self, entering: csr_matrix, loss: FloatArray) -> None:
        """Do nothing: all sites are nodes of the network."""

    def solve_by_max_flow(self) -> bool:
        """Solve it for a single leg by a maximum flow; return whether that keeps the budget."""
        (game,), (budget,) = self._legs.games, self._legs.budgets
        cut = solve_by_min_cut(game)
        self._solved = budget.keeps(cut.p)
        if self._solved:
            self.flow, self.value, self.bound = cut.p, cut.value, cut.value
            self.ambush = Ambush(cut.q[game.sites], np.zeros(1))
        return self._solved

    def solve(self, deadline: float) -> None:
        """Solve it; raises TimeLimit at the ``deadline`` (``time.monotonic``), or SolverFailed."""
        if self._solved:
            return
        legs, unit = self._legs, self.value
        if (safe := legs.avoiding(legs.entering)) is not None:
            self._use([shortest_route_strategy(game, budget.cost)
                       for game, budget in zip(safe.games, safe.budgets, strict=True)])
            self._solved = True
            return
        for _ in range(ROUNDS):
            lp, edges = self._linear_program(unit)
            result = highs.run_either(lp, 'interior_point', deadline, precision=self._gap)
            value = float(result.x[-1])
            if value > 1.0 / ORDINARY:
                break
            unit *= max(value, NEGLIGIBLE)
        p, found = np.zeros(legs.edge_count), []
        p[edges] = result.x[:-1]
        for game, leg_p in zip(legs.games, legs.split(p), strict=True):
            conserved = conserved_strategy(game, leg_p, NEGLIGIBLE)
            assert conserved is not None
            found.append(conserved)
        self._use(found)
        duals = np.maximum(-np.asarray(result.ineqlin.marginals), 0.0)
        q, prices = np.split(duals, [len(legs.loss)])
        margins = np.array([budget.margin for budget in legs.budgets])
        total = float(q.sum())
        prices = np.where(np.isfinite(margins), prices / margins, 0.0) * unit / total
        for k, budget in enumerate(legs.budgets):
            if budget.allows_only_shortest:
                prices[k] = max(prices[k], budget.deterring_price(self.value))
        self.ambush = Ambush(q / total, prices)
        ambusher = self.ambush.ambusher(legs.games[0], np.ones(len(q), dtype=bool))
        self.bound, self._solved = float(lower_bounds(legs, ambusher).sum()), True

    def _linear_program(self, unit: float) -> tuple[highs.LP, np.ndarray]:
        """Build the LP in (p, z / unit); returns also the edges (m,) of p."""
        legs, count = self._legs, len(self._legs.games)
        edges = np.flatnonzero(np.concatenate([game.playable for game in legs.games]))
        flows, nodes = zip(*map(conservation, legs.games), strict=True)
        supply = np.concatenate([node == game.network.source
                                 for game, node in zip(legs.games, nodes, strict=True)])
        sites = hstack([csr_matrix(legs.entering.multiply(legs.loss[:, None] / unit))[:, edges],
                        csr_matrix(-np.ones((len(legs.loss), 1)))])
        margins = block_diag([csr_matrix(budget.used_margin[game.playable])
                              for game, budget in zip(legs.games, legs.budgets, strict=True)])
        budgets = hstack([margins, csr_matrix((count, 1))])
        return highs.LP(
            np.append(np.zeros(len(edges)), 1.0), csr_matrix(vstack([sites, budgets])),
            np.append(np.zeros(len(legs.loss)), np.ones(count)),
            csr_matrix(hstack([block_diag(flows), csr_matrix((len(supply), 1))])),
            supply.astype(np.float64)), edges
