# SPDX-License-Identifier: Apache-2.0
"""The length budget of a leg: a limit of the mean length of its routes, or of their mean time."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..arrays import NEGLIGIBLE, ROUNDING, FloatArray
from ..errors import BudgetInfeasible
from ..network.network import Network
from ..network.shortest_paths import distances_from
from .game import Game

# Least margin of a budget, as a share of the shortest route's cost, or of the largest edge cost if
# that is 0. With no margin, an interior point method would have no interior.
LEAST_MARGIN = 1e-10
# Relative overrun of a budget that counts as a solver's rounding.
BUDGET_TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False)
class Budget:
    """Limit of the mean length of a leg's routes.

    Parameters
    ----------
    game
        Where the convoy may drive.
    limit
        Largest mean length [m], or [s] if the network has driving times; ``inf``: no limit. It is
        raised if the margin would be below ``LEAST_MARGIN``.
    shortest
        Length of the shortest way over the ground, or else of the network's shortest route.

    Raises BudgetInfeasible if the best playable route exceeds the limit.
    """

    game: Game
    limit: float
    shortest: float

    def __post_init__(self) -> None:
        if not self.is_limited:
            return
        best = float(self._to_target[self.game.network.source])
        if best > self.limit * (1.0 + ROUNDING):
            unit = self.game.network.travel_unit
            raise BudgetInfeasible(
                f'the best playable route has length {best:.6g} {unit}, more than the budget of '
                f'{self.limit:.6g} {unit}; raise max_detour, or alpha_threshold')
        scale = best or float(self.cost.max(initial=0.0)) or 1.0
        object.__setattr__(self, 'limit', max(self.limit, best + LEAST_MARGIN * scale))

    @property
    def cost(self) -> FloatArray:
        """Length (M,) of each edge [m], or its driving time [s]."""
        return self.game.network.travel_costs

    @cached_property
    def _to_target(self) -> FloatArray:
        return self.game.distances_to_target(self.cost)

    @property
    def is_limited(self) -> bool:
        """Return whether the limit is finite."""
        return math.isfinite(self.limit)

    @cached_property
    def margin(self) -> float:
        """The limit minus the length of the shortest playable route, > 0."""
        return self.limit - float(self._to_target[self.game.network.source])

    @property
    def allows_only_shortest(self) -> bool:
        """Return whether only shortest routes are within the limit: an LP has no interior then."""
        return self.margin <= ROUNDING * self.limit

    def deterring_price(self, loss: float) -> float:
        """Price of the margin at which the shortest of the longer routes pays ``loss``.

        If only shortest routes are allowed, an LP's dual can be less, even 0, and then the longer
        routes lower the bound.
        """
        longer = self.reduced_cost[self.reduced_cost > ROUNDING * self.limit]
        return loss / float(longer.min(initial=np.inf))

    @cached_property
    def reduced_cost(self) -> FloatArray:
        """Reduced cost (M,) of each edge, >= 0; inf if not playable.

        It is the detour made by using the edge and then the shortest way to the target. Along a
        route, reduced costs sum to its length minus the shortest route's, without cancellation.
        """
        network, to_target = self.game.network, self._to_target
        with np.errstate(invalid='ignore'):
            added = self.cost + to_target[network.heads] - to_target[network.tails]
        return np.where(self.game.playable, np.maximum(added, 0.0), np.inf)

    @cached_property
    def used_margin(self) -> FloatArray:
        """Reduced cost (M,) of each playable edge as a share of the margin; 0 without a limit.

        It is bounded for the sake of LP solvers.
        """
        if not self.is_limited:
            return np.zeros(len(self.game.playable))
        shares = np.minimum(self.reduced_cost / self.margin, 1.0 / NEGLIGIBLE)
        return np.where(self.game.playable, shares, 0.0)

    def mean(self, p: FloatArray) -> float:
        """Mean length of strategy p (M,)."""
        return float(p @ self.cost)

    def keeps(self, p: FloatArray) -> bool:
        """Return whether p (M,) is within the limit, up to a solver's rounding."""
        return self.mean(p) <= self.limit * (1.0 + BUDGET_TOLERANCE)

    def overrun(self, p: FloatArray) -> float:
        """Mean length of p (M,) beyond the limit, >= 0, without cancellation."""
        used = p > 0.0
        return max(float(p[used] @ self.reduced_cost[used]) - self.margin, 0.0)


def length_budget(game: Game, max_detour: float) -> Budget:
    """Return the budget of ``max_detour`` times the shortest way; raises BudgetInfeasible.

    That is the way over the ground (``Network.ground_length``) if it is known, else the network's
    shortest route. The budget always allows the latter.
    """
    network = game.network
    shortest = shortest_length(network)
    ground = network.ground_length or shortest
    limit = max_detour * ground if math.isfinite(max_detour) else math.inf
    return Budget(game, max(limit, shortest), ground)


def shortest_length(network: Network) -> float:
    """Length of the network's shortest route [m], or its time [s]."""
    found = distances_from(network.edges, network.travel_costs, len(network.points),
                           network.source)
    return float(found[network.target])
