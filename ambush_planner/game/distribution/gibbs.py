# SPDX-License-Identifier: Apache-2.0
"""The Gibbs distribution of routes on an acyclic network: of greatest entropy within given limits.

Weights c_e of the edges e define the probability of each route:

    P(route) = exp(-sum of c_e over its edges) / Z.

With Z_i = sum over edges i->k of exp(-c_ik) Z_k and Z_target = 1, this is the Markov chain that
goes from i to k with probability exp(-c_ik) Z_k / Z_i. It takes one backward and one forward pass
over the edges in topological order (M. Saerens et al., *Randomized shortest-path problems*, Neural
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
# Right sides of one triangular solve: few enough to stay in the processor's cache.
CHUNK = 32


class AcyclicNetwork:
    """Acyclic network of m edges, sorted by the topological positions of tail and head.

    ``tail`` and ``head`` (m,) are such positions, from 0 at the source to n - 1 at the target;
    ``edge`` (m,) are the numbers of the edges in the whole network. The legs of a trip are put in
    series: the target of each is the source of the next, at the positions ``starts`` (legs,). So
    one chain draws all legs, independently.
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
        """Return the network of the edges ``used`` (K,), on which all legs keep a route."""
        tail, head = self.tail[used], self.head[used]
        nodes = np.unique((tail, head))
        tail, head, starts = (np.searchsorted(nodes, each) for each in (tail, head, self.starts))
        return AcyclicNetwork(tail, head, self.edge[used], starts.tolist())

    def columns(self, rows: csr_matrix) -> csr_matrix:
        """Select these edges' columns (K, m) from rows (K, M) over the whole network's edges."""
        return csr_matrix(rows[:, self.edge])

    def by_leg(self, rows: csr_matrix) -> csr_matrix:
        """Split each of the rows (K, m) by leg: rows (K * legs, m)."""
        legs = len(self.starts)
        if legs == 1:
            return rows
        entries = rows.tocoo()
        leg = np.searchsorted(self.starts, self.tail[entries.col], 'right') - 1
        return csr_matrix((entries.data, (entries.row * legs + leg, entries.col)),
                          (rows.shape[0] * legs, rows.shape[1]))

    def distribution(self, weights: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """Return log Z, p (m,) and the probability (m,) of each edge at its tail.

        The partition function is scaled by that of the previous evaluation; if it overflows all the
        same, its logarithm is computed first.
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
        """Covariance (K, K) of a route's costs, which are sums of ``costs`` (K, m) of its edges.

        The product of two costs is a sum over pairs of edges: e and then f are both driven with the
        probability p_e times that of reaching f from the head of e. One forward pass for each row
        sums these.
        """
        count, edge = costs.shape[0], np.arange(len(p))
        entering = csr_matrix((p, (self.head, edge)), shape=(self.count, len(p)))
        leaving = csr_matrix((share, (self.tail, edge)), shape=(self.count, len(p)))
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

    def largest_sum(self, weights: FloatArray) -> float:
        """Return the largest sum of weights (m,) along a route."""
        if not weights.any():
            return 0.0
        largest = np.zeros(self.count)
        for nodes, edges, first in self._layers:
            largest[nodes] = np.maximum.reduceat(largest[self.head[edges]] + weights[edges], first)
        return float(largest[0])

    def _log_partition(self, weights: FloatArray) -> FloatArray:
        """log Z_i (n,) of any size, by sums of logarithms from the target backwards."""
        log_z = np.zeros(self.count)
        for nodes, edges, first in self._layers:
            terms = log_z[self.head[edges]] - weights[edges]
            log_z[nodes] = np.logaddexp.reduceat(terms, first)
        return log_z

    @cached_property
    def _layers(self) -> list[tuple[IndexArray, IndexArray, IndexArray]]:
        """Layers of nodes by the largest number of edges on a way to the target.

        Each has its nodes, the edges out of them, and the place at which each node's edges begin.
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
    """Make the network of the edges ``edge`` (m,), in the topological order ``position`` (N,)."""
    used = np.unique(network.edges[edge])
    nodes = used[np.argsort(position[used], kind='stable')]
    place = np.full(len(network.points), -1)
    place[nodes] = np.arange(len(nodes))
    tail, head = place[network.edges[edge]].T
    order = np.lexsort((head, tail))
    return AcyclicNetwork(tail[order], head[order], edge[order])


def in_series(legs: Sequence[AcyclicNetwork], first: IndexArray) -> AcyclicNetwork:
    """Put the acyclic networks of legs in series; their edges are numbered from ``first`` on."""
    if len(legs) == 1:
        return legs[0]
    starts = np.cumsum([0, *(leg.count - 1 for leg in legs[:-1])])
    return AcyclicNetwork(
        np.concatenate([leg.tail + start for leg, start in zip(legs, starts, strict=True)]),
        np.concatenate([leg.head + start for leg, start in zip(legs, starts, strict=True)]),
        np.concatenate([leg.edge + edge for leg, edge in zip(legs, first, strict=False)]),
        starts.tolist())


def _ranges(begin: IndexArray, end: IndexArray) -> tuple[IndexArray, IndexArray]:
    """Concatenate the ranges from begin (K,) to end (K,); returns also each range's place (K,)."""
    lengths = end - begin
    start = np.cumsum(lengths) - lengths
    return np.arange(lengths.sum()) + np.repeat(begin - start, lengths), start
