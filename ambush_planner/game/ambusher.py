# SPDX-License-Identifier: Apache-2.0
"""The ambusher's mixed strategy: where he waits, and what the convoy's budget is worth to him."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import ROUNDING, FloatArray, frozen_array
from ..errors import SolverFailed
from .budget import Budget
from .faces import Circulation
from .game import Game


@dataclass(frozen=True, eq=False)
class Ambusher:
    """An ambusher's strategy that proves a lower bound of the value.

    Attributes
    ----------
    q : (N,)
        How likely he waits at each node; sums to 1.
    price : float
        Decrease of the bound per unit of the length budget.
    by_leg : (stops + 1, N) or None
        On a trip: for which leg he waits at each node, adding up to at most q at each place.
    circulation : Circulation or None
        Closed curves between the faces of a planar network that prove the bound.
    """

    q: FloatArray
    price: float = 0.0
    by_leg: FloatArray | None = None
    circulation: Circulation | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, 'q', frozen_array(self.q, np.float64))
        if self.by_leg is not None:
            object.__setattr__(self, 'by_leg', frozen_array(self.by_leg, np.float64))

    def check(self, game: Game) -> None:
        """Raise SolverFailed if q is no strategy of the ambusher, or a price is negative."""
        q, most = self.q, 1.0 + ROUNDING
        if not (q >= 0.0).all() or not (q <= most).all():
            raise SolverFailed(f'q must be in [0, 1] at each place, got {q.min()} to {q.max()}')
        if not abs(q.sum() - 1.0) <= ROUNDING:
            raise SolverFailed(f'q must sum to 1, got {q.sum()}')
        if self.by_leg is not None and not (
            (self.by_leg >= 0.0).all()
            and (game.at_places(self.by_leg.sum(axis=0)) <= game.at_places(q) * most).all()
        ):
            raise SolverFailed('the shares of the legs do not add up to q')
        if not self.price >= 0.0:
            raise SolverFailed(f'the price of the length budget is {self.price}, not >= 0')

    def paid(self, game: Game, budget: Budget) -> tuple[FloatArray, float]:
        """What each edge (M,) pays for the budget, and what that is worth to the convoy."""
        if self.price == 0.0:
            return np.zeros(len(game.network.edges)), 0.0
        return self.price * budget.reduced_cost, self.price * budget.slack


def padded(shares: FloatArray, count: int) -> FloatArray:
    """Shares (..., K) of the first sites as those (..., count) of all, 0 for the others."""
    more = np.zeros((*shares.shape[:-1], count - shares.shape[-1]))
    return np.concatenate((shares, more), axis=-1)


def on_nodes(game: Game, shares: FloatArray) -> FloatArray:
    """Shares (..., S) of the sites as shares (..., N) of their first nodes."""
    nodes = np.zeros((*shares.shape[:-1], game.node_count))
    nodes[..., game.sites] = shares
    return nodes


def at_nodes(game: Game, q: FloatArray) -> FloatArray:
    """q (N,) of an ambusher with shares q (S,) of the sites, scaled to sum to 1.

    Without any share it is spread over all sites, or over all places if there is no site.
    """
    nodes = np.zeros(game.node_count)
    nodes[game.sites if len(game.sites) else game.network.representatives] = 1.0
    if (top := q.max(initial=0.0)) > 0.0:  # the sum may be too small to divide by
        nodes = on_nodes(game, q / top)
    return np.asarray(nodes / nodes.sum())
