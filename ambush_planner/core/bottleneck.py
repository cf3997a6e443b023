"""Which sites decide the value, and what the rest of the map would allow."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .arrays import frozen_array
from .game import BoolArray, Game, without_sites
from .game_value import solve_by_cut
from .network import IndexArray
from .strategy import Strategy

# Sites this many median edges from the source or the target are said to hug it.
NEAR = 2.0
# Share of the ambusher's mass that makes a site count.
COUNTS = 1e-6


@dataclass(frozen=True, eq=False)
class Bottleneck:
    """The ambusher's sites and where they lie.

    ``sites`` (K,) are the nodes that decide the value: the equilibrium ambusher waits only there
    (in the plain game, a minimum cut). ``near_source`` and ``near_target`` count those within
    ``distance`` [m] of either end. ``secured_value`` is the value if nobody could wait within
    ``distance`` of the ends; it equals ``value`` when no site hugs them.
    """

    sites: IndexArray
    near_source: int
    near_target: int
    distance: float
    value: float
    secured_value: float

    @property
    def near_ends(self) -> int:
        """How many of the sites are near the source or the target."""
        return self.near_source + self.near_target


def find_bottleneck(strategy: Strategy) -> Bottleneck:
    """Report the sites that decide the value (a max-flow at the most; no linear program).

    The secured value is that of the plain game without a length budget: exact where that is the
    strategy's game, otherwise a lower bound of what securing the ends would leave.
    """
    game, q = strategy.game, strategy.ambush_probability
    network = game.network
    decisive = (q > COUNTS * q.max()) & (game.loss > 0.0) & (strategy.value > 0.0)
    sites = np.flatnonzero(decisive)
    distance = NEAR * float(np.median(network.lengths[game.playable]))
    near_source = _within(game, network.source, distance)
    near_target = _within(game, network.target, distance)
    secured = strategy.value
    if (near_source | near_target)[sites].any():
        left = without_sites(game, near_source | near_target)
        secured = min(solve_by_cut(left).value, strategy.value)
    return Bottleneck(
        frozen_array(sites, np.int64),
        int(near_source[sites].sum()),
        int(near_target[sites].sum()),
        distance,
        strategy.value,
        secured,
    )


def _within(game: Game, node: int, distance: float) -> BoolArray:
    """Nodes (N,) within ``distance`` [m] of ``node``."""
    offset = game.network.points - game.network.points[node]
    return np.asarray(np.hypot(*offset.T) <= distance)
