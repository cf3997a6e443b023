# SPDX-License-Identifier: Apache-2.0
"""An acyclic strategy as a Markov chain: the probability that a site hits its routes.

For one site, let u_i be the probability that a route at node i has not been hit before, and V_i the
probability that it is hit from i on. Both take one pass over the edges near the site, in
topological order. P(hit) is the sum of u_tail p over the edges that enter the disc. It is a smooth
function of p, whose derivative is a row over the edges (docs/theory.md, Proposition 8.4):

    d P(hit) / d p_e = u_tail  (if e enters)  +  (u_tail (unless e enters) - u_head) V_head.

The row times p is P(hit) itself. On a trip, hits are summed over the legs.
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

# Flow that counts as rounding, in a strategy of size 1.
NO_FLOW = 1e-13
# Probability below which edges are dropped: more than half of all on a fine network.
RARE = 1e-12


class MarkovChain:
    """Markov chain of a strategy p (m,) on an acyclic network.

    ``share`` (m,) is the probability of each edge at its tail, ``visits`` (n,) that of each node.
    ``p`` (m,) follows from both, so it is conserved to the last digit.
    """

    def __init__(self, network: AcyclicNetwork, p: FloatArray) -> None:
        self.network = network
        leaving = sums(network.tail, p, network.count)
        self.share = p / np.maximum(leaving, np.finfo(float).tiny)[network.tail]
        self._start = np.zeros(network.count)
        self._start[0] = 1.0
        self.visits = network.onwards.solve(self.share, self._start.copy())
        self.p = self.visits[network.tail] * self.share
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
        """Expected hits (K,), summed over the legs, by sites with ``rows`` (K, M).

        Rows are over the whole network's edges; see ``hits`` for those of the chain's.
        """
        return self.hits(self.network.columns(rows))

    def meets_at_most(self, rows: csr_matrix) -> FloatArray:
        """Upper bound (K,) of ``meets`` that is fast to compute: entries, at most 1 on each leg."""
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
        """Expected hits (K,) by sites with ``rows`` (K, m) over the chain's edges."""
        count, rows = rows.shape[0], self.network.by_leg(rows)
        hit = np.zeros(rows.shape[0])
        tails, weight = self.network.tail[rows.indices], self.share[rows.indices]
        for site, own, _, _, arriving in self._each(rows):
            hit[site] = arriving[tails[own]] @ weight[own]
        return np.asarray(np.minimum(hit, 1.0).reshape(count, len(self.network.starts)).sum(axis=1))

    def hits_with_derivatives(self, rows: csr_matrix) -> tuple[FloatArray, csr_matrix]:
        """Expected hits (K,), and their derivatives as rows (K, m); rows times p are the hits."""
        site_count, rows = rows.shape[0], self.network.by_leg(rows)
        edges, weights = [np.zeros(0, dtype=np.int64)], [np.zeros(0)]
        hit, count = np.zeros(rows.shape[0]), np.zeros(rows.shape[0] + 1, dtype=np.int64)
        unhit = np.ones(self.network.count)
        for site, own, a, b, arriving in self._each(rows):
            entering = rows.indices[own]
            unhit[a:b] = arriving[a:b] * self._per_visit[a:b] + self._unvisited[a:b]
            edge, weight = entering, unhit[self.network.tail[entering]]
            hit[site] = weight @ self.p[entering]
            # If entries equal P(hit) up to rounding, no route re-enters: later hits do not change.
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
        """Return the chain of routes that use no edge ``entering`` (K,), and their probability."""
        network, share, end = self.network, self.share.copy(), np.zeros(self.network.count)
        share[entering], end[0] = 0.0, 1.0
        clear = network.backwards.solve(share, end)[::-1]  # from each node to the target
        visits = network.onwards.solve(share, self._start.copy())
        p = visits[network.tail] * share * clear[network.head]
        return MarkovChain(network, p), float(clear[0])

    def without_rare(self) -> MarkovChain:
        """Return the chain of routes without ``RARE`` edges."""
        chain, _ = self.avoiding(np.flatnonzero(self.p < RARE))
        return chain

    def _each(self, rows: csr_matrix) -> Iterator[tuple[int, slice, int, int, FloatArray]]:
        """Yield each site that has entries: site, slice of its row, a, b, and visits before a hit.

        Visits before a hit (n,) are fewer than all visits only from the node a on, the first to
        which an entry leads; they are valid up to node b - 1, the last that an entry leaves. The
        array is reused for the next site.
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
                entries = places[own]
                ahead[entries] = 0.0
                arriving[a:b] = self._start[a:b]
                self.network.onwards.add_rows(ahead, arriving, a, b)
                ahead[entries] = share[own]
            yield site, own, a, b, arriving
            arriving[a:b] = self.visits[a:b]

    def _changes_later_hits(self, entering: IndexArray, a: int, b: int,
                            unhit: FloatArray) -> tuple[IndexArray, FloatArray]:
        """Edges with (u_tail unless they enter - u_head) V_head other than 0, and this value."""
        network, last = self.network, self.network.count - 1
        entries = self._at_behind[entering]
        self._behind[entries] = 0.0
        later_hits = sums(last - network.tail[entering], self.share[entering], network.count)
        network.backwards.add_rows(self._behind, later_hits, last + 1 - b, last + 1 - a)
        self._behind[entries] = self.share[entering]
        first, end = self._into[a], self._into[b]
        edge = network.onwards.order[first:end]
        tail_unhit, head = unhit[network.tail[edge]], network.head[edge]
        enters = self._at_ahead[entering]
        tail_unhit[enters[enters < end] - first] = 0.0
        weight = (tail_unhit - unhit[head]) * later_hits[last - head]
        nonzero = np.flatnonzero(weight)
        return edge[nonzero], weight[nonzero]


class RouteMixture:
    """Mixture of whole routes of each leg, for laws that no Markov chain has.

    Parameters
    ----------
    routes
        The routes as edges, which are numbered leg by leg.
    shares : (C,)
        Probability of each route on its leg.
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
        """Entropy of the drawn routes, summed over the legs [nats]."""
        return float(0.0 - self.shares @ np.log(self.shares))

    def of_leg(self, number: int, first: int) -> RouteMixture:
        """Return the mixture of one leg, whose edges are numbered from ``first`` on in this one."""
        index = np.flatnonzero(self.leg == number)
        return RouteMixture([self.routes[k] - first for k in index.tolist()], self.shares[index],
                            np.zeros(len(index), dtype=np.int64))


def chain_of(network: Network, p: FloatArray) -> MarkovChain:
    """Return the chain of an acyclic strategy p (M,) of one leg, on the edges that it uses."""
    return chain_of_legs([network], p, np.array([0, len(p)]))


def chain_of_legs(networks: Sequence[Network], p: FloatArray, first: IndexArray) -> MarkovChain:
    """Return the chain of acyclic strategies p (M,) of legs, whose edges begin at ``first``."""
    parts = []
    for network, leg_p in zip(networks, np.split(p, first[1:-1]), strict=True):
        number = order_along(network, leg_p)
        assert number is not None  # p is acyclic
        parts.append(acyclic_network(network, np.flatnonzero(leg_p > 0.0), number))
    used = in_series(parts, first)
    return MarkovChain(used, p[used.edge])


def conserved_strategy(game: Game, p: FloatArray, negligible: float = 0.0) -> FloatArray | None:
    """Repair conservation: turn p (M,) into an exact, acyclic strategy with the same shares.

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
