# SPDX-License-Identifier: Apache-2.0
"""How a convoy joins the routes of a plan, so that the best ambush costs it least.

It drives to one of several nodes, drawn with probabilities x, and goes on from there as the plan's
routes do. Site s hits the routes that begin at node n with probability H_sn, so its mean loss,
alpha_s (H x)_s, is linear in x: this is a matrix game, with a limit on the mean length. Both sides
learn by optimistic multiplicative weights (A. Rakhlin, K. Sridharan, *Optimization, learning, and
games with predictable sequences*, NIPS 2013). Their mean strategies come within about a per cent of
the value (measured). Unlike a vertex of a linear program they use many nodes, and rounding hardly
changes them, so that ``ambush verify`` finds the same ones.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.sparse import csr_matrix

from ..arrays import FloatArray, IndexArray, sums
from ..game.distribution.chain import MarkovChain, chain_of
from ..game.game import Game
from .cell_losses import CellSearch

# Number of rounds, and the weight of each, with losses as shares of the largest one.
_ROUNDS, _STEP = 500, 2.0
# Maximum number of searches for places between the nodes, how much more than the sites so far these
# must cost, and how far apart they are [reaches].
_SEARCHES, _MORE, _APART = 6, 1.02, 0.25


def best_first_steps(game: Game, p: FloatArray, longest: float,
                     search: CellSearch | None) -> FloatArray:
    """Return the best probability of each edge out of the source that p (M,) uses, in their order.

    Routes go on as in p, which is acyclic, and their mean length [m] is about ``longest`` at most,
    if that is possible. Places that a ``search`` finds are sites, too.
    """
    chain = chain_of(game.network, p)
    first = np.flatnonzero(chain.network.tail == 0)
    lengths = _mean_lengths(chain, game.network.lengths[chain.network.edge], first)
    over = lengths / max(longest, lengths.min()) - 1.0
    losses = game.loss[game.sites][:, None] * _hits(chain, game.entering, first)
    best, least = np.zeros(len(first)), math.inf
    for _ in range(_SEARCHES):
        x = least_worst(losses, over)
        value = known = float((losses @ x).max(initial=0.0))
        if search:
            found = search.worst(_beginning(chain, first, x), _MORE * known, _APART * game.reach)
            value = max([known, *found.mean_loss[:1]])
        if value < least:
            best, least = x, value
        if value == known:
            break
        more = found.alpha[:, None] * _hits(chain, found.entering, first)
        losses = np.concatenate((losses, more))
    return best[np.argsort(chain.network.edge[first])]


def _beginning(chain: MarkovChain, first: IndexArray, x: FloatArray) -> MarkovChain:
    """The chain that begins with each of the edges ``first`` (F,) with probability x (F,)."""
    network, share, start = chain.network, chain.share.copy(), np.zeros(chain.network.count)
    share[first], start[0] = x, 1.0
    return MarkovChain(network, network.onwards.solve(share, start)[network.tail] * share)


def _hits(chain: MarkovChain, entering: csr_matrix, first: IndexArray) -> FloatArray:
    """How likely each site (S,) hits the routes that begin with each of the edges ``first`` (F,).

    The rows ``entering`` (S, M) have the edges of the whole network that enter its disc.
    """
    network, rows = chain.network, chain.network.columns(entering)
    found = np.zeros((rows.shape[0], network.count))
    for site in np.flatnonzero(np.diff(rows.indptr)).tolist():
        own = slice(rows.indptr[site], rows.indptr[site + 1])
        edges, share = rows.indices[own], chain.share.copy()
        hit = sums(network.tail[edges], share[edges] * rows.data[own], network.count)
        share[edges] = 0.0
        found[site] = network.backwards.solve(share, hit[::-1])[::-1]
    direct = rows[:, first].toarray()
    return np.where(direct > 0.0, direct, found[:, network.head[first]])


def _mean_lengths(chain: MarkovChain, length: FloatArray, first: IndexArray) -> FloatArray:
    """The mean length of the routes that begin with each of the edges ``first`` (F,)."""
    network = chain.network
    own = sums(network.tail, chain.share * length, network.count)
    ahead = network.backwards.solve(chain.share, own[::-1])[::-1]
    return np.asarray(length[first] + ahead[network.head[first]])


def least_worst(losses: FloatArray, over: FloatArray) -> FloatArray:
    """The mixture (F,) of columns of losses (S, F) >= 0 whose largest loss is nearly the least.

    Its mean of ``over`` (F,) is nearly 0 at most.
    """
    scale = losses.max(initial=0.0) or 1.0
    losses = losses / scale
    x, q = (np.full(size, 1.0 / size) for size in losses.shape[::-1])
    paid, caused, price, mean = np.zeros(len(x)), np.zeros(len(q)), 0.0, np.zeros(len(x))
    for _ in range(_ROUNDS):
        pays, causes = q @ losses + price * over, losses @ x
        price = max(price + float(over @ x), 0.0)
        paid, caused = paid + pays, caused + causes
        # Each side takes the latest round for the next one, too.
        x, q = _weights(-paid - pays), _weights(caused + causes)
        mean += x
    return np.asarray(mean / mean.sum())


def _weights(gain: FloatArray) -> FloatArray:
    weights = np.exp(_STEP * (gain - gain.max()))
    return np.asarray(weights / weights.sum())
