"""The probability that an ambush hits a drawn route, counted once however often it comes back.

The rows of the game count how often a route enters a disc, which linear programs need because it is
linear in p. But an ambush hits a route only once. On an acyclic strategy, let o_k be the
probability of arriving at node k unhit: o_source = 1, and o_k = sum over the edges i -> k that do
not enter the disc of o_i p_ik / x_i, node by node in topological order. Then P(hit) is the sum of
o_i p_ik / x_i over the edges i -> k that enter the disc.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix

from ..arrays import FloatArray, IndexArray, sums
from ..network.network import Network
from .acyclic import is_acyclic, order_along
from .game import Game
from .triangular import Recursion

# Most sites whose probabilities are computed before the others are screened again.
_SITES_AT_ONCE = 64


def worst_loss(game: Game, p: FloatArray) -> float:
    """What the best ambush against p (M,) costs on average: the sum of the k largest losses.

    Each route counts once per site if p is acyclic. Otherwise every entry counts, which is an upper
    bound.
    """
    return float(largest_losses(game, p)[0].sum())


def largest_losses(game: Game, p: FloatArray) -> tuple[FloatArray, IndexArray]:
    """The k largest mean losses (K,) that single sites cause, and the rows (K,) of these sites.

    The expected entries bound the hits from above, so only sites that could still be among the
    largest are computed.
    """
    k = min(game.ambushers, len(game.sites))
    losses = game.site_losses(p)
    if not hits_can_differ(game) or not is_acyclic(game.network, p):
        rows = np.argsort(-losses, kind='stable')[:k]
        return losses[rows], rows
    order = np.argsort(-losses, kind='stable')
    order = order[losses[order] > 0.0]
    exact = np.zeros(len(losses))
    flow = RouteHits(game.network, p)
    least, done, size = 0.0, 0, max(8, k)
    while done < len(order) and losses[order[done]] > least:
        rows = order[done : done + size]
        exact[rows] = game.loss[game.sites[rows]] * flow.probability(game.hits[rows])
        done += len(rows)
        size = min(2 * size, _SITES_AT_ONCE)
        least = float(np.partition(exact, -k)[-k]) if k else np.inf
    rows = np.argsort(-exact, kind='stable')[:k]
    return exact[rows], rows


def hit_probabilities(game: Game, p: FloatArray, rows: IndexArray | None = None) -> FloatArray:
    """P(hit) (K,) of the sites in ``rows`` (default: all) against p (M,), which must be acyclic."""
    rows = np.arange(len(game.sites)) if rows is None else rows
    if not hits_can_differ(game):
        return np.asarray(game.hits[rows] @ p)
    return RouteHits(game.network, p).probability(game.hits[rows])


def meeting_probability(game: Game, p: FloatArray, q: FloatArray) -> float:
    """Expected number of ambushers q (N,) that a route of p (M,) meets (the paper's equation 8).

    With one ambusher this is a probability. If p has cycles, every entry counts.
    """
    at_sites = game.at_sites(q)
    rows = np.flatnonzero(at_sites > 0.0)
    if hits_can_differ(game) and is_acyclic(game.network, p):
        met = hit_probabilities(game, p, rows)
    else:
        met = np.asarray(game.hits[rows] @ p)
    return float(at_sites[rows] @ met)


def hits_can_differ(game: Game) -> bool:
    """Whether a simple route can be hit by one site more than once."""
    return game.reach > 0.0 or game.network.legs > 1


class RouteHits:
    """Hits of an acyclic strategy p (M,), as a Markov chain whose nodes are in topological order.

    For each site, the probability of arriving unhit differs from that of a visit only after the
    first edge that enters the disc, and is needed only up to the last one.
    """

    def __init__(self, network: Network, p: FloatArray) -> None:
        used, rank = np.flatnonzero(p > 0.0), order_along(network, p)
        assert rank is not None  # p is acyclic
        nodes = np.unique(network.edges[used])
        nodes = nodes[np.argsort(rank[nodes])]
        place = np.zeros(len(network.points), dtype=np.int64)
        place[nodes] = np.arange(len(nodes))
        tail, head = place[network.edges[used]].T
        share = p[used] / sums(tail, p[used], len(nodes))[tail]
        self._chain = Recursion(head, tail, len(nodes))
        self._start = np.zeros(len(nodes))
        self._start[place[network.source]] = 1.0
        self._visits = self._chain.solve(share, self._start.copy())
        order = self._chain.order
        self._tail, self._head, self._share = tail[order], head[order], share[order]
        self._entry = np.full(len(p), -1)
        self._entry[used[order]] = np.arange(len(used))

    def probability(self, rows: csr_matrix) -> FloatArray:
        """P(hit) (K,) of sites with these ``rows`` (K, M) of edges that bring routes to them."""
        entry = self._entry[rows.indices]
        used = entry >= 0
        first = np.concatenate(([0], np.cumsum(used)))[rows.indptr]
        entry, hit = entry[used], np.zeros(rows.shape[0])
        met = np.flatnonzero(np.diff(first))
        begin = np.minimum.reduceat(self._head[entry], first[met])
        end = np.maximum.reduceat(self._tail[entry], first[met]) + 1
        share, unhit = self._share.copy(), self._visits.copy()
        for site, a, b in zip(met, begin, np.maximum(begin, end), strict=True):
            hitting = entry[first[site] : first[site + 1]]
            share[hitting] = 0.0
            unhit[a:b] = self._start[a:b]
            self._chain.add_rows(share, unhit, a, b)
            share[hitting] = self._share[hitting]
            hit[site] = share[hitting] @ unhit[self._tail[hitting]]
            unhit[a:b] = self._visits[a:b]
        return np.minimum(hit, 1.0)
