# SPDX-License-Identifier: Apache-2.0
"""One place that hits every route of a plan, and what would help against it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray, IndexArray
from ..game.game import Game
from ..game.solver import ALL_ROUTES, certain_sites
from ..game.strategy import within_tolerance
from .plan import Plan

# Maximum radius of the secured area that is proposed, as a share of the straight way.
MAX_HELD = 0.4


@dataclass(frozen=True, eq=False)
class OnePlace:
    """A place ``xy`` (2,) [m], ``away`` from one of the plan's ends, which is called ``end``.

    It ``covers_end`` if it is near it. ``held`` is the radius of the secured area in which all such
    places lie [m], None if it is large; ``detour`` the length of the shortest way that avoids the
    place, as a multiple of the shortest one, None if there is none. ``leg`` is the leg, from 0,
    whose routes it hits: one that ``leads_in`` to the end, or not.
    """

    xy: FloatArray
    away: float
    end: str
    covers_end: bool
    held: float | None
    detour: float | None
    leg: int
    leads_in: bool


def find_one_place(plan: Plan) -> OnePlace | None:
    """Return the place of the ambusher that hits every route of a leg, None if there is none."""
    if not within_tolerance(plan.trip, plan.options.strategy):
        return None
    for k, leg in enumerate(plan.drawn_from.legs):
        if len(nodes := certain_sites(leg)):
            return _of_leg(plan, k, nodes)
    return None


def _of_leg(plan: Plan, k: int, nodes: IndexArray) -> OnePlace:
    """The nearest to an end of some nodes that each hit every route of leg ``k``."""
    leg, ends = plan.drawn_from.legs[k], np.array(plan.ends_xy)
    game, points = leg.game, leg.network.points
    away = np.hypot(*np.moveaxis(points[nodes][:, None] - ends, 2, 0))
    worst, at = np.unravel_index(away.argmin(), away.shape)
    near, node = float(away.min()), int(nodes[worst])
    covers = near <= game.options.secured_distance + 2.0 * max(game.reach, plan.spacing)
    rows = np.flatnonzero(leg.law.meets_at_most(game.entering) >= ALL_ROUTES)
    rows = rows[leg.law.meets(game.entering[rows]) >= ALL_ROUTES]
    away = np.hypot(*np.moveaxis(points[game.sites[rows]][:, None] - ends, 2, 0))
    far = float(away[away.argmin(axis=1) == at, at].max(initial=near)) + plan.spacing
    straight = float(np.hypot(*np.diff(ends, axis=0).T).max())
    digit = 10.0 ** (math.floor(math.log10(far)) - 1)
    return OnePlace(
        points[node], near,
        {0: 'the start', len(ends) - 1: 'the goal'}.get(int(at), f'stop {at}'), covers,
        math.ceil(far / digit) * digit if far <= MAX_HELD * straight else None,
        _detour(game, int(np.flatnonzero(game.sites == node)[0])), k, int(at) == k + 1)


def _detour(game: Game, row: int) -> float | None:
    """Length of the shortest route that a site does not hit, relative to the shortest one."""
    avoiding = game.avoiding(game.entering[[row]])
    if avoiding is None:
        return None
    lengths = [each.distances_from_source(each.network.travel_costs)[each.network.target]
               for each in (avoiding, game)]
    return float(lengths[0] / lengths[1]) if np.isfinite(lengths[0]) else None
