# SPDX-License-Identifier: Apache-2.0
"""A leg's strategy conditioned on its routes avoiding some edges.

Drawing routes until one is clear samples this conditional strategy. On an acyclic network it is
exact: let w = p / x be the probability of the next edge, and Z_i = sum w_ik Z_k that of reaching
the target from node i by the other edges; the next edge then has probability w_ik Z_k / Z_i. Of a
mixture of whole routes, those that are clear keep their odds.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property

import numpy as np

from ..arrays import BoolArray, FloatArray, IndexArray, sums
from ..game.distribution.acyclic import is_acyclic
from ..game.distribution.chain import MarkovChain, RouteMixture, chain_of
from ..game.hits import Law
from ..game.strategy import Strategy


class ConditionedStrategy:
    """The conditional strategies of one strategy; there are none if it has a cycle."""

    def __init__(self, strategy: Strategy) -> None:
        self.strategy = strategy

    @cached_property
    def _chain(self) -> MarkovChain | None:
        network, p = self.strategy.network, self.strategy.edge_probability
        return chain_of(network, p) if is_acyclic(network, p) else None

    @cached_property
    def _nodes(self) -> IndexArray:
        """The nodes of the chain in the whole network."""
        assert self._chain is not None
        on = self._chain.network
        nodes = np.zeros(on.count, dtype=np.int64)
        nodes[on.tail], nodes[on.head] = self.strategy.network.edges[on.edge].T
        return nodes

    def avoiding(self, lost: BoolArray) -> tuple[float, Law | None]:
        """The probability that a route avoids the edges ``lost`` (M,), and the law of these.

        The law is None if none does.
        """
        if not lost[self.strategy.edge_probability > 0.0].any():
            return 1.0, self.strategy.law
        if mixture := self.strategy.mixture:
            clear = np.array([not lost[route].any() for route in mixture.routes])
            share = float(mixture.shares[clear].sum())
            if not share > 0.0:
                return 0.0, None
            return share, RouteMixture(mixture.routes, mixture.shares * clear / share, mixture.leg)
        if self._chain is None:
            return 0.0, None
        clear_chain, share = self._chain.avoiding(np.flatnonzero(lost[self._chain.network.edge]))
        return share, clear_chain if share > 0.0 else None

    def onwards(self, begins: FloatArray, lost: BoolArray) -> FloatArray:
        """p (M,) of rests of routes without the edges ``lost`` (M,).

        They begin at each node with probability ``begins`` (N,). ValueError if none is clear.
        """
        chances = self._chances(lost)
        if self._chain is None or not chances.any():
            raise ValueError('no rest of a route is clear')
        network = self._chain.network
        visits = network.onwards.solve(chances, begins[self._nodes])
        if visits[-1] == 0.0:
            raise ValueError('no rest of a route is clear')
        return sums(network.edge, visits[network.tail] * chances, len(lost))

    def draw_from(self, node: int, lost: BoolArray, rng: np.random.Generator) -> IndexArray | None:
        """Draw how a route goes on from ``node`` without the edges ``lost`` (M,).

        Returns the nodes (K,) from there to the target; None if no route does.
        """
        if self._chain is None or node not in self._nodes:
            return None
        network, chances = self._chain.network, self._chances(lost)
        nodes = [int(np.flatnonzero(self._nodes == node)[0])]
        while nodes[-1] < network.count - 1:
            first, end = np.searchsorted(network.tail, (nodes[-1], nodes[-1] + 1))
            own = first + np.flatnonzero(chances[first:end])
            if not len(own):
                return None
            own = own[np.argsort(network.edge[own])]  # the same on all machines
            weights = chances[own]
            nodes.append(int(network.head[own[rng.choice(len(own), p=weights / weights.sum())]]))
        return self._nodes[nodes]

    def _chances(self, lost: BoolArray) -> FloatArray:
        """Return the probability of each chain edge at its tail (m,), on the way to the target."""
        if self._chain is None:
            return np.zeros(0)
        network = self._chain.network
        share, target = self._chain.share * ~lost[network.edge], np.zeros(network.count)
        target[0] = 1.0
        clear = network.backwards.solve(share, target)[::-1]
        return np.asarray(share * clear[network.head]
                          / np.maximum(clear, np.finfo(float).tiny)[network.tail])


def clear_laws(legs: Iterable[ConditionedStrategy],
               lost: Iterable[BoolArray]) -> tuple[float, list[Law]]:
    """The probability that a route avoids the ``lost`` edges of each leg, and the legs' laws then.

    0 and no laws if none does.
    """
    share, laws = 1.0, list[Law]()
    for leg, own in zip(legs, lost, strict=True):
        clear, law = leg.avoiding(own)
        if law is None:
            return 0.0, []
        share *= clear
        laws.append(law)
    return share, laws
