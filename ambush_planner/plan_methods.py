# SPDX-License-Identifier: Apache-2.0
"""Methods of plans and strategies that reach up: to figures, files, tables, and ``operations``.

This is the one place where rooms above are imported late, when a method is used. So no room needs
those above it, nor the optional packages of figures and tables.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .arrays import FloatArray

if TYPE_CHECKING:
    from .game.strategy import TripStrategy
    from .maps.risk_map import RiskMap
    from .operations.frontier import FrontierRow
    from .planning.few import FewRoutes
    from .planning.plan import Plan

Random = np.random.Generator | int | None


def plot(trip: TripStrategy, risk_map: RiskMap | None, axes: Any) -> Any:
    """Draw map, strategies and ambush sites on matplotlib axes; return the axes."""
    from .figures import draw_strategy

    return draw_strategy(axes, trip, risk_map)


def save(plan: Plan, files: Sequence[Path | str], n: int, rng: Random) -> list[FloatArray]:
    """Draw ``n`` routes, write them to files and return their paths."""
    from .route_files import draw, write_routes

    drawn = draw(plan, n, rng)
    write_routes([Path(file) for file in files], drawn, plan)
    return list(drawn.paths)


def frontier(plan: Plan, detours: Sequence[float] | None,
             slacks: Sequence[float] | None) -> tuple[FrontierRow, ...]:
    """The rows of ``frontier`` for a plan's trip."""
    from .operations.frontier import DETOURS, SLACKS, trip_frontier

    return trip_frontier(plan.own_map, plan.start_xy, plan.goal_xy, plan.options,
                         DETOURS if detours is None else detours,
                         SLACKS if slacks is None else slacks,
                         stops=plan.stops_xy, planned=plan.trip)


def few_routes(plan: Plan, most: int, rng: Random, end: float) -> FewRoutes:
    """The best mixture found of a plan's routes by ``end`` (``time.monotonic``)."""
    from .operations.few_routes import few_routes as found

    return found(plan, most, np.random.default_rng(rng), end)


def check_few_routes(plan_options: Any) -> None:
    """Raise InvalidOption if departures with these options cannot draw from a few routes."""
    from .operations.path_mixtures import check_judged

    check_judged(plan_options.game)
