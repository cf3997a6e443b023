# SPDX-License-Identifier: Apache-2.0
"""One place that hits every route of a plan, and what would help against it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..game.game import Game
from ..game.hits import hit_probabilities
from ..game.strategy import within_slack
from .plan import Plan

# Share of the routes from which a place hits every one.
ALL_ROUTES = 0.99
# Maximum radius of the secured area that is proposed, as a share of the straight way.
MAX_HELD = 0.4


@dataclass(frozen=True, eq=False)
class OnePlace:
    """A place ``xy`` (2,) [m], ``away`` from one of the plan's ends, which is called ``end``.

    It ``covers_end`` if it is near it. ``held`` is the radius of the secured area in which all such
    places lie [m], None if it is large; ``detour`` the length of the shortest way that avoids the
    place, as a multiple of the shortest one, None if there is none.
    """

    xy: FloatArray
    away: float
    end: str
    covers_end: bool
    held: float | None
    detour: float | None


def find_one_place(plan: Plan) -> OnePlace | None:
    """Return the place of the ambusher that hits every route, None if there is none."""
    network, game, p = plan.network, plan.strategy.game, plan.strategy.edge_probability
    rows = np.flatnonzero(np.isin(game.sites, plan.bottleneck.sites))
    rows = rows[hit_probabilities(game, p, rows) >= ALL_ROUTES]
    if not len(rows) or not within_slack(plan.strategy, plan.options.strategy):
        return None
    ends = network.points[[network.source, *network.stops, network.target]]
    points = game.network.points[game.sites]
    away = np.hypot(*np.moveaxis(points[rows][:, None] - ends, 2, 0))
    worst, at = np.unravel_index(away.argmin(), away.shape)
    near = float(away.min())
    covers = near <= game.options.secured_distance + 2.0 * max(game.reach, plan.spacing)
    # Entries bound the hits from above.
    others = np.flatnonzero(game.entering @ p >= ALL_ROUTES)
    others = others[hit_probabilities(game, p, others) >= ALL_ROUTES]
    away = np.hypot(*np.moveaxis(points[others][:, None] - ends, 2, 0))
    far = float(away[away.argmin(axis=1) == at, at].max(initial=near)) + plan.spacing
    straight = float(np.hypot(*np.diff(ends, axis=0).T).max())
    digit = 10.0 ** (math.floor(math.log10(far)) - 1)
    return OnePlace(
        points[rows[worst]], near,
        {0: 'the start', len(ends) - 1: 'the goal'}.get(int(at), f'stop {at}'), covers,
        math.ceil(far / digit) * digit if far <= MAX_HELD * straight else None,
        _detour(game, int(rows[worst])))


def _detour(game: Game, row: int) -> float | None:
    """Length of the shortest route that a site does not hit, relative to the shortest one."""
    avoiding = game.avoiding(game.entering[[row]])
    if avoiding is None:
        return None
    lengths = [each.distances_from_source(game.network.travel_costs)[game.network.target]
               for each in (avoiding, game)]
    return float(lengths[0] / lengths[1]) if np.isfinite(lengths[0]) else None
