"""Which sites decide the value, and what the rest of the map would allow."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..arrays import IndexArray, frozen_array
from .discs import near_ends
from .least_risk import least_value
from .revaluation import budgets_in
from .strategy import Strategy

# Sites this many median edges from the source, a stop or the target are said to hug it.
NEAR = 2.0
# Share of the ambusher's mass that makes a site count.
COUNTS = 1e-6
# The secured value is no further off than this, relative.
ROUGH = 0.01


@dataclass(frozen=True, eq=False)
class Bottleneck:
    """The ambusher's sites and where they lie.

    ``sites`` (K,) are the nodes that decide the value: the equilibrium ambusher waits only there
    (in the plain game, a minimum cut). ``near_ends`` counts those within ``distance`` [m] of
    source, stops or target. ``secured_value`` is the value if nobody could wait within ``distance``
    of these ends; it equals ``value`` when no site hugs them.
    """

    sites: IndexArray
    near_ends: int
    distance: float
    value: float
    secured_value: float


def find_bottleneck(strategy: Strategy, deadline: float = math.inf) -> Bottleneck:
    """Report the sites that decide the strategy's value.

    The secured value is the least one within the strategy's own budgets if nobody could wait near
    the ends; at ``deadline`` (``time.monotonic``) it is what is known by then, a lower bound.
    """
    game, q = strategy.game, strategy.ambush_probability
    network = game.network
    decisive = (q > COUNTS * q.max()) & (game.loss > 0.0) & (strategy.value > 0.0)
    sites = np.flatnonzero(decisive)
    distance = NEAR * float(np.median(network.lengths[game.playable]))
    near = near_ends(network, distance)
    secured = strategy.value
    if near[sites].any():
        game = game.without_sites(near)
        least = least_value(game, budgets_in(game, strategy), ROUGH, deadline)
        secured = min(least, strategy.value)
    return Bottleneck(
        frozen_array(sites, np.int64),
        int(near[sites].sum()),
        distance,
        strategy.value,
        secured,
    )
