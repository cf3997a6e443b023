# SPDX-License-Identifier: Apache-2.0
"""The sites that decide the value, and how many of them lie near the ends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import NEGLIGIBLE, IndexArray, frozen_array
from .discs import secured_area
from .strategy import TripStrategy

# Distance from an end within which a site counts as near it, in median edge lengths.
NEAR_EDGES = 2.0


@dataclass(frozen=True, eq=False)
class Bottleneck:
    """The sites (K,) at which the ambusher waits: without a reach or budget, a minimum cut.

    ``near_ends`` counts the sites within ``distance`` [m] of source, stops or target.
    """

    sites: IndexArray
    near_ends: int
    distance: float


def find_bottleneck(trip: TripStrategy) -> Bottleneck:
    """Find the sites that decide the value of a trip."""
    game, q = trip.game, trip.ambusher.q
    network = game.network
    sites = np.flatnonzero((q > NEGLIGIBLE * q.max()) & (game.loss > 0.0) & (trip.value > 0.0))
    distance = NEAR_EDGES * float(np.median(network.lengths[game.playable]))
    ends = np.unique([(leg.network.source, leg.network.target) for leg in trip.legs])
    near = secured_area(network.points[ends], distance).covers(network.points[sites])
    return Bottleneck(frozen_array(sites, np.int64), int(near.sum()), distance)
