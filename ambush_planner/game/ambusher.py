# SPDX-License-Identifier: Apache-2.0
"""The ambusher's mixed strategy: probabilities of sites, and prices of the length budgets."""

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
    """Ambusher's strategy that certifies a lower bound of the value.

    Attributes
    ----------
    q : (N,)
        Probability that the ambusher waits at each node; sums to 1.
    prices : (legs,)
        Decrease of the bound per unit of increase of each leg's length budget.
    circulations : (legs,) or empty
        Flows between the faces of each leg's planar network, from which the bound follows.
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
        """Return the ambusher's strategy against each leg alone."""
        return [replace(self, prices=(price,), circulations=self.circulations[k : k + 1])
                for k, price in enumerate(self.prices)]


class Ambush(NamedTuple):
    """Ambusher's strategy during a search: q (S,) over the known sites, some not yet nodes.

    ``prices`` (legs,) are those of the budgets; ``circulations`` number sites by their rows.
    """

    q: FloatArray
    prices: FloatArray
    circulations: tuple[Circulation, ...] = ()

    def ambusher(self, game: Game, used: BoolArray) -> Ambusher:
        """Return the strategy over the nodes of a game.

        ``used`` (S',) marks which of all sites found, of which these are the first, the game has.
        """
        node = np.full(len(used), -1)
        node[used] = game.sites
        q = np.append(self.q, np.zeros(len(used) - len(self.q)))[used]
        return Ambusher(at_nodes(game, q), tuple(self.prices.tolist()),
                        tuple(replace(each, site=node[each.site]) for each in self.circulations))


def at_nodes(game: Game, shares: FloatArray) -> FloatArray:
    """Return q (N,), in proportion to ``shares`` (S,) of the sites.

    It is uniform over the sites if all shares are 0, and over all nodes if there are no sites.
    """
    q = np.zeros(game.node_count)
    if not len(game.sites):
        q[:] = 1.0 / len(q)
        return q
    top = shares.max(initial=0.0)
    scaled = shares / top if top > 0.0 else np.ones(len(shares))  # the sum may be too small
    q[game.sites] = scaled / scaled.sum()
    return q
