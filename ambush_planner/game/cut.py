"""The exact value of the plain game: a maximum flow with node capacities 1 / alpha.

A strategy p has value z(p) <= z exactly when every node's visits stay below z / alpha_j. Scaled by
1 / z it is a flow of size 1 / z under the capacities 1 / alpha_j, so the least z is one over the
maximum flow; and an ambusher who spreads himself over a minimum cut in proportion to 1 / alpha_j
meets every route with a mean loss of at least one over the cut's capacity. Both are optimal.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import breadth_first_order, maximum_flow

from ..arrays import BoolArray, FloatArray, IndexArray, sums
from ..errors import SolverFailed
from .acyclic import without_cycles
from .game import Game
from .route_sampler import always_shortest

# scipy's maximum flow counts in int32. Capacities are scaled so that the flow that is still
# missing stays below this; several rounds on the residual network give the digits of a double.
INTEGER_FLOW = 2**29
MAX_ROUNDS = 12
RELATIVE_GAP = 1e-13


@dataclass(frozen=True, eq=False)
class GameValue:
    """Value z, an acyclic optimal strategy p (M,), the ambusher's q (N,), the cut's nodes."""

    value: float
    p: FloatArray
    q: FloatArray
    cut: IndexArray


def solve_by_cut(game: Game) -> GameValue:
    """Solve the plain game (one ambusher, radius 0, no budget) by a minimum node cut.

    Where a trip has several legs, the copies of a place are taken for sites of their own: the value
    is that of the costliest leg, a lower bound, and q has probabilities at copies.

    Raises
    ------
    SolverFailed
        The game has a reach or several ambushers, or the flow and the cut do not meet.
    """
    if game.ambush_radius > 0.0 or game.ambushers > 1:
        raise SolverFailed('a cut solves games of one ambusher without a reach')
    safe = game.past_all_sites()
    if safe is not None:
        q, nobody = indifferent_ambusher(game), np.empty(0, dtype=np.int64)
        return GameValue(0.0, always_shortest(safe), q, nobody)
    return _solve_by_rounds(game, _SplitNetwork(game))


def indifferent_ambusher(game: Game) -> FloatArray:
    """Any q is optimal when the value is 0: spread over the sites, or over all nodes."""
    q = np.zeros(game.node_count)
    q[game.sites if len(game.sites) >= game.ambushers else slice(None)] = 1.0
    return q * (game.ambushers / q.sum())


def _solve_by_rounds(game: Game, split: _SplitNetwork) -> GameValue:
    flow, bound = np.zeros(len(split.edge)), _cut_bound(game)
    best: tuple[float, BoolArray] = (np.inf, np.zeros(game.node_count, dtype=bool))
    for _ in range(MAX_ROUNDS):
        total = split.total(flow)
        flow, cut = split.augment(flow, INTEGER_FLOW / (bound - total))
        capacity = float((1.0 / game.loss[cut]).sum())
        if capacity < best[0]:
            best = capacity, cut
        bound = best[0]
        if split.feasible_total(flow) >= bound * (1.0 - RELATIVE_GAP) or bound <= split.total(flow):
            break
    return _finish(game, split, flow, best[1])


def _cut_bound(game: Game) -> float:
    """Capacity of the best cut among the layers of sites: the k-th site on the way from s.

    Every route passes a site of each layer up to the least number of sites on any route.
    """
    network = game.network
    is_site = game.loss > 0.0
    depth = game.distances_ahead(is_site[network.heads].astype(np.float64))
    reached = is_site & np.isfinite(depth)
    capacity = np.bincount(depth[reached].astype(np.int64), weights=1.0 / game.loss[reached])
    return float(capacity[1 : int(depth[network.target]) + 1].min())


class _SplitNetwork:
    """The network with every node split into an entry and an exit joined by its capacity."""

    def __init__(self, game: Game) -> None:
        network, n = game.network, game.node_count
        self.game = game
        self.edge = np.flatnonzero(game.playable)
        tail, head = network.edges[self.edge].T
        on_route = np.zeros(n, dtype=bool)
        on_route[tail] = on_route[head] = True
        used = np.flatnonzero(on_route)
        self.node = used
        forward = np.concatenate((n + tail, used)), np.concatenate((head, n + used))
        self._rows = np.concatenate((forward[0], forward[1])).astype(np.int32)
        self._columns = np.concatenate((forward[1], forward[0])).astype(np.int32)
        # One sparsity pattern for all rounds: entry k of the arrays above is data[place[k]].
        size = len(self._rows)
        pattern = csr_matrix(
            (np.arange(1, size + 1), (self._rows, self._columns)), shape=(2 * n, 2 * n)
        )
        self._place = np.empty(size, dtype=np.int64)
        self._place[pattern.data - 1] = np.arange(size)
        self._pattern = pattern
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
        """Size of the flow after scaling it to respect every capacity in floating point."""
        overload = float((self.visits(flow) / self._capacity).max(initial=0.0))
        return self.total(flow) / max(overload, 1.0)

    def augment(self, flow: FloatArray, scale: float) -> tuple[FloatArray, BoolArray]:
        """Add a maximum flow of the residual network, capacities scaled to integers.

        Returns the new flow and the nodes (N,) of a minimum cut of the scaled residual network.
        """
        network, n, m = self.game.network, self.game.node_count, len(self.edge)
        x = self.visits(flow)
        forward = np.concatenate((np.full(m, np.inf), np.maximum(self._capacity - x, 0.0)))
        backward = np.concatenate((flow, x))
        # An unlimited arc never fills up: the whole missing flow is below INTEGER_FLOW.
        limits = np.minimum(np.concatenate((forward, backward)) * scale, 2.0 * INTEGER_FLOW)
        graph = csr_matrix(
            (np.empty(len(limits), np.int32), self._pattern.indices, self._pattern.indptr),
            shape=self._pattern.shape,
        )
        graph.data[self._place] = limits.astype(np.int32)
        found = maximum_flow(graph, n + network.source, network.target)
        pushed = found.flow
        if not np.array_equal(pushed.indices, graph.indices):
            raise SolverFailed('the maximum flow came back on another network')
        gained = pushed.data[self._place[:m]] / scale
        residual = (graph - pushed).tocsr()
        residual.eliminate_zeros()
        return np.maximum(flow + gained, 0.0), self._cut(residual)

    def _cut(self, residual: csr_matrix) -> BoolArray:
        """Nodes whose entry can still be reached but whose exit cannot."""
        network, n = self.game.network, self.game.node_count
        reached = np.zeros(2 * n, dtype=bool)
        reached[
            breadth_first_order(residual, n + network.source, return_predecessors=False)
        ] = True
        cut = reached[:n] & ~reached[n:]
        cut[[network.source, network.target]] = False
        return cut


def _finish(game: Game, split: _SplitNetwork, flow: FloatArray, cut: BoolArray) -> GameValue:
    p = np.zeros(len(game.network.edges))
    p[split.edge] = flow
    p = without_cycles(game.network, p)
    p /= p[game.network.tails == game.network.source].sum()
    q = np.zeros(game.node_count)
    q[cut] = 1.0 / game.loss[cut]
    return GameValue(float(1.0 / q.sum()), p, q / q.sum(), np.flatnonzero(cut))
