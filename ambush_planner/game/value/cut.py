# SPDX-License-Identifier: Apache-2.0
"""The exact value of the plain game: a maximum flow with node capacities 1 / alpha.

A strategy p has value z(p) <= z exactly when every node's visits are at most z / alpha_j. Scaled
by 1 / z it is a flow of size 1 / z under the capacities 1 / alpha_j, so the least z is one over
the maximum flow. An ambusher spread over a minimum cut in proportion to 1 / alpha_j causes every
route a mean loss of at least one over the cut's capacity. Both are optimal.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import breadth_first_order, maximum_flow

from ...arrays import BoolArray, FloatArray, sums
from ...errors import SolverFailed
from ..distribution.acyclic import without_cycles
from ..distribution.chain import NO_FLOW
from ..game import Game
from ..route_sampler import shortest_route_strategy
from ..tolerance import ROUNDS

# scipy's maximum flow takes int32. Capacities are scaled so that the missing flow stays below this,
# a quarter of them; several rounds on the residual network reach double precision.
INTEGER_FLOW = (np.iinfo(np.int32).max + 1) / 2**2


@dataclass(frozen=True, eq=False)
class CutSolution:
    """Value z, an acyclic optimal strategy p (M,), and the ambusher's q (N,), 0 if z is 0."""

    value: float
    p: FloatArray
    q: FloatArray


def solve_by_min_cut(game: Game) -> CutSolution:
    """Solve the game of one leg without a reach or a budget by a maximum flow and a minimum cut.

    Raises SolverFailed if the game has a reach.
    """
    if game.reach > 0.0:
        raise SolverFailed('a cut solves games without a reach')
    safe = game.avoiding(game.entering)
    if safe is not None:
        return CutSolution(0.0, shortest_route_strategy(safe), np.zeros(game.node_count))
    return _solve_by_rounds(game)


def _solve_by_rounds(game: Game) -> CutSolution:
    """Augment an integer flow at finer and finer scales, until it is exact in floating point."""
    split = _SplitNetwork(game)
    # All sites together are a cut, as no route avoids them all.
    flow, sites = np.zeros(len(split.edge)), game.loss > 0.0
    best, best_cut = float((1.0 / game.loss[sites]).sum()), sites
    for _ in range(ROUNDS):
        total = split.total(flow)
        flow, cut = split.augment(flow, INTEGER_FLOW / (best - total))
        capacity = float((1.0 / game.loss[cut]).sum())
        if capacity < best:
            best, best_cut = capacity, cut
        if split.feasible_total(flow) >= best * (1.0 - NO_FLOW) or best <= split.total(flow):
            break
    p = np.zeros(len(game.network.edges))
    p[split.edge] = flow
    p = without_cycles(game.network, p)
    p /= p[game.network.tails == game.network.source].sum()
    q = np.zeros(game.node_count)
    q[best_cut] = 1.0 / game.loss[best_cut]
    return CutSolution(float(1.0 / q.sum()), p, q / q.sum())


class _SplitNetwork:
    """The network with every node split into an entry and an exit joined by its capacity."""

    def __init__(self, game: Game) -> None:
        network, n = game.network, game.node_count
        self.game = game
        self.edge = np.flatnonzero(game.playable)
        tail, head = network.edges[self.edge].T
        on_route = np.zeros(n, dtype=bool)
        on_route[tail] = on_route[head] = True
        self.node = used = np.flatnonzero(on_route)
        begin, end = np.concatenate((n + tail, used)), np.concatenate((head, n + used))
        rows = np.concatenate((begin, end)).astype(np.int32)
        columns = np.concatenate((end, begin)).astype(np.int32)
        # All rounds share one sparsity pattern: entry k of rows and columns is data[place[k]].
        size = len(rows)
        self._pattern = csr_matrix((np.arange(1, size + 1), (rows, columns)), shape=(2 * n, 2 * n))
        self._place = np.empty(size, dtype=np.int64)
        self._place[self._pattern.data - 1] = np.arange(size)
        self._heads, self._tails = head, tail
        with np.errstate(divide='ignore'):
            self._capacity = 1.0 / game.loss[used]

    def total(self, flow: FloatArray) -> float:
        """Size of the flow."""
        return float(flow[self._tails == self.game.network.source].sum())

    def visits(self, flow: FloatArray) -> FloatArray:
        """Flow through each used node."""
        n = self.game.node_count
        x = sums(self._heads, flow, n)
        x[self.game.network.source] = self.total(flow)
        return x[self.node]

    def feasible_total(self, flow: FloatArray) -> float:
        """Size of the flow after it is scaled to respect every capacity in floating point."""
        overload = float((self.visits(flow) / self._capacity).max(initial=0.0))
        return self.total(flow) / max(overload, 1.0)

    def augment(self, flow: FloatArray, scale: float) -> tuple[FloatArray, BoolArray]:
        """Add a maximum flow of the residual network, whose capacities are scaled to integers.

        Returns the new flow, and the nodes (N,) of a minimum cut of the scaled residual network.
        """
        network, n, m = self.game.network, self.game.node_count, len(self.edge)
        x = self.visits(flow)
        forward = np.concatenate((np.full(m, np.inf), np.maximum(self._capacity - x, 0.0)))
        backward = np.concatenate((flow, x))
        # The missing flow is below INTEGER_FLOW, so an unlimited arc never fills up.
        limits = np.minimum(np.concatenate((forward, backward)) * scale, 2.0 * INTEGER_FLOW)
        graph = csr_matrix(
            (np.empty(len(limits), np.int32), self._pattern.indices, self._pattern.indptr),
            shape=self._pattern.shape,
        )
        graph.data[self._place] = limits.astype(np.int32)
        pushed = maximum_flow(graph, n + network.source, network.target).flow
        gained = pushed.data[self._place[:m]] / scale
        residual = (graph - pushed).tocsr()
        residual.eliminate_zeros()
        reached = np.zeros(2 * n, dtype=bool)
        reached[breadth_first_order(residual, n + network.source, return_predecessors=False)] = True
        cut = reached[:n] & ~reached[n:]  # the entry can be reached, the exit cannot
        cut[[network.source, network.target]] = False
        return np.maximum(flow + gained, 0.0), cut
