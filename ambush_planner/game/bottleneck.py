# SPDX-License-Identifier: Apache-2.0
"""The sites that decide the value, and the value if the ends were secured."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..arrays import IndexArray, frozen_array
from .discs import held_ground
from .revaluation import budgets_in_game
from .solver import least_value
from .strategy import Strategy

# Sites are near the source, a stop or the target within this many median edge lengths.
NEAR_EDGES = 2.0
# Sites are decisive from this share of the ambusher's largest probability.
DECISIVE_SHARE = 1e-6
# Relative tolerance of the secured value.
SECURED_TOLERANCE = 0.05


@dataclass(frozen=True, eq=False)
class Bottleneck:
    """The ambusher's sites and where they lie.

    The equilibrium ambusher waits only at ``sites`` (K,): in the plain game, a minimum cut.
    ``near_ends`` counts the sites within ``distance`` [m] of source, stops or target.
    ``secured_value`` is the value if nobody could wait within ``distance`` of these ends; it
    equals ``value`` when no site is that near.
    """

    sites: IndexArray
    near_ends: int
    distance: float
    value: float
    secured_value: float


def find_bottleneck(strategy: Strategy, deadline: float = math.inf) -> Bottleneck:
    """Report the sites that decide the strategy's value.

    The secured value keeps the strategy's budgets. At ``deadline`` (``time.monotonic``) the best
    lower bound so far takes its place.
    """
    game, q = strategy.game, strategy.ambush_at_places
    network, first = game.network, game.network.representatives
    decisive = (q > DECISIVE_SHARE * q.max()) & (game.loss[first] > 0.0)
    sites = first[decisive & (strategy.value > 0.0)]
    distance = NEAR_EDGES * float(np.median(network.lengths[game.playable]))
    near = held_ground(network, distance).covers(network.points)
    secured = strategy.value
    if near[sites].any():
        game = game.without_copies().without_sites(near)
        budgets = budgets_in_game(game, strategy)
        secured = min(least_value(game, budgets, SECURED_TOLERANCE, deadline), strategy.value)
    count = int(near[sites].sum())
    return Bottleneck(frozen_array(sites, np.int64), count, distance, strategy.value, secured)
