# SPDX-License-Identifier: Apache-2.0
"""The value of an informant who sees whether the convoy passes a place, and tells the ambusher.

An informant at site i tells the ambusher whether the route comes within reach of i; only then does
he choose where to wait (docs/theory.md, Proposition 5.7). With the published strategy he causes

    max over j of alpha_j P(hit j and i)  +  max over j of alpha_j P(hit j, not i).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from ..arrays import ROUNDING, FloatArray, IndexArray
from .distribution.acyclic import is_acyclic
from .distribution.chain import MarkovChain, chain_of
from .hits import largest
from .strategy import Strategy

# Largest number of sites that are tried for the informant; of more, every second, third, ...
MAX_PLACES = 300


@dataclass(frozen=True)
class Informant:
    """An informant's worst place (x, y) [m], the mean loss with what he tells, over the value."""

    x: float
    y: float
    loss: float
    factor: float


def worst_informant(strategy: Strategy) -> Informant | None:
    """The worst of up to ``MAX_PLACES`` sites for an informant.

    None if the value is 0, the strategy has cycles, or he learns nothing anywhere.
    """
    game, p = strategy.game, strategy.edge_probability
    if not strategy.value > 0.0 or not is_acyclic(game.network, p):
        return None
    chain = chain_of(game.network, p)
    rows, alpha = chain.network.columns(game.entering), game.loss[game.sites]
    hits, passing = chain.hits(rows), chain.hits((rows > 0.0).astype(np.float64))
    some = np.flatnonzero((passing > ROUNDING) & (passing < 1.0 - ROUNDING))
    some = some[:: -(-len(some) // MAX_PLACES) or 1]
    if not len(some):
        return None
    losses = [_loss(chain, rows, alpha, hits, site) for site in some.tolist()]
    worst = int(np.argmax(losses))
    x, y = game.network.points[game.sites[some[worst]]].tolist()
    return Informant(x, y, losses[worst], losses[worst] / strategy.value)


def _loss(chain: MarkovChain, rows: csr_matrix, alpha: FloatArray, hits: FloatArray,
          site: int) -> float:
    """Mean loss if the ambusher knows whether ``site`` is hit.

    ``rows`` (S, m) are what edges count that enter each disc, ``hits`` (S,) what it is hit.
    """
    clear, share = chain.avoiding(rows[site].indices)

    def missed(some: IndexArray) -> FloatArray:
        return np.asarray(alpha[some] * share * clear.hits(rows[some]))

    def passed(some: IndexArray) -> FloatArray:
        return np.asarray(alpha[some] * hits[some] - missed(some))

    # Entries bound the hits.
    without = np.minimum(rows @ (share * clear.p), share)
    along = np.minimum(rows @ np.maximum(chain.p - share * clear.p, 0.0), 1.0 - share)
    return sum(largest(alpha * most, exact)
               for most, exact in ((without, missed), (along, passed)))
