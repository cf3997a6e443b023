# SPDX-License-Identifier: Apache-2.0
"""The Gibbs distribution of routes: the strategy of greatest route entropy within given limits.

On an acyclic network, a weight c_e for every edge e defines the probability of each route:

    P(route) = exp(-sum of c_e over its edges) / Z.

With Z_i = sum over edges i->k of exp(-c_ik) Z_k and Z_target = 1, it is the Markov chain that goes
from i to k with probability exp(-c_ik) Z_k / Z_i. It takes one backward and one forward pass over
the edges in topological order (M. Saerens et al., *Randomized shortest-path problems*, Neural
Computation 21, 2009; also known as maximum causal entropy).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix

from ...arrays import FloatArray, IndexArray, sums
from ...network.network import Network
from .triangular import Recursion

# Partition functions below this, or above its inverse, are scaled by their logarithms.
TINY = float(np.finfo(float).tiny / np.finfo(float).eps)
# Right sides of one triangular solve: bounds its memory, and they stay in the processor's cache.
CHUNK = 32


class AcyclicNetwork:
    """Edges of an acyclic network in topological order, sorted by (tail, head).

    ``tail`` and ``head`` (m,) are positions of nodes in the order; the source is 0 and the target
    is the last one. ``edge`` (m,) are the indices of the edges in the whole network. The legs of a
    trip follow each other: the next one begins where one ends, ``starts`` (legs,) are the positions
    there. So one chain draws all legs, independently.
    """

    def __init__(self, tail: IndexArray, head: IndexArray, edge: IndexArray,
                 starts: Sequence[int] = (0,)) -> None:
        self.tail, self.head, self.edge, self.starts = tail, head, edge, np.array(starts)
        self.count = int(head.max()) + 1
        self._first = np.searchsorted(tail, np.arange(self.count + 1))
        self._log_scale = np.zeros(self.count)
        last = self.count - 1
        self.onwards = Recursion(head, tail, self.count)
        self.backwards = Recursion(last - tail, last - head, self.count)

    def part(self, used: IndexArray) -> AcyclicNetwork:
        """The network of some edges (K,), which every route of them leads through all legs."""
        tail, head = self.tail[used], self.head[used]
        nodes = np.unique((tail, head))
        tail, head, starts = (np.searchsorted(nodes, each) for each in (tail, head, self.starts))
        return AcyclicNetwork(tail, head, self.edge[used], starts.tolist())

    def columns(self, rows: csr_matrix) -> csr_matrix:
        """The columns (K, m) of these edges, of rows (K, M) over the whole network's edges."""
        return csr_matrix(rows[:, self.edge])

    def by_leg(self, rows: csr_matrix) -> csr_matrix:
        """Rows (K * legs, m): each of the rows (K, m) leg by leg."""
        legs = len(self.starts)
        if legs == 1:
            return rows
        entries = rows.tocoo()
        leg = np.searchsorted(self.starts, self.tail[entries.col], 'right') - 1
        return csr_matrix((entries.data, (entries.row * legs + leg, entries.col)),
                          (rows.shape[0] * legs, rows.shape[1]))

    def distribution(self, weights: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """Return log Z, p (m,) and the probability (m,) of each edge at its tail.

        The partition function is scaled by the previous evaluation's; where that overflows, its
        logarithm is computed first.
        """
        scaled = self._scaled_partition(weights)
        if scaled is None:
            self._log_scale = self._log_partition(weights)
            choice = np.exp(self._log_scale[self.head] - self._log_scale[self.tail] - weights)
            choice /= sums(self.tail, choice, self.count)[self.tail]
            scaled = choice, np.ones(self.count)
        share, partition = scaled
        share *= partition[self.head]
        with np.errstate(divide='ignore', invalid='ignore'):
            share /= partition[self.tail]
        if not partition.min() > 0.0:
            share[partition[self.tail] <= 0.0] = 0.0
        self._log_scale = self._log_scale + np.log(np.maximum(partition, TINY))
        begin = np.zeros(self.count)
        begin[0] = 1.0
        p = self.onwards.solve(share, begin)[self.tail]
        p *= share
        return float(self._log_scale[0]), p, share

    def covariance(self, share: FloatArray, p: FloatArray, costs: csr_matrix) -> FloatArray:
        """Covariance (K, K) of the costs of a route; the rows of ``costs`` (K, m) add up along it.

        Rows j and k are met one after the other, first on edge e and then on edge f, with the
        probability p_e times that of reaching f from the head of e. One forward pass for each row
        adds these up.
        """
        count, every = costs.shape[0], np.arange(len(p))
        entering = csr_matrix((p, (self.head, every)), shape=(self.count, len(p)))
        leaving = csr_matrix((share, (self.tail, every)), shape=(self.count, len(p)))
        met, onward = (entering @ costs.T).tocsc(), (costs @ leaving.T).tocsr()
        covariance, mean = np.empty((count, count)), costs @ p
        for begin in range(0, count, CHUNK):
            chunk = slice(begin, begin + CHUNK)
            reached = self.onwards.solve(share, met[:, chunk].toarray(order='C'))
            covariance[:, chunk] = onward @ reached
        covariance += covariance.T
        covariance += (costs.multiply(p).tocsr() @ costs.T).toarray()
        covariance -= np.outer(mean, mean)
        return covariance

    def _scaled_partition(self, weights: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        factor = self._log_scale[self.head]
        end = np.zeros(self.count)
        end[0] = 1.0
        with np.errstate(over='ignore', invalid='ignore'):
            factor -= self._log_scale[self.tail]
            factor -= weights
            np.exp(factor, out=factor)
            if not np.isfinite(factor).all():
                return None
            partition = self.backwards.solve(factor, end)[::-1]
        good = np.isfinite(partition).all() and partition[0] > TINY and partition.max() < 1.0 / TINY
        return (factor, partition) if good else None

    def most(self, weights: FloatArray) -> float:
        """The largest sum of weights (m,) along a route."""
        if not weights.any():
            return 0.0
        most = np.zeros(self.count)
        for nodes, edges, first in self._layers:
            most[nodes] = np.maximum.reduceat(most[self.head[edges]] + weights[edges], first)
        return float(most[0])

    def _log_partition(self, weights: FloatArray) -> FloatArray:
        """log Z_i (n,) of any size, as sums of logarithms from the target backwards."""
        log_z = np.zeros(self.count)
        for nodes, edges, first in self._layers:
            ways = log_z[self.head[edges]] - weights[edges]
            log_z[nodes] = np.logaddexp.reduceat(ways, first)
        return log_z

    @cached_property
    def _layers(self) -> list[tuple[IndexArray, IndexArray, IndexArray]]:
        """Layers of nodes by the largest number of edges on a way to the target.

        Each layer has its nodes, the edges out of them, and where each node's edges begin.
        """
        into = np.argsort(self.head, kind='stable')
        first_into = np.searchsorted(self.head[into], np.arange(self.count + 1))
        pending = np.diff(self._first)
        layers: list[tuple[IndexArray, IndexArray, IndexArray]] = []
        nodes = np.array([self.count - 1])
        while True:
            arriving, _ = _ranges(first_into[nodes], first_into[nodes + 1])
            tails = self.tail[into[arriving]]
            np.subtract.at(pending, tails, 1)
            nodes = np.unique(tails[pending[tails] == 0])
            if not len(nodes):
                return layers
            layers.append((nodes, *_ranges(self._first[nodes], self._first[nodes + 1])))


def acyclic_network(network: Network, edge: IndexArray, position: IndexArray) -> AcyclicNetwork:
    """The edges ``edge`` (m,), with nodes in the topological order ``position`` (N,)."""
    used = np.unique(network.edges[edge])
    nodes = used[np.argsort(position[used], kind='stable')]
    place = np.full(len(network.points), -1)
    place[nodes] = np.arange(len(nodes))
    tail, head = place[network.edges[edge]].T
    order = np.lexsort((head, tail))
    return AcyclicNetwork(tail[order], head[order], edge[order])


def in_series(legs: Sequence[AcyclicNetwork], first: IndexArray) -> AcyclicNetwork:
    """The acyclic networks of legs, one after the other; edges are numbered from ``first`` on."""
    if len(legs) == 1:
        return legs[0]
    starts = np.cumsum([0, *(leg.count - 1 for leg in legs[:-1])])
    return AcyclicNetwork(
        np.concatenate([leg.tail + at for leg, at in zip(legs, starts, strict=True)]),
        np.concatenate([leg.head + at for leg, at in zip(legs, starts, strict=True)]),
        np.concatenate([leg.edge + at for leg, at in zip(legs, first, strict=False)]),
        starts.tolist())


def _ranges(begin: IndexArray, end: IndexArray) -> tuple[IndexArray, IndexArray]:
    """The concatenated ranges from begin (K,) to end (K,), and where each range starts."""
    lengths = end - begin
    start = np.cumsum(lengths) - lengths
    return np.arange(lengths.sum()) + np.repeat(begin - start, lengths), start
