# SPDX-License-Identifier: Apache-2.0
"""A site that hits every route of a plan, and the remedies."""

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
MAX_SECURED = 0.4


@dataclass(frozen=True, eq=False)
class OnePlace:
    """A place from which an ambush hits every route of a leg.

    Attributes
    ----------
    xy : (2,)
        Its position [m].
    distance, end
        Distance from the nearest end of the plan [m], and the end's name.
    covers_end
        The place is so near that its reach covers the secured area's rim at the end.
    secured_radius
        Radius of the secured area around the end that would contain all such places [m]; None if
        it would be too large.
    detour
        Length of the shortest way that avoids the place over that of the shortest way; None if
        there is no such way.
    leg, arriving
        Number of the leg, from 0, and whether it leads to this end.
    """

    xy: FloatArray
    distance: float
    end: str
    covers_end: bool
    secured_radius: float | None
    detour: float | None
    leg: int
    arriving: bool


def find_one_place(plan: Plan) -> OnePlace | None:
    """Return the ambusher's site that hits every route of some leg; None if there is none."""
    if not within_tolerance(plan.trip, plan.options.strategy):
        return None
    for k, leg in enumerate(plan.drawn_from.legs):
        if len(nodes := certain_sites(leg)):
            return _nearest_to_end(plan, k, nodes)
    return None


def _nearest_to_end(plan: Plan, k: int, nodes: IndexArray) -> OnePlace:
    """Choose the node nearest to an end, among nodes that each hit every route of leg ``k``."""
    leg, ends = plan.drawn_from.legs[k], np.array(plan.ends_xy)
    game, points = leg.game, leg.network.points
    distances = np.hypot(*np.moveaxis(points[nodes][:, None] - ends, 2, 0))
    nearest, end = np.unravel_index(distances.argmin(), distances.shape)
    distance, node = float(distances.min()), int(nodes[nearest])
    covers_end = distance <= game.options.secured_distance + 2.0 * max(game.reach, plan.spacing)
    rows = np.flatnonzero(leg.law.meets_at_most(game.entering) >= ALL_ROUTES)
    rows = rows[leg.law.meets(game.entering[rows]) >= ALL_ROUTES]
    distances = np.hypot(*np.moveaxis(points[game.sites[rows]][:, None] - ends, 2, 0))
    at_end = distances.argmin(axis=1) == end
    radius = float(distances[at_end, end].max(initial=distance)) + plan.spacing
    straight = float(np.hypot(*np.diff(ends, axis=0).T).max())
    digit = 10.0 ** (math.floor(math.log10(radius)) - 1)
    return OnePlace(
        points[node], distance,
        {0: 'the start', len(ends) - 1: 'the goal'}.get(int(end), f'stop {end}'), covers_end,
        math.ceil(radius / digit) * digit if radius <= MAX_SECURED * straight else None,
        _detour(game, int(np.flatnonzero(game.sites == node)[0])), k, int(end) == k + 1)


def _detour(game: Game, row: int) -> float | None:
    """Length of the shortest route that a site does not hit, over that of the shortest route."""
    without_site = game.avoiding(game.entering[[row]])
    if without_site is None:
        return None
    shortest, overall = (each.distances_from_source(each.network.travel_costs)[each.network.target]
                         for each in (without_site, game))
    return float(shortest / overall) if np.isfinite(shortest) else None
