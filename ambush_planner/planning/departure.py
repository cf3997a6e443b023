# SPDX-License-Identifier: Apache-2.0
"""The draw of a departure: its route and its path follow from a plan and a random source."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import FloatArray
from ..maps.occupancy import OccupancyMap
from ..routes.driven_path import Ends
from .plan import Plan, Route, departure_path

if TYPE_CHECKING:
    from .changed_ground import ChangedGround


@dataclass(frozen=True, eq=False)
class DrawnRoute:
    """A route, the nodes of each leg, and the poses (L, 3) = (x, y, yaw) of its path [m, m, rad].

    ``rng`` is the generator that drew it, for what is drawn after it.
    """

    route: Route
    poses: FloatArray
    rng: np.random.Generator


def draw_route(plan: Plan, source: Sequence[int], spacing: float = 0.0, ends: Ends | None = None,
               ground: ChangedGround | None = None,
               newest: OccupancyMap | None = None) -> DrawnRoute | None:
    """Draw the route of a departure, and its path between ``ends`` [m].

    ``source`` seeds the generator, and nothing else is random. Poses are at most ``spacing`` [m]
    apart (0: the plan's). On changed ``ground``, routes are drawn until one is clear on the newest
    map; None if hardly any is.
    """
    rng = np.random.default_rng(source)
    if ground is None or newest is None:
        route: Route | None = tuple(leg.sample_route(rng) for leg in plan.legs)
    else:
        route = ground.draw(rng, newest)
        plan = ground.fitted(newest, ends) if ends else plan
    if route is None:
        return None
    return DrawnRoute(route, departure_path(plan, route, spacing or plan.spacing, ends), rng)
