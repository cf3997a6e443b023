# SPDX-License-Identifier: Apache-2.0
"""A leg's strategy conditioned on its routes avoiding some edges.

Drawing routes until one is clear samples this conditional strategy. Of a Markov chain it is again
one: let w = p / x be the probability of the next edge at its tail, and Z_i = sum w_ik Z_k that of
reaching the target from node i by clear edges; the next edge then has probability w_ik Z_k / Z_i.
Of a mixture of whole routes, the clear ones keep their odds.
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
    """A strategy whose routes can be conditioned on avoiding edges, unless it has a cycle."""

    def __init__(self, strategy: Strategy) -> None:
        self.strategy = strategy

    @cached_property
    def _chain(self) -> MarkovChain | None:
        network, p = self.strategy.network, self.strategy.edge_probability
        return chain_of(network, p) if is_acyclic(network, p) else None

    @cached_property
    def _nodes(self) -> IndexArray:
        """Numbers (n,) of the chain's nodes in the whole network."""
        assert self._chain is not None
        network = self._chain.network
        nodes = np.zeros(network.count, dtype=np.int64)
        nodes[network.tail], nodes[network.head] = self.strategy.network.edges[network.edge].T
        return nodes

    def avoiding(self, lost: BoolArray) -> tuple[float, Law | None]:
        """Return the probability that a route avoids the edges ``lost`` (M,), and the law then.

        The law is None if no route does.
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

    def rest_flow(self, start: FloatArray, lost: BoolArray) -> FloatArray:
        """Return the flow p (M,) of rests of routes that avoid the edges ``lost`` (M,).

        They start at each node with probability ``start`` (N,). Raises ValueError if none is clear.
        """
        shares = self._clear_shares(lost)
        if self._chain is None or not shares.any():
            raise ValueError('no rest of a route is clear')
        network = self._chain.network
        visits = network.onwards.solve(shares, start[self._nodes])
        if visits[-1] == 0.0:
            raise ValueError('no rest of a route is clear')
        return sums(network.edge, visits[network.tail] * shares, len(lost))

    def draw_rest(self, node: int, lost: BoolArray, rng: np.random.Generator) -> IndexArray | None:
        """Draw the rest of a route from ``node`` that avoids the edges ``lost`` (M,).

        Returns the nodes (K,) from there to the target; None if no route leads on.
        """
        if self._chain is None or node not in self._nodes:
            return None
        network, shares = self._chain.network, self._clear_shares(lost)
        nodes = [int(np.flatnonzero(self._nodes == node)[0])]
        while nodes[-1] < network.count - 1:
            first, end = np.searchsorted(network.tail, (nodes[-1], nodes[-1] + 1))
            edges = first + np.flatnonzero(shares[first:end])
            if not len(edges):
                return None
            edges = edges[np.argsort(network.edge[edges])]  # the same on all machines
            odds = shares[edges]
            nodes.append(int(network.head[edges[rng.choice(len(edges), p=odds / odds.sum())]]))
        return self._nodes[nodes]

    def _clear_shares(self, lost: BoolArray) -> FloatArray:
        """Probability (m,) of each chain edge at its tail, given that the route is clear."""
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
    """Return the probability that a route avoids the ``lost`` edges, and the law of each leg then.

    It is 0, and there are no laws, if no route does.
    """
    share, laws = 1.0, list[Law]()
    for leg, leg_lost in zip(legs, lost, strict=True):
        clear, law = leg.avoiding(leg_lost)
        if law is None:
            return 0.0, []
        share *= clear
        laws.append(law)
    return share, laws
