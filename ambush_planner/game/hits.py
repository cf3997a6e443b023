"""The probability that an ambush hits a drawn route, counted once however often it comes back.

The rows of the game count how often a route enters a disc, which linear programs need because it is
linear in p. But an ambush hits a route only once. On an acyclic strategy the probability of that is
one pass over the edges in topological order: let o_k be the probability of arriving at node k
unhit, o_source = 1 and o_k = sum over the edges i -> k that do not enter the disc of o_i p_ik /
x_i. Then P(hit) = 1 - o_target.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix

from ..arrays import FloatArray, IndexArray, sums
from ..network.network import Network
from .acyclic import is_acyclic
from .game import Game

# Sites handled by one pass: bounds its memory, nodes x sites x 8 bytes.
_SITES_PER_PASS = 64


def worst_loss(game: Game, p: FloatArray) -> float:
    """What the best ambush against p (M,) costs on average: the sum of the k largest losses.

    Each route counts once per site if p is acyclic. Otherwise every entry counts, which is an upper
    bound.
    """
    return float(largest_losses(game, p)[0].sum())


def largest_losses(game: Game, p: FloatArray) -> tuple[FloatArray, IndexArray]:
    """The k largest mean losses (K,) that single sites cause, and the rows (K,) of these sites.

    The expected entries bound the hits from above, so only sites that could still be among the
    largest need the pass over the network.
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
        size = min(2 * size, _SITES_PER_PASS)
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
    """The edges of an acyclic strategy p (M,) by topological layers of their heads.

    ``edges`` (K,) are those in use, each after all edges into its tail.
    """

    def __init__(self, network: Network, p: FloatArray) -> None:
        used = np.flatnonzero(p > 0.0)
        nodes, ends = np.unique(network.edges[used], return_inverse=True)
        tail, head = ends.reshape(-1, 2).T
        leaving = sums(tail, p[used], len(nodes))
        layer = _layer_of_nodes(tail, head, len(nodes))
        order = np.lexsort((head, layer[head]))
        self.edges, self._tail = used[order], tail[order]
        head = head[order]
        self._share = (p[used] / leaving[tail])[order][:, None]
        self._source = int(np.searchsorted(nodes, network.source))
        self._target = int(np.searchsorted(nodes, network.target))
        self._count = len(nodes)
        new_head = np.flatnonzero(np.r_[True, head[1:] != head[:-1]])
        bounds = np.searchsorted(layer[head], np.arange(1, layer.max() + 2))
        firsts = np.searchsorted(new_head, bounds)
        self._layers = [
            (a, b, head[new_head[i:j]], new_head[i:j] - a)
            for a, b, i, j in zip(bounds[:-1], bounds[1:], firsts[:-1], firsts[1:], strict=True)
        ]

    def probability(self, rows: csr_matrix) -> FloatArray:
        """P(hit) (K,) of sites with these ``rows`` (K, M) of edges that bring routes to them."""
        starts = range(0, rows.shape[0], _SITES_PER_PASS)
        found = [self._pass(rows[start : start + _SITES_PER_PASS]) for start in starts]
        return np.concatenate(found) if found else np.zeros(0)

    def _pass(self, rows: csr_matrix) -> FloatArray:
        hit = csr_matrix(rows[:, self.edges].T)
        which = np.repeat(np.arange(len(self.edges)), np.diff(hit.indptr))
        unhit = np.zeros((self._count, rows.shape[0]))
        unhit[self._source] = 1.0
        for a, b, nodes, first in self._layers:
            arriving = unhit[self._tail[a:b]]
            arriving *= self._share[a:b]
            i, j = hit.indptr[a], hit.indptr[b]
            if j > i:
                arriving[which[i:j] - a, hit.indices[i:j]] = 0.0
            unhit[nodes] = np.add.reduceat(arriving, first, axis=0)
        return np.asarray(np.clip(1.0 - unhit[self._target], 0.0, 1.0))


def _layer_of_nodes(tail: IndexArray, head: IndexArray, count: int) -> IndexArray:
    """For each node (N,) the largest number of edges on a way to it from a node without entries."""
    order = np.argsort(tail, kind='stable')
    followers = head[order]
    first = np.searchsorted(tail[order], np.arange(count + 1))
    pending = np.bincount(head, minlength=count)
    layer = np.zeros(count, dtype=np.int64)
    free, depth = np.flatnonzero(pending == 0), 0
    while len(free):
        layer[free] = depth
        lengths = first[free + 1] - first[free]
        start = np.repeat(first[free] - np.cumsum(lengths) + lengths, lengths)
        reached = followers[start + np.arange(lengths.sum())]
        pending -= np.bincount(reached, minlength=count)
        free = np.unique(reached[pending[reached] == 0])
        depth += 1
    return layer
