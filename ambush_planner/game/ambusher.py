# SPDX-License-Identifier: Apache-2.0
"""The ambusher's mixed strategy: where to wait, and what the legs' length budgets are worth."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ..arrays import ROUNDING, BoolArray, FloatArray, frozen_array
from ..errors import SolverFailed
from .faces import Circulation
from .game import Game


@dataclass(frozen=True, eq=False)
class Ambusher:
    """An ambusher's strategy, which proves a lower bound of the value.

    Attributes
    ----------
    q : (N,)
        How likely the ambusher waits at each node; sums to 1.
    prices : (legs,)
        Decrease of the bound per unit of each leg's length budget.
    circulations : (legs,) or empty
        Closed curves between the faces of each leg's planar network, which prove the bound.
    """

    q: FloatArray
    prices: tuple[float, ...]
    circulations: tuple[Circulation, ...] = ()

    def __post_init__(self) -> None:
        q = frozen_array(self.q, np.float64)
        if not (q >= 0.0).all() or not abs(q.sum() - 1.0) <= ROUNDING:
            raise SolverFailed(f'q must be >= 0 and sum to 1, got {q.min()} and {q.sum()}')
        if not min(self.prices) >= 0.0:
            raise SolverFailed(f'prices of length budgets must be >= 0, got {self.prices}')
        object.__setattr__(self, 'q', q)

    def by_leg(self) -> list[Ambusher]:
        """The ambusher as each leg meets it."""
        return [replace(self, prices=(price,), circulations=self.circulations[k : k + 1])
                for k, price in enumerate(self.prices)]


class Ambush(NamedTuple):
    """An ambusher's probabilities at the known sites (S,), and prices (legs,) of the budgets.

    In ``circulations``, sites are rows.
    """

    q: FloatArray
    prices: FloatArray
    circulations: tuple[Circulation, ...] = ()

    def ambusher(self, game: Game, kept: BoolArray) -> Ambusher:
        """The same in a game with the ``kept`` ones of all sites (S',), which begin with S."""
        node = np.full(len(kept), -1)
        node[kept] = game.sites
        q = np.append(self.q, np.zeros(len(kept) - len(self.q)))[kept]
        return Ambusher(at_nodes(game, q), tuple(self.prices.tolist()),
                        tuple(replace(each, site=node[each.site]) for each in self.circulations))


def at_nodes(game: Game, shares: FloatArray) -> FloatArray:
    """q (N,) of an ambusher with ``shares`` (S,) of the sites, scaled to sum to 1.

    Spread over the sites if no site has a share, and over all nodes if there are no sites.
    """
    q = np.zeros(game.node_count)
    if not len(game.sites):
        q[:] = 1.0 / len(q)
        return q
    top = shares.max(initial=0.0)
    scaled = shares / top if top > 0.0 else np.ones(len(shares))  # the sum may be too small
    q[game.sites] = scaled / scaled.sum()
    return q
