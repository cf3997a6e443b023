# SPDX-License-Identifier: Apache-2.0
"""A strategy conditioned on its routes avoiding some edges.

Drawing routes until one is clear samples this conditional strategy. On an acyclic network it is
exact: let w = p / x be the probability of the next edge, and Z_i = sum w_ik Z_k that of reaching
the target from node i by the other edges; the next edge then has probability w_ik Z_k / Z_i.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IndexArray
from ..game.distribution.acyclic import order_along
from ..game.distribution.chain import MarkovChain, chain_of
from ..game.strategy import Strategy


class ConditionedStrategy:
    """The conditional strategies of one strategy."""

    def __init__(self, strategy: Strategy) -> None:
        network, p = strategy.network, strategy.edge_probability
        self._network, self._p = network, p
        number, used = order_along(network, p), np.flatnonzero(p > 0.0)
        self._order = used[:0] if number is None else used[np.argsort(number[network.tails[used]])]
        tails = network.tails[self._order]
        leaving = np.bincount(tails, p[self._order], len(network.points))
        self._tails, self._heads = tails.tolist(), network.heads[self._order].tolist()
        self._chances = (p[self._order] / leaving[tails]).tolist()

    def avoiding(self, lost: npt.NDArray[np.bool_]) -> tuple[float, FloatArray]:
        """Return the probability that a route avoids the edges ``lost`` (M,), and the new p (M,).

        Both are 0 if no route does, or if the strategy has a cycle.
        """
        if not len(self._order):
            return 0.0, np.zeros(len(lost))
        clear, share = self._chain.avoiding(np.flatnonzero(lost[self._chain.network.edge]))
        return share, clear.uses(len(lost))

    @cached_property
    def _chain(self) -> MarkovChain:
        return chain_of(self._network, self._p)

    def draw_from(self, node: int, lost: npt.NDArray[np.bool_],
                  rng: np.random.Generator) -> IndexArray | None:
        """Draw how a route goes on from ``node`` without the edges ``lost`` (M,).

        Returns the nodes (K,) from there to the target; None if no route does, or if the strategy
        has a cycle.
        """
        target_share = self._target_share(lost)
        if target_share[node] == 0.0:
            return None
        leaving: dict[int, list[tuple[int, float]]] = {}
        for tail, head, chance, clear in self._clear_steps(lost):
            if clear and target_share[head] > 0.0:
                leaving.setdefault(tail, []).append((head, chance * target_share[head]))
        nodes = [node]
        while nodes[-1] != self._network.target:
            heads, weights = zip(*leaving[nodes[-1]], strict=True)
            nodes.append(heads[int(rng.choice(len(heads), p=np.divide(weights, sum(weights))))])
        return np.array(nodes)

    def flow_after(self, node: int, lost: npt.NDArray[np.bool_]) -> FloatArray:
        """Return p (M,) of the rests that ``draw_from`` draws; ValueError if there are none."""
        share, visits = self._target_share(lost), [0.0] * len(self._network.points)
        if share[node] == 0.0:
            raise ValueError('no rest of a route is clear')
        visits[node], flows = 1.0, []
        for tail, head, chance, clear in self._clear_steps(lost):
            flows.append(visits[tail] * chance * share[head] / share[tail]
                         if clear and visits[tail] else 0.0)
            visits[head] += flows[-1]
        result = np.zeros(len(self._p))
        result[self._order] = flows
        return result

    def _target_share(self, lost: npt.NDArray[np.bool_]) -> list[float]:
        """Return Z (N,), the probability of reaching the target without the edges ``lost``."""
        share = [0.0] * len(self._network.points)
        share[self._network.target] = 1.0 if len(self._order) else 0.0
        for tail, head, chance, clear in reversed(self._clear_steps(lost)):
            if clear:
                share[tail] += chance * share[head]
        return share

    def _clear_steps(self, lost: npt.NDArray[np.bool_]) -> list[tuple[int, int, float, bool]]:
        """Tail, head, probability at the tail, and whether it is not lost, of each edge in use."""
        kept = (~lost[self._order]).tolist()
        return list(zip(self._tails, self._heads, self._chances, kept, strict=True))

    def flow_from(self, p: FloatArray, begins: FloatArray) -> FloatArray:
        """Return p (M,) of routes that begin at nodes with ``begins`` (N,) and go on as in p."""
        visits, flows, result = begins.tolist(), [], np.zeros(len(p))
        for tail, head, chance in zip(*self._steps(p), strict=True):
            flows.append(visits[tail] * chance)
            visits[head] += flows[-1]
        result[self._order] = flows
        return result

    def _steps(self, p: FloatArray) -> tuple[list[int], list[int], list[float]]:
        """Tails and heads of the edges in use, in order, and their probabilities at the tails."""
        tails = self._network.tails[self._order]
        leaving = np.bincount(tails, p[self._order], len(self._network.points))[tails]
        chances = p[self._order] / np.where(leaving > 0.0, leaving, 1.0)
        return self._tails, self._heads, chances.tolist()
