"""What somebody is worth to the ambusher who sees whether the convoy passes a place.

A spotter at site i tells the ambusher whether the route comes within reach of i; only then does he
choose where to wait. With the published strategy he then causes

    max over j of alpha_j P(hit j and i)  +  max over j of alpha_j P(hit j, not i),

the k largest instead of the largest if he holds k sites. Routes that avoid i are a Markov chain of
their own: the strategy's, on condition that it uses no edge into the disc of i. The other routes
are the difference (docs/theory.md, Proposition 5.7).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from ..arrays import FloatArray, IndexArray, sums
from .hits import largest
from .law.acyclic import is_acyclic
from .law.chain import MarkovChain, chain_of
from .strategy import Strategy

# Places that are tried for the spotter.
MAX_PLACES = 300
# Probabilities of passing, or not passing, below which a spotter tells nothing.
CERTAIN = 1e-9


@dataclass(frozen=True)
class Spotter:
    """The worst place (x, y) [m] of a spotter, and the mean loss with what he tells.

    ``factor`` is this over the value without him.
    """

    x: float
    y: float
    loss: float
    factor: float


def worst_spotter(strategy: Strategy) -> Spotter | None:
    """The worst of the sites for a spotter; of more than ``MAX_PLACES``, every second, third, ...

    None if the value is 0, the strategy has cycles, or he learns nothing anywhere.
    """
    game, p = strategy.game, strategy.edge_probability
    if not strategy.value > 0.0 or not is_acyclic(game.network, p):
        return None
    chain = chain_of(game.network, p)
    rows = chain.network.columns(game.hits)
    told = _Told(chain, rows, game.loss[game.sites], game.ambushers)
    passes = told.passes
    some = np.flatnonzero((passes > CERTAIN) & (passes < 1.0 - CERTAIN))
    some = some[:: -(-len(some) // MAX_PLACES) or 1]
    most, best, at = told.bounds(some), 0.0, -1
    for k in np.argsort(-most, kind='stable').tolist():
        if most[k] <= best:
            break
        if (loss := told.loss(int(some[k]))) > best:
            best, at = loss, int(some[k])
    if at < 0:
        return None
    x, y = game.network.points[game.sites[at]].tolist()
    return Spotter(x, y, best, best / strategy.value)


class _Told:
    """Mean losses by an ambusher of a chain who knows whether the route passes one site.

    ``rows`` (S, m) are the edges that enter each disc, ``loss`` (S,) is what each site costs.
    """

    def __init__(self, chain: MarkovChain, rows: csr_matrix, loss: FloatArray,
                 ambushers: int) -> None:
        self._chain, self._rows, self._loss, self._k = chain, rows, loss, ambushers
        self.passes = chain.hits(rows)

    def bounds(self, sites: IndexArray) -> FloatArray:
        """What ``loss`` (K,) of some sites is at most."""
        found = []
        for x in self.passes[sites].tolist():
            both = (np.minimum(self.passes, share) * self._loss for share in (x, 1.0 - x))
            found.append(sum(float(_largest_sum(each, self._k)) for each in both))
        return np.array(found)

    def loss(self, site: int) -> float:
        """Mean loss if the ambusher knows whether the route passes ``site``."""
        without, share = self._avoiding(self._rows[site].indices)
        p = self._chain.p
        entries_without = np.minimum(self._rows @ (share * without.p), share)
        entries_with = self._rows @ np.maximum(p - share * without.p, 0.0)
        entries_with = np.minimum(entries_with, np.minimum(self.passes, 1.0 - share))

        def missed(rows: IndexArray) -> FloatArray:
            return self._loss[rows] * share * without.hits(self._rows[rows])

        def passed(rows: IndexArray) -> FloatArray:
            return self._loss[rows] * self.passes[rows] - missed(rows)

        return sum(float(largest(self._loss * entries, exact, self._k)[0].sum()) for entries, exact
                   in ((entries_without, missed), (entries_with, passed)))

    def _avoiding(self, entering: IndexArray) -> tuple[MarkovChain, float]:
        """The chain of the routes that use no edge ``entering`` (K,), and their probability."""
        network = self._chain.network
        share = self._chain.share.copy()
        share[entering] = 0.0
        last = np.zeros(network.count)
        last[0] = 1.0
        clear = network.backwards.solve(share, last)[::-1]
        start = np.zeros(network.count)
        start[0] = 1.0
        visits = network.onwards.solve(share, start)
        p = visits[network.tail] * share * clear[network.head]
        return MarkovChain(network, p), float(sums(network.head, p, network.count)[-1])


def _largest_sum(losses: FloatArray, k: int) -> float:
    """The sum of the k largest."""
    k = min(k, len(losses))
    return float(np.partition(losses, len(losses) - k)[len(losses) - k :].sum())
