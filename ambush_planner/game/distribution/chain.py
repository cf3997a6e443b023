# SPDX-License-Identifier: Apache-2.0
"""An acyclic strategy as a Markov chain: how likely its routes are hit, each counted once.

Along a route, u_i is how likely it is at node i that the site has not hit the route yet, and V_i
how likely the site hits it from i on. Both follow from one pass over the edges near the site, in
topological order. P(hit) is the sum of u_tail p over the edges that enter the disc. It is a smooth
function of p, and its derivative is a row over the edges (docs/theory.md, Proposition 8.4):

    d P(hit) / d p_e = u_tail  (if e enters)  +  (u_tail (unless e enters) - u_head) V_head.

The row times p is P(hit) itself. On a trip, the hits of its legs add up.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.sparse import csr_matrix

from ...arrays import ROUNDING, FloatArray, IndexArray, sums
from ...network.network import Network
from ..game import Game
from .acyclic import order_along, without_cycles
from .gibbs import AcyclicNetwork, acyclic_network, in_series

# Flow that is rounding, of a strategy with 1 in all.
NO_FLOW = 1e-13
# Edges that fewer than one departure in 10^12 would use: more than half of all on a fine network.
RARE = 1e-12


class MarkovChain:
    """The chain of a strategy p (m,) on an acyclic network.

    ``share`` (m,) is the probability of each edge at its tail, ``visits`` (n,) that of each node;
    ``p`` (m,) follows from them.
    """

    def __init__(self, network: AcyclicNetwork, p: FloatArray) -> None:
        self.network = network
        leaving = sums(network.tail, p, network.count)
        self.share = p / np.maximum(leaving, np.finfo(float).tiny)[network.tail]
        self._start = np.zeros(network.count)
        self._start[0] = 1.0
        self.visits = network.onwards.solve(self.share, self._start.copy())
        self.p = self.visits[network.tail] * self.share  # conserved to the last digit
        onwards, backwards = network.onwards, network.backwards
        self._ahead, self._behind = self.share[onwards.order], self.share[backwards.order]
        self._at_ahead, self._at_behind = np.argsort(onwards.order), np.argsort(backwards.order)
        self._unvisited = (self.visits <= NO_FLOW).astype(np.float64)
        self._per_visit = (1.0 - self._unvisited) / np.maximum(self.visits, NO_FLOW)
        self._into = np.searchsorted(network.head[onwards.order], np.arange(network.count + 1))

    def uses(self, edges: int) -> FloatArray:
        """Expected uses of each of the whole network's ``edges``."""
        return sums(self.network.edge, self.p, edges)

    def meets(self, rows: csr_matrix) -> FloatArray:
        """Expected hits (K,) by sites whose discs are entered by the whole network's edges (K, M).

        P(hit) on each leg, added up.
        """
        return self.hits(self.network.columns(rows))

    def meets_at_most(self, rows: csr_matrix) -> FloatArray:
        """An upper bound (K,) of ``meets`` that is fast to find: the entries, at most 1 a leg."""
        starts = self.network.starts
        leg = np.searchsorted(starts, self.network.tail, 'right') - 1
        uses = csr_matrix((self.p, (self.network.edge, leg)), (rows.shape[1], len(starts)))
        entries = csr_matrix(rows @ uses)
        entries.data = np.minimum(entries.data, 1.0)
        return np.asarray(entries.sum(axis=1)).ravel()

    @property
    def entropy(self) -> float:
        """Entropy of a drawn route [nats]."""
        used = self.p > 0.0
        return float(0.0 - self.p[used] @ np.log(self.share[used]))

    def hits(self, rows: csr_matrix) -> FloatArray:
        """Expected hits (K,) by sites whose discs the edges of ``rows`` (K, m) enter."""
        count, rows = rows.shape[0], self.network.by_leg(rows)
        hit = np.zeros(rows.shape[0])
        tails, weight = self.network.tail[rows.indices], self.share[rows.indices]
        for site, own, _, _, arriving in self._each(rows):
            hit[site] = arriving[tails[own]] @ weight[own]
        return np.asarray(np.minimum(hit, 1.0).reshape(count, len(self.network.starts)).sum(axis=1))

    def hits_with_derivatives(self, rows: csr_matrix) -> tuple[FloatArray, csr_matrix]:
        """Expected hits (K,), and derivatives as rows (K, m), which times p are the hits."""
        site_count, rows = rows.shape[0], self.network.by_leg(rows)
        edges, weights = [np.zeros(0, dtype=np.int64)], [np.zeros(0)]
        hit, count = np.zeros(rows.shape[0]), np.zeros(rows.shape[0] + 1, dtype=np.int64)
        unhit = np.ones(self.network.count)
        for site, own, a, b, arriving in self._each(rows):
            entering = rows.indices[own]
            unhit[a:b] = arriving[a:b] * self._per_visit[a:b] + self._unvisited[a:b]
            edge, weight = entering, unhit[self.network.tail[entering]]
            hit[site] = weight @ self.p[entering]
            # Where the expected entries exceed P(hit) by rounding, the derivative there is 1.
            if b > a and hit[site] < self.p[entering].sum() - ROUNDING:
                later, more = self._changes_later_hits(entering, a, b, unhit)
                edge, weight = np.append(edge, later), np.append(weight, more)
            unhit[a:b] = 1.0
            edges.append(edge)
            weights.append(weight)
            count[site + 1] = len(edge)
        found = csr_matrix((np.concatenate(weights), np.concatenate(edges), np.cumsum(count)),
                           rows.shape)
        legs = len(self.network.starts)
        if legs > 1:
            each = np.arange(rows.shape[0])
            found = csr_matrix((np.ones(len(each)), (each // legs, each)),
                               (site_count, len(each))) @ found
        return np.minimum(hit, 1.0).reshape(site_count, legs).sum(axis=1), csr_matrix(found)

    def avoiding(self, entering: IndexArray) -> tuple[MarkovChain, float]:
        """The chain of the routes that use no edge ``entering`` (K,), and their probability."""
        network, share, end = self.network, self.share.copy(), np.zeros(self.network.count)
        share[entering], end[0] = 0.0, 1.0
        clear = network.backwards.solve(share, end)[::-1]  # from each node to the target
        visits = network.onwards.solve(share, self._start.copy())
        p = visits[network.tail] * share * clear[network.head]
        return MarkovChain(network, p), float(clear[0])

    def without_rare(self) -> MarkovChain:
        """The chain of the routes without ``RARE`` edges."""
        chain, _ = self.avoiding(np.flatnonzero(self.p < RARE))
        return chain

    def _each(self, rows: csr_matrix) -> Iterator[tuple[int, slice, int, int, FloatArray]]:
        """Each site that routes can meet: its entries in the rows, and the visits before a hit.

        The latter, at each node (n,), are fewer than all visits only from the first node that an
        entry leads to, a, and are needed only up to the last node that one leaves, b - 1. The array
        is the same for all sites.
        """
        head, tail, ahead = self.network.head, self.network.tail, self._ahead
        met = np.flatnonzero(np.diff(rows.indptr))
        if not len(met):
            return
        begin = np.minimum.reduceat(head[rows.indices], rows.indptr[met])
        end = np.maximum.reduceat(tail[rows.indices], rows.indptr[met]) + 1
        arriving, places = self.visits.copy(), self._at_ahead[rows.indices]
        share, first = ahead[places], rows.indptr.tolist()
        for site, a, b in zip(met.tolist(), begin.tolist(), end.tolist(), strict=True):
            own = slice(first[site], first[site + 1])
            if a < b:
                again = places[own]
                ahead[again] = 0.0
                arriving[a:b] = self._start[a:b]
                self.network.onwards.add_rows(ahead, arriving, a, b)
                ahead[again] = share[own]
            yield site, own, a, b, arriving
            arriving[a:b] = self.visits[a:b]

    def _changes_later_hits(self, entering: IndexArray, a: int, b: int,
                            unhit: FloatArray) -> tuple[IndexArray, FloatArray]:
        """The edges with (u_tail unless they enter - u_head) V_head, where that is not 0."""
        network, last = self.network, self.network.count - 1
        again = self._at_behind[entering]
        self._behind[again] = 0.0
        backwards = sums(last - network.tail[entering], self.share[entering], network.count)
        network.backwards.add_rows(self._behind, backwards, last + 1 - b, last + 1 - a)
        self._behind[again] = self.share[entering]
        first, end = self._into[a], self._into[b]
        edge = network.onwards.order[first:end]
        before, head = unhit[network.tail[edge]], network.head[edge]
        enters = self._at_ahead[entering]
        before[enters[enters < end] - first] = 0.0
        weight = (before - unhit[head]) * backwards[last - head]
        some = np.flatnonzero(weight)
        return edge[some], weight[some]


class RouteMixture:
    """Whole routes of each leg, drawn with given probabilities: what one chain cannot remember.

    Parameters
    ----------
    routes
        The routes, given by their edges, those of all legs numbered one after the other.
    shares : (C,)
        Probability of each among the routes of its leg.
    leg : (C,)
        The leg of each route.
    """

    def __init__(self, routes: Sequence[IndexArray], shares: FloatArray, leg: IndexArray) -> None:
        used = np.flatnonzero(shares > 0.0)
        self.routes = [routes[k] for k in used.tolist()]
        self.shares, self.leg = shares[used], leg[used]
        self._edge = np.concatenate(self.routes)
        self._route = np.repeat(np.arange(len(used)), list(map(len, self.routes)))

    def uses(self, edges: int) -> FloatArray:
        """Expected uses of each of the network's ``edges``."""
        return sums(self._edge, self.shares[self._route], edges)

    def meets_at_most(self, rows: csr_matrix) -> FloatArray:
        """An upper bound (K,) of ``meets`` that is fast to find."""
        return np.asarray(rows @ self.uses(rows.shape[1]))

    def meets(self, rows: csr_matrix) -> FloatArray:
        """Expected hits (K,) by sites whose discs are entered by the edges of ``rows`` (K, M)."""
        one = np.ones(len(self._edge))
        along = csr_matrix((one, (self._edge, self._route)), (rows.shape[1], len(self.shares)))
        met = csr_matrix(rows @ along)
        met.data[:] = 1.0
        return np.asarray(met @ self.shares)

    @property
    def entropy(self) -> float:
        """Entropy of the drawn routes, added up over the legs [nats]."""
        return float(0.0 - self.shares @ np.log(self.shares))

    def of_leg(self, number: int, first: int) -> RouteMixture:
        """The routes of one leg, whose edges are numbered from ``first`` on in this mixture."""
        own = np.flatnonzero(self.leg == number)
        return RouteMixture([self.routes[k] - first for k in own.tolist()], self.shares[own],
                            np.zeros(len(own), dtype=np.int64))


def chain_of(network: Network, p: FloatArray) -> MarkovChain:
    """The chain of an acyclic strategy p (M,) of one leg, on the edges that it uses."""
    return chain_of_legs([network], p, np.array([0, len(p)]))


def chain_of_legs(networks: Sequence[Network], p: FloatArray, first: IndexArray) -> MarkovChain:
    """The chain of acyclic strategies of legs, p (M,) one after the other."""
    parts = []
    for network, own in zip(networks, np.split(p, first[1:-1]), strict=True):
        number = order_along(network, own)
        assert number is not None  # p is acyclic
        parts.append(acyclic_network(network, np.flatnonzero(own > 0.0), number))
    used = in_series(parts, first)
    return MarkovChain(used, p[used.edge])


def conserved_strategy(game: Game, p: FloatArray, negligible: float = 0.0) -> FloatArray | None:
    """Turn an almost conserved p (M,) into an exact, acyclic strategy with the same shares.

    Edges with p <= ``negligible`` and cycles are removed first. Returns None if no route remains.
    """
    part = game.restricted_to(p > negligible)
    if part is None:
        return None
    flow = without_cycles(game.network, np.where(part.playable, p, 0.0))
    part = part.restricted_to(flow > 0.0)
    if part is None:
        return None
    return chain_of(game.network, np.where(part.playable, flow, 0.0)).uses(len(p))
