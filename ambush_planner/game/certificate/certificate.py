# SPDX-License-Identifier: Apache-2.0
"""The certificate: the worst mean loss of a strategy, and a bound that no strategy can beat.

Each route counts once per site, however often it comes back into the site's reach. For a strategy
of each leg i within its length budget, any q >= 0 that sums to 1, and prices pi_i >= 0,

    value >= sum over j of q_j alpha_j sum over i of P(leg i is hit at j)
          >= sum over i of [min over routes of leg i of sum over the sites j that it meets of
                            q_j alpha_j + pi_i * its reduced cost, - pi_i * margin_i],

where the reduced cost of a route is how much longer it is than the shortest one, and the margin is
the budget minus the shortest route's length. The left side follows from the strategies (``hits``).
On the right, the least cost of each leg is a shortest path if no route can come back to a site,
else it is bounded from below by closed curves (``curves``) or labels (``best_response``). Neither
depends on the solver.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...arrays import ROUNDING, FloatArray, sums
from ...errors import SolverFailed
from ..ambusher import Ambusher
from ..budget import Budget
from ..faces import make_faces
from ..game import Game
from ..legs import Legs
from .best_response import SEARCHES, SEARCHES_AFTER_CURVES, best_response
from .curves import curve_bound


@dataclass(frozen=True, eq=False)
class Certificate:
    """``value`` of a strategy, and the ``bound`` that no strategy within the budgets beats.

    Raises SolverFailed if the bound exceeds the value by more than rounding.
    """

    value: float
    bound: float

    def __post_init__(self) -> None:
        if not 0.0 <= self.bound <= self.value * (1.0 + ROUNDING):
            raise SolverFailed(f'the lower bound {self.bound:.12g} is above the value '
                               f'{self.value:.12g}')
        object.__setattr__(self, 'bound', min(self.bound, self.value))


class Certified:
    """Strategies with a ``certificate``."""

    certificate: Certificate

    @property
    def value(self) -> float:
        """Mean loss by the best ambush at one place, added up over the legs of a trip.

        A route counts once per site, however often it comes back into the site's reach. If a
        strategy has cycles, every entry counts: an upper bound.
        """
        return self.certificate.value

    @property
    def lower_bound(self) -> float:
        """No strategies within the budgets have a smaller value, counted in the same way."""
        return self.certificate.bound

    @property
    def gap(self) -> float:
        """Value minus lower bound."""
        return self.value - self.lower_bound


def lower_bounds(legs: Legs, ambusher: Ambusher, deadline: float = math.inf,
                 targets: FloatArray | None = None) -> FloatArray:
    """The least loss of each leg (legs,) against the ambusher; their sum bounds the value.

    A leg's bound can be below 0, if its budget is worth more than it loses. Proofs take until
    ``deadline`` (``time.monotonic``) at most; that of a leg ends at its target (legs,).
    """
    wanted = np.full(len(legs.games), math.inf) if targets is None else targets
    return np.array([leg_bound(game, budget, own, deadline, target)
                     for game, budget, own, target in zip(
                         legs.games, legs.budgets, ambusher.by_leg(), wanted, strict=True)])


def leg_bound(game: Game, budget: Budget, ambusher: Ambusher, deadline: float = math.inf,
              target: float = math.inf) -> float:
    """The least loss of any strategy of a leg within its budget against its ambusher."""
    q, (price,), bound = ambusher.q, ambusher.prices, -math.inf
    if game.no_reentry:
        return entry_bound(game, budget, q, price)
    for given in ambusher.circulations:
        faces = make_faces(game)
        if faces is None or not faces.same_both_ways(budget.cost):
            raise SolverFailed('a circulation proves nothing where links cross or are one-way')
        bound = curve_bound(faces, given, game.loss * q, budget, price, deadline, target)
    if bound >= target:
        return bound
    weights, worth = _paid(game, budget, price)
    searches = SEARCHES_AFTER_CURVES if ambusher.circulations else SEARCHES
    return max(bound, best_response(game, q, weights, deadline, target + worth, searches) - worth)


def entry_bound(game: Game, budget: Budget, q: FloatArray, price: float) -> float:
    """The same if every entry is counted: one shortest path."""
    weights, worth = _paid(game, budget, price)
    weights = weights + game.entering.T @ (game.loss * q)[game.sites]
    return float(game.distances_from_source(weights)[game.network.target]) - worth


def _paid(game: Game, budget: Budget, price: float) -> tuple[FloatArray, float]:
    """The price of each edge (M,) for the budget, and the budget's worth to the convoy."""
    if not price > 0.0:
        return np.zeros(len(game.playable)), 0.0
    return price * budget.reduced_cost, price * budget.margin


def check_strategy(game: Game, budget: Budget, p: FloatArray) -> None:
    """Raise SolverFailed if p (M,) is not a unit flow from source to target within the budget."""
    if not (p >= 0.0).all():
        raise SolverFailed(f'p must be >= 0, the least is {p.min()}')
    network = game.network
    balance = sums(network.tails, p, game.node_count)
    balance -= sums(network.heads, p, game.node_count)
    balance[network.source] -= 1.0
    balance[network.target] += 1.0
    residual = float(np.abs(balance).max())
    if not residual <= ROUNDING:
        raise SolverFailed(f'p is not a flow from source to target: residual {residual:.1e}')
    if p[~game.playable].any():
        raise SolverFailed('p uses edges that are not playable')
    if not budget.keeps(p):
        raise SolverFailed(f"the strategy's length is {budget.mean(p):.9g} "
                           f'{network.travel_unit}, over the budget of {budget.limit:.9g}')
