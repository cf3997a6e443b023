# SPDX-License-Identifier: Apache-2.0
"""Value and lower bound of strategies in other games, and their gap beyond the slack."""

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
from .strategy import Strategy, StrategyOptions, TripStrategy, within_slack
from .tolerance import CERTIFICATE_TOLERANCE, ceiling


def legs_in_game(trip: TripStrategy, options: GameOptions,
                 alpha: FloatArray | None = None) -> Legs:
    """The games of a trip with other options, or other node losses ``alpha`` (N,); same budgets.

    Raises NoRoute, or BudgetInfeasible if the best playable route of a leg exceeds its budget.
    """
    networks = [leg.network if alpha is None else replace(leg.network, alpha=alpha)
                for leg in trip.legs]
    games = make_games(networks, options, trip.ambusher.q > 0.0)
    if options == trip.game.options and np.array_equal(games[0].sites, trip.game.sites):
        games = tuple(replace(game, known_rows=leg.game.entering)  # they are slow to find
                      for game, leg in zip(games, trip.legs, strict=True))
    return Legs(games, tuple(Budget(game, leg.length_budget, leg.shortest_length)
                             for game, leg in zip(games, trip.legs, strict=True)))


def revalue(trip: TripStrategy, alpha: FloatArray, law: Law | None = None) -> Certificate:
    """Recompute value and bound of strategies after node losses change to ``alpha`` (N,).

    ``law`` replaces how their routes are drawn. The bound follows from their ambusher: unless
    a loss fell at the ambusher's sites or a node is no longer over the threshold, what was proved
    still holds (docs/theory.md, Proposition 13.3); otherwise it is as near as theirs if that is
    proved. Without a playable route within the budgets, the value is infinite.
    """
    try:
        legs = legs_in_game(trip, trip.game.options, alpha)
    except (NoRoute, BudgetInfeasible):
        return Certificate(math.inf, 0.0)
    value, _ = largest_product(legs.loss, legs.entering, law or trip.law)
    waits = trip.ambusher.q > 0.0
    new_routes = any((game.playable > leg.game.playable).any()
                     for game, leg in zip(legs.games, trip.legs, strict=True))
    if (legs.games[0].loss[waits] >= trip.game.loss[waits]).all() and not new_routes:
        return Certificate(value, min(trip.lower_bound, value))
    as_near = value / trip.value if trip.value > 0.0 else math.inf
    targets = np.array([as_near * leg.lower_bound for leg in trip.legs])
    bound = float(lower_bounds(legs, trip.ambusher, targets=targets).sum())
    return Certificate(value, min(max(bound, 0.0), value))  # the law may exceed the budgets now


def bound_if_held(trip: TripStrategy, places: tuple[SecuredPlace, ...]) -> float:
    """A lower bound of the value if ``places`` are all that is held besides the ends.

    The trip's ambusher proves it: q, restricted to sites outside the discs and scaled up.
    """
    legs = legs_in_game(trip, replace(trip.game.options, held_places=places))
    q = np.where(legs.games[0].loss > 0.0, trip.ambusher.q, 0.0)
    share = float(q.sum())
    if share == 0.0:
        return 0.0
    others = Ambusher(q / share, tuple(price / share for price in trip.ambusher.prices))
    unused = q == 0.0
    few = Legs(tuple(game.without_sites(unused) for game in legs.games), legs.budgets)
    return max(float(lower_bounds(few, others).sum()), 0.0)


def open_gap(strategy: Strategy | TripStrategy, options: StrategyOptions) -> float:
    """The gap between value and bound beyond the risk slack; 0 if they are within it."""
    if within_slack(strategy, options):
        return 0.0
    # With a length weight, the weighted sum is minimal and sets the scale.
    weighed = sum(price * strategy.expected_length for price in strategy.ambusher.prices
                  ) * (options.length_weight > 0.0)
    gap = strategy.value / ceiling(1.0, options.tolerance) - strategy.lower_bound
    scale = max(strategy.value + weighed, NEGLIGIBLE * float(strategy.game.loss.max(initial=0.0)))
    return gap if gap > 2.0 * CERTIFICATE_TOLERANCE * scale else 0.0
