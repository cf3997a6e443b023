# SPDX-License-Identifier: Apache-2.0
"""A strategy within the budgets by at most two routes, regardless of ambushes."""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray, IndexArray
from ..errors import BudgetInfeasible
from ..network.shortest_paths import shortest_path
from .budget import ROUNDING, Budget
from .game import Game
from .law.acyclic import without_cycles
from .route_sampler import route_strategy, shortest_route_strategy

# Bisection steps for the weight between the costs of the two budgets.
BISECTIONS = 60


def strategy_within_budgets(game: Game, budgets: tuple[Budget, ...]) -> FloatArray | None:
    """The shortest route p (M,), or another acyclic strategy if that exceeds a budget.

    If any strategy is within both budgets, so is a mixture of two routes that are both best for
    some weighted sum of the two costs. Returns None if rounding prevents a decision, and raises
    BudgetInfeasible if no strategy is.
    """
    shortest = shortest_route_strategy(game)
    binding = [budget for budget in budgets if budget.binds]
    if all(budget.keeps(shortest) for budget in binding):
        return shortest
    edge = np.flatnonzero(game.playable)
    # A strategy is within a budget, up to rounding, if its mean cost is at most 1.
    costs = np.stack([b.excess[edge] / (b.margin + ROUNDING * b.limit) for b in binding])
    first, last = (_best_route(game, edge, costs[k]) for k in (0, -1))
    low, high = 0.0, 1.0
    for _ in range(BISECTIONS):
        share = _share_of_last(costs @ first[edge], costs @ last[edge])
        if share is not None:
            return without_cycles(game.network, (1.0 - share) * first + share * last)
        weight = (low + high) / 2.0
        route = _best_route(game, edge, (1.0 - weight) * costs[0] + weight * costs[-1])
        means = costs @ route[edge]
        if (1.0 - weight) * means[0] + weight * means[-1] > 1.0 + ROUNDING:
            names = ' and '.join(budget.option for budget in binding)
            raise BudgetInfeasible(f'no strategy fits all budgets at once; raise {names}')
        if means[-1] > 1.0:
            first, low = route, weight
        else:
            last, high = route, weight
    return None


def _best_route(game: Game, edge: IndexArray, cost: FloatArray) -> FloatArray:
    """The strategy p (M,) of the route of least cost, from the costs (m,) of the edges ``edge``."""
    network = game.network
    ends = network.source, network.target
    route = shortest_path(network.edges[edge], cost, game.node_count, *ends)
    return route_strategy(network, route)


def _share_of_last(first: FloatArray, last: FloatArray) -> float | None:
    """A share of the last route at which no mean cost exceeds 1, from the costs of both routes."""
    if first[0] > 1.0 or last[-1] > 1.0:
        return None
    least = (first[-1] - 1.0) / (first[-1] - last[-1]) if first[-1] > 1.0 else 0.0
    most = (1.0 - first[0]) / (last[0] - first[0]) if last[0] > 1.0 else 1.0
    return float(least + most) / 2.0 if least <= most else None
