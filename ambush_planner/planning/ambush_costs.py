# SPDX-License-Identifier: Apache-2.0
"""The best ambush against a trip."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix

from ..arrays import ROUNDING
from ..game.hits import largest_product
from ..game.strategy import TripStrategy
from ..maps.risk_map import RiskMap
from .cell_losses import CellLosses, CellSearch


class BestAmbush(NamedTuple):
    """The place (x, y) [m] of a best ambush, and the share of the departures that it hits.

    On a trip with stops, those that are hit on any leg.
    """

    xy: tuple[float, float]
    hit: float


def holds_at_cells(trip: TripStrategy) -> bool:
    """Return whether the ambusher may wait anywhere, not only at the network's nodes."""
    return trip.game.options.widened > 0.0


def best_ambush(trip: TripStrategy, risk_map: RiskMap) -> BestAmbush | None:
    """Find the place where an ambush causes the value; None if none causes a loss."""
    game, legs = trip.game, trip.joint
    loss, row = largest_product(legs.loss, legs.entering, trip.law)
    if not trip.value > 0.0 or row < 0:
        return None
    point, entering = legs.site_points[row], legs.entering[row]
    if holds_at_cells(trip) and loss < trip.value * (1.0 - ROUNDING):
        cells = CellLosses(risk_map, game.options.ambush_in_obstacles)
        used = trip.law.uses(legs.edge_count) > 0.0
        found = CellSearch(cells, legs.games, used).worst(trip.law, loss)
        if len(found.points):
            point, entering = found.points[0], found.entering[0]
    hits = [float(leg.law.meets(own)[0]) for leg, own in zip(
        trip.legs, legs.rows_by_leg(csr_matrix(entering)), strict=True)]
    x, y = point.tolist()
    return BestAmbush((x, y), 1.0 - float(np.prod(1.0 - np.minimum(hits, 1.0))))
