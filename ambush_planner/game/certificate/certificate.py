# SPDX-License-Identifier: Apache-2.0
"""The certificate: value and lower bound of a strategy, recomputed from both sides' strategies.

A site hits a route at most once. For any strategy within the length budgets, any q >= 0 that sums
to 1, and any prices pi_i >= 0 of the budgets (docs/theory.md, Propositions 5.3 and 13.1),

    value >= sum over legs i and sites j of q_j alpha_j P(j hits leg i)
          >= sum over legs i of (least cost of leg i - pi_i margin_i).

The cost of a route is the sum of the site prices q_j alpha_j of the sites that hit it, plus pi_i
times its reduced cost: its length minus that of the shortest route. The margin is the budget minus
the length of the shortest route. The value follows from the convoy's strategies (``hits``). The
least cost is a shortest path if no route can re-enter a site's reach; otherwise closed curves
(``curves``) and labels (``best_response``) bound it from below. Nothing here knows the solver.
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
    """Value of a strategy, and a lower bound for all strategies within the budgets.

    Raises SolverFailed if the bound is negative or exceeds the value by more than rounding.
    """

    value: float
    bound: float

    def __post_init__(self) -> None:
        if not 0.0 <= self.bound <= self.value * (1.0 + ROUNDING):
            raise SolverFailed(f'the lower bound {self.bound:.12g} is above the value '
                               f'{self.value:.12g}')
        object.__setattr__(self, 'bound', min(self.bound, self.value))


class Certified:
    """Base of strategies that carry a ``certificate``."""

    certificate: Certificate

    @property
    def value(self) -> float:
        """Largest mean loss that an ambush at one site causes, summed over the legs of a trip.

        A site hits a route at most once. If the strategy has cycles, the value is an upper bound:
        it counts every entry into the site's reach.
        """
        return self.certificate.value

    @property
    def lower_bound(self) -> float:
        """Lower bound of the value of every strategy within the budgets."""
        return self.certificate.bound

    @property
    def gap(self) -> float:
        """Value minus lower bound."""
        return self.value - self.lower_bound


def lower_bounds(legs: Legs, ambusher: Ambusher, deadline: float = math.inf,
                 targets: FloatArray | None = None) -> FloatArray:
    """Lower bound (legs,) of each leg's mean loss to the ambusher; the sum bounds the value.

    A leg's bound is negative if its budget is worth more than what the leg loses. The search for a
    leg's bound stops at its target (legs,), and all stop at ``deadline`` (``time.monotonic``).
    """
    targets = np.full(len(legs.games), math.inf) if targets is None else targets
    return np.array([_leg_bound(game, budget, share, deadline, target)
                     for game, budget, share, target in zip(
                         legs.games, legs.budgets, ambusher.by_leg(), targets, strict=True)])


def _leg_bound(game: Game, budget: Budget, ambusher: Ambusher, deadline: float,
               target: float) -> float:
    """Lower bound of the mean loss of one leg to its ambusher."""
    q, (price,), bound = ambusher.q, ambusher.prices, -math.inf
    if game.no_reentry:
        return entry_bound(game, budget, q, price)
    for circulation in ambusher.circulations:
        faces = make_faces(game)
        if faces is None or not faces.same_both_ways(budget.cost):
            raise SolverFailed('a circulation proves nothing where links cross or are one-way')
        bound = curve_bound(faces, circulation, game.loss * q, budget, price, deadline, target)
    if bound >= target:
        return bound
    weights, worth = _priced_budget(game, budget, price)
    searches = SEARCHES_AFTER_CURVES if ambusher.circulations else SEARCHES
    return max(bound, best_response(game, q, weights, deadline, target + worth, searches) - worth)


def entry_bound(game: Game, budget: Budget, q: FloatArray, price: float) -> float:
    """Lower bound of a leg's mean loss if every entry counts as a hit: one shortest path."""
    weights, worth = _priced_budget(game, budget, price)
    weights = weights + game.entering.T @ (game.loss * q)[game.sites]
    return float(game.distances_from_source(weights)[game.network.target]) - worth


def _priced_budget(game: Game, budget: Budget, price: float) -> tuple[FloatArray, float]:
    """Cost (M,) of each edge at the budget's price, and what the whole margin is worth."""
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
