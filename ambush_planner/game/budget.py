# SPDX-License-Identifier: Apache-2.0
"""The budget: a limit on the mean length of the routes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..arrays import ROUNDING, FloatArray
from ..errors import BudgetInfeasible
from ..network.network import Network
from ..network.shortest_paths import distances_from
from .game import Game

# Least slack of a budget, as a share of the best route's cost, or of an edge's largest cost if that
# is 0: if a budget allowed the best routes only, an LP would have no room.
LEAST_SLACK = 1e-10
# Relative overrun of a budget that is a solver's rounding.
BUDGET_TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False)
class Budget:
    """A limit on the mean length of the route, in m or s.

    Parameters
    ----------
    game
        Where the convoy may drive.
    cost : (M,)
        Length of each edge, >= 0.
    limit
        Largest mean length; ``inf``: no limit. It is raised to leave the least slack.
    least
        Length of the shortest route of the whole network, or of the shortest way over the ground.

    Raises BudgetInfeasible if the shortest playable route exceeds the limit.
    """

    game: Game
    cost: FloatArray
    limit: float
    least: float

    @classmethod
    def length(cls, game: Game, factor: float) -> Budget:
        """A budget of ``factor`` times the shortest way, in m or s.

        It is that over the ground (``Network.ground_length``), if known, else on the network, whose
        shortest route is always within the budget.
        """
        network = game.network
        shortest = least_cost(network, network.travel_costs)
        least = network.ground_length or shortest
        return cls(game, network.travel_costs, max(_times(factor, least), shortest), least)

    def __post_init__(self) -> None:
        if not self.binds:
            return
        best = float(self._behind[self.game.network.source])
        if best > self.limit * (1.0 + ROUNDING):
            unit = self.game.network.travel_unit
            raise BudgetInfeasible(
                f'the shortest playable route has length {best:.6g} {unit}, more than the budget '
                f'of {self.limit:.6g} {unit}; raise max_detour, or alpha_threshold'
            )
        scale = best or float(self.cost.max(initial=0.0)) or 1.0
        object.__setattr__(self, 'limit', max(self.limit, best + LEAST_SLACK * scale))

    @cached_property
    def _behind(self) -> FloatArray:
        return self.game.distances_to_target(self.cost)

    @property
    def binds(self) -> bool:
        """Whether there is a limit at all."""
        return bool(np.isfinite(self.limit))

    @cached_property
    def slack(self) -> float:
        """The limit minus the best playable route's cost, > 0."""
        return self.limit - float(self._behind[self.game.network.source])

    @cached_property
    def reduced_cost(self) -> FloatArray:
        """Cost (M,) that each edge adds to the best way on from its tail; inf if not playable.

        Along a route they add up to its cost minus the best route's, without cancellation.
        """
        network, behind = self.game.network, self._behind
        with np.errstate(invalid='ignore'):
            added = self.cost + behind[network.heads] - behind[network.tails]
        return np.where(self.game.playable, np.maximum(added, 0.0), np.inf)

    def mean(self, p: FloatArray) -> float:
        """Mean cost of strategy p (M,)."""
        return float(p @ self.cost)

    def keeps(self, p: FloatArray) -> bool:
        """Whether p (M,) is within the limit, up to a solver's rounding."""
        return self.mean(p) <= self.limit * (1.0 + BUDGET_TOLERANCE)

    def overrun(self, p: FloatArray) -> float:
        """Mean cost of p (M,) beyond the limit, >= 0, without cancellation."""
        used = p > 0.0
        return max(float(p[used] @ self.reduced_cost[used]) - self.slack, 0.0)


def least_cost(network: Network, cost: FloatArray) -> float:
    """Cost of the network's best route, from the costs (M,) of edges."""
    found = distances_from(network.edges, cost, len(network.points), network.source)
    return float(found[network.target])


def _times(factor: float, least: float) -> float:
    return factor * least if math.isfinite(factor) else math.inf
