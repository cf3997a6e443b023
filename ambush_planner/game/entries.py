"""Value and bound of a game in which every entry into a site's reach counts.

That is what a linear program can count. An entry is a hit unless the route was hit by the site
before, so these numbers are those of the certificate wherever no route comes back to a disc, and
``entry_value`` is never below the true value. ``entry_bound`` bounds entries, not hits.
"""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray
from ..errors import SolverFailed
from .budget import ROUNDING, Budget
from .game import Game

# Prices of a budget to try besides a program's, in units of value over margin.
PRICES = tuple(10.0**k for k in range(-9, 1))


def entry_value(game: Game, p: FloatArray) -> float:
    """z(p): mean loss of the best ambush against p (M,), the sum over the k worst sites."""
    losses = game.site_losses(p)
    if game.ambushers == 1:
        return float(losses.max(initial=0.0))
    return float(np.sort(losses)[-game.ambushers :].sum())


def entry_bound(game: Game, q: FloatArray, budgets: tuple[Budget, ...] = (),
                prices: tuple[float, ...] = ()) -> float:
    """Value that no strategy within the budgets can beat, given q (N,): one Dijkstra.

    Raises SolverFailed if q is not a strategy of the ambusher, or a price is negative.
    """
    check_ambusher(game, q, budgets, prices)
    weights, paid = priced_edges(game, q, budgets, prices)
    return max(float(game.distances_ahead(weights)[game.network.target]) - paid, 0.0)


def best_prices(game: Game, q: FloatArray, budgets: tuple[Budget, ...], prices: tuple[float, ...],
                value: float, enough: float = np.inf) -> tuple[tuple[float, ...], float]:
    """Prices of the budgets at which q (N,) proves more, and the bound that it proves.

    Each budget's price is varied over ``PRICES``, then those of all budgets together. ``value``
    is roughly the game's and sets the scale; the search ends at a bound of ``enough``.
    """
    bound = entry_bound(game, q, budgets, prices)
    binding = [k for k, budget in enumerate(budgets) if budget.binds]
    for moved in [[k] for k in binding] + [binding] * (len(binding) > 1):
        for factor in PRICES:
            if bound >= enough:
                return prices, bound
            tried = tuple(factor * value / b.margin if k in moved else own
                          for k, (own, b) in enumerate(zip(prices, budgets, strict=True)))
            better = entry_bound(game, q, budgets, tried) if np.isfinite(tried).all() else bound
            if better > bound:
                prices, bound = tried, better
    return prices, bound


def priced_edges(game: Game, q: FloatArray, budgets: tuple[Budget, ...],
                 prices: tuple[float, ...]) -> tuple[FloatArray, float]:
    """Cost of each edge (M,) under q (N,) and the prices, and the priced margins to subtract."""
    weights, paid = game.mean_loss_on_edges(q), 0.0
    for budget, price in zip(budgets, prices, strict=True):
        if price > 0.0:
            weights = weights + price * budget.excess
            paid += price * budget.margin
    return weights, paid


def check_ambusher(game: Game, q: FloatArray, budgets: tuple[Budget, ...],
                   prices: tuple[float, ...]) -> None:
    """Raise SolverFailed if q (N,) is not a strategy of the ambusher, or a price is negative."""
    most = 1.0 + ROUNDING
    if not (q >= 0.0).all() or not (game.at_sites(q) <= most).all() or not (q <= most).all():
        raise SolverFailed(f'q must be in [0, 1], got {q.min()} to {q.max()}')
    if not abs(q.sum() - game.ambushers) <= ROUNDING * game.ambushers:
        raise SolverFailed(f'q must sum to {game.ambushers}, got {q.sum()}')
    for budget, price in zip(budgets, prices, strict=True):
        if not price >= 0.0:
            raise SolverFailed(f'the price of the {budget.name} budget is {price}, not >= 0')
