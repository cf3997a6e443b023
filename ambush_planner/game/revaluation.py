# SPDX-License-Identifier: Apache-2.0
"""Value and lower bound of known strategies in other games, and the gap left open."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ..arrays import NEGLIGIBLE, FloatArray
from ..errors import BudgetInfeasible, NoRoute
from .ambusher import Ambusher
from .budget import Budget
from .certificate.certificate import Certificate, lower_bounds
from .game import GameOptions, SecuredPlace, make_games
from .hits import Law, largest_product
from .legs import Legs
from .strategy import Strategy, StrategyOptions, TripStrategy, weighted_length
from .tolerance import CERTIFICATE_TOLERANCE, ceiling


def legs_in_game(trip: TripStrategy, options: GameOptions,
                 alpha: FloatArray | None = None) -> Legs:
    """Make the games of a trip for other options or node losses ``alpha`` (N,), same budgets.

    Raises NoRoute, or BudgetInfeasible if the best playable route of a leg exceeds its budget.
    """
    networks = [leg.network if alpha is None else replace(leg.network, alpha=alpha)
                for leg in trip.legs]
    games = make_games(networks, options, trip.ambusher.q > 0.0)
    if options == trip.game.options and np.array_equal(games[0].sites, trip.game.sites):
        games = tuple(replace(game, known_rows=leg.game.entering)
                      for game, leg in zip(games, trip.legs, strict=True))
    return Legs(games, tuple(Budget(game, leg.length_budget, leg.shortest_length)
                             for game, leg in zip(games, trip.legs, strict=True)))


def revalue(trip: TripStrategy, alpha: FloatArray, law: Law | None = None) -> Certificate:
    """Recompute value and lower bound of strategies after node losses change to ``alpha`` (N,).

    ``law`` replaces the probability law of their routes. The bound stays if no loss fell at the
    ambusher's sites and no new edges are playable (docs/theory.md, Proposition 13.3). Otherwise it
    is proved again from the ambusher, up to the relative gap of before. Without a playable route
    within the budgets, the value is infinite.
    """
    try:
        legs = legs_in_game(trip, trip.game.options, alpha)
    except (NoRoute, BudgetInfeasible):
        return Certificate(math.inf, 0.0)
    value, _ = largest_product(legs.loss, legs.entering, law or trip.law)
    sites = trip.ambusher.q > 0.0
    new_routes = any((game.playable > leg.game.playable).any()
                     for game, leg in zip(legs.games, trip.legs, strict=True))
    if (legs.games[0].loss[sites] >= trip.game.loss[sites]).all() and not new_routes:
        return Certificate(value, min(trip.lower_bound, value))
    growth = value / trip.value if trip.value > 0.0 else math.inf
    targets = np.array([growth * leg.lower_bound for leg in trip.legs])
    bound = float(lower_bounds(legs, trip.ambusher, targets=targets).sum())
    return Certificate(value, min(max(bound, 0.0), value))  # the law may exceed the budgets now


def bound_if_secured(trip: TripStrategy, places: tuple[SecuredPlace, ...]) -> float:
    """Lower bound of the value if the secured area is ``places`` and the discs around the ends.

    It is certified by the trip's ambusher, restricted to the sites that are left and scaled to 1.
    """
    legs = legs_in_game(trip, replace(trip.game.options, secured_places=places))
    q = np.where(legs.games[0].loss > 0.0, trip.ambusher.q, 0.0)
    share = float(q.sum())
    if share == 0.0:
        return 0.0
    scaled = Ambusher(q / share, tuple(price / share for price in trip.ambusher.prices))
    unused = q == 0.0  # without the rows of these sites, proofs are faster
    reduced = Legs(tuple(game.without_sites(unused) for game in legs.games), legs.budgets)
    return max(float(lower_bounds(reduced, scaled).sum()), 0.0)


def open_gap(strategy: Strategy | TripStrategy, options: StrategyOptions) -> float:
    """Gap between value and lower bound beyond the tolerance; 0 if it is rounding."""
    gap = strategy.value / ceiling(1.0, options.tolerance) - strategy.lower_bound
    scale = max(strategy.value + weighted_length(strategy, options),
                NEGLIGIBLE * float(strategy.game.loss.max(initial=0.0)))
    return gap if gap > 2.0 * CERTIFICATE_TOLERANCE * scale else 0.0
