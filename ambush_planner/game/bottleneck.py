# SPDX-License-Identifier: Apache-2.0
"""The sites that decide the value."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import NEGLIGIBLE, IndexArray, frozen_array
from .discs import secured_area
from .strategy import Strategy

# Sites are near the source, a stop or the target within this many median edge lengths.
NEAR_EDGES = 2.0


@dataclass(frozen=True, eq=False)
class Bottleneck:
    """The ambusher's sites and where they lie.

    The equilibrium ambusher waits only at ``sites`` (K,): in the plain game, a minimum cut.
    ``near_ends`` counts the sites within ``distance`` [m] of source, stops or target.
    """

    sites: IndexArray
    near_ends: int
    distance: float


def find_bottleneck(strategy: Strategy) -> Bottleneck:
    """Report the sites that decide the strategy's value."""
    game, q = strategy.game, strategy.ambush_at_places
    network, first = game.network, game.network.representatives
    decisive = (q > NEGLIGIBLE * q.max()) & (game.loss[first] > 0.0)
    sites = first[decisive & (strategy.value > 0.0)]
    distance = NEAR_EDGES * float(np.median(network.lengths[game.playable]))
    near = secured_area(network, distance).covers(network.points[sites])
    return Bottleneck(frozen_array(sites, np.int64), int(near.sum()), distance)
