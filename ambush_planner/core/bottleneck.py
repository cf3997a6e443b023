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
    (in the plain game, a minimum cut). ``near_ends`` counts those within ``distance`` [m] of source
    or target. ``secured_value`` is the value if nobody could wait within ``distance`` of the ends;
    it equals ``value`` when no site hugs them.
    """

    sites: IndexArray
    near_ends: int
    distance: float
    value: float
    secured_value: float


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
    near = _within(game, network.source, distance) | _within(game, network.target, distance)
    secured = strategy.value
    if near[sites].any():
        secured = min(solve_by_cut(without_sites(game, near)).value, strategy.value)
    return Bottleneck(
        frozen_array(sites, np.int64),
        int(near[sites].sum()),
        distance,
        strategy.value,
        secured,
    )


def _within(game: Game, node: int, distance: float) -> BoolArray:
    """Nodes (N,) within ``distance`` [m] of ``node``."""
    offset = game.network.points - game.network.points[node]
    return np.asarray(np.hypot(*offset.T) <= distance)
