"""A strategy on condition that its routes avoid some edges: what is left when ground is lost.

Drawing routes until one is clear draws from this strategy. On an acyclic network it is exact: with
w = p / x the chance of the next edge and Z the chance to reach the target from a node by edges that
are left, Z_i = sum w_ik Z_k, the next edge is then taken with chance w_ik Z_k / Z_i.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from ..arrays import FloatArray, IndexArray
from ..game.strategy import Strategy
from ..network.network import Network


class ConditionedStrategy:
    """The conditions of one strategy; one with circles has none."""

    def __init__(self, strategy: Strategy) -> None:
        network, p = strategy.network, strategy.edge_probability
        self._network = network
        used = np.flatnonzero(p > 0.0)
        self._order = _topological(network, used)
        tails = network.tails[self._order]
        leaving = np.bincount(tails, p[self._order], len(network.points))
        # Lists: the passes look at one number at a time.
        self._tails, self._heads = tails.tolist(), network.heads[self._order].tolist()
        self._chances = (p[self._order] / leaving[tails]).tolist()

    def avoiding(self, lost: npt.NDArray[np.bool_]) -> tuple[float, FloatArray]:
        """Return the chance that a route avoids the edges ``lost`` (M,), and p (M,) then.

        The chance is 0 where no route does, or where the strategy has circles.
        """
        p = np.zeros(len(lost))
        if not len(self._order):
            return 0.0, p
        kept = (~lost[self._order]).tolist()
        reach = [0.0] * len(self._network.points)
        reach[self._network.target] = 1.0
        steps = list(zip(self._tails, self._heads, self._chances, kept, strict=True))
        for tail, head, chance, left in reversed(steps):
            if left:
                reach[tail] += chance * reach[head]
        share = reach[self._network.source]
        if share > 0.0:
            p[self._order] = self._forward(steps, reach)
        return share, p

    def _forward(
        self, steps: list[tuple[int, int, float, bool]], reach: list[float]
    ) -> list[float]:
        visits = [0.0] * len(reach)
        visits[self._network.source] = 1.0
        flows = []
        for tail, head, chance, left in steps:
            flow = 0.0
            if left and visits[tail] > 0.0:
                flow = visits[tail] * chance * reach[head] / reach[tail]
                visits[head] += flow
            flows.append(flow)
        return flows


def _topological(network: Network, used: IndexArray) -> IndexArray:
    """The edges in use, each behind those into its tail; none at all where there are circles."""
    count = len(network.points)
    tails, heads = network.tails[used], network.heads[used]
    graph = csr_matrix((np.ones(len(used)), (tails, heads)), shape=(count, count))
    pieces, _ = connected_components(graph, directed=True, connection='strong')
    if pieces < count:
        return np.empty(0, dtype=np.int64)
    return used[np.argsort(_places(graph)[tails], kind='stable')]


def _places(graph: csr_matrix) -> IndexArray:
    """The places (N,) of the nodes in a topological order."""
    starts, heads = graph.indptr.tolist(), graph.indices.tolist()
    missing = np.bincount(graph.indices, minlength=graph.shape[0]).tolist()
    place, at = np.zeros(graph.shape[0], dtype=np.int64), 0
    ready = [node for node, count in enumerate(missing) if not count]
    while ready:
        node = ready.pop()
        place[node], at = at, at + 1
        for head in heads[starts[node]:starts[node + 1]]:
            missing[head] -= 1
            if not missing[head]:
                ready.append(head)
    return place
