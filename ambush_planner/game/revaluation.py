# SPDX-License-Identifier: Apache-2.0
"""Value and lower bound of a strategy in another game, and its gap beyond the slack."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ..arrays import NEGLIGIBLE, FloatArray
from ..errors import BudgetInfeasible, NoRoute
from .ambusher import Ambusher
from .budget import Budget
from .certificate.certificate import Certificate, lower_bound
from .faces import Circulation
from .game import Game, SecuredPlace, make_game
from .hits import worst_loss
from .slack import CERTIFICATE_TOLERANCE, ceiling
from .strategy import Strategy, StrategyOptions, within_slack


def budget_in_game(game: Game, strategy: Strategy) -> Budget:
    """The strategy's budget in another game on its network.

    Raises BudgetInfeasible if the shortest playable route exceeds it.
    """
    return Budget(game, game.network.travel_costs, strategy.length_budget,
                  strategy.shortest_length)


def revalue(strategy: Strategy, alpha: FloatArray, p: FloatArray | None = None) -> Certificate:
    """Recompute value and bound of a strategy for the node losses ``alpha`` (N,).

    ``p`` (M,) replaces the strategy's edge probabilities; the value of p = 0 is infinite. The
    bound follows from the strategy's ambusher, and is as near as the strategy's if he proves that.
    Without a playable route within the budget, the value is infinite.
    """
    p = strategy.edge_probability if p is None else p
    network = replace(strategy.network, alpha=alpha)
    try:
        game = make_game(network, strategy.game.options)
        budget = budget_in_game(game, strategy)
    except (NoRoute, BudgetInfeasible):
        return Certificate(math.inf, 0.0)
    value = worst_loss(game, p) if p.any() else math.inf
    as_near = value * strategy.lower_bound / strategy.value if strategy.value > 0.0 else math.inf
    bound = lower_bound(game, strategy.ambusher, budget, enough=as_near)
    return Certificate(value, min(bound, value))  # p may exceed the budget now


def bound_if_held(strategy: Strategy, places: tuple[SecuredPlace, ...]) -> float:
    """A lower bound of the value if ``places`` are all that is held besides the ends.

    The strategy's ambusher proves it: his q, restricted to sites outside the discs and scaled up.
    """
    old, ambusher = strategy.game, strategy.ambusher
    unused = old.at_places(ambusher.q)[old.network.places] == 0.0
    game = make_game(old.network, replace(old.options, held_places=places)).without_sites(unused)
    q = np.where(game.loss > 0.0, ambusher.q, 0.0)
    share = float(q.sum())
    if share == 0.0:
        return 0.0
    flows, by_leg = ambusher.circulation, ambusher.by_leg
    if flows is not None:
        flows = Circulation(flows.through / share, flows.site, flows.face, flows.flow / share)
    if by_leg is not None:
        by_leg = np.where(game.loss > 0.0, by_leg, 0.0) / share
    others = Ambusher(q / share, ambusher.price / share, by_leg, flows)
    return lower_bound(game, others, budget_in_game(game, strategy))


def open_gap(strategy: Strategy, options: StrategyOptions) -> float:
    """The gap between value and bound beyond the risk slack; 0 if the solve was complete."""
    if strategy.reason == 'stalled' or within_slack(strategy, options):
        return 0.0
    # With a length weight, the weighted sum is minimal and sets the scale.
    weighed = strategy.length_price * strategy.expected_length * (options.length_weight > 0.0)
    gap = strategy.value / ceiling(1.0, options.slack) - strategy.lower_bound
    scale = max(strategy.value + weighed, NEGLIGIBLE * float(strategy.game.loss.max(initial=0.0)))
    return gap if gap > 2.0 * CERTIFICATE_TOLERANCE * scale else 0.0
