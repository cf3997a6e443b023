# SPDX-License-Identifier: Apache-2.0
"""The certificate: the worst mean loss of a strategy, and a bound that no strategy can beat.

Each route counts once per site, however often it comes back into the site's reach. For any strategy
p within the budget, any q >= 0 that sums to 1, and
a price >= 0,

    z(p) >= sum over j of q_j alpha_j P(hit_j)
         >= min over routes of sum over the sites j that it meets of q_j alpha_j
                               + sum over edges of price * reduced cost - price * slack,

where an edge's reduced cost is how much it lengthens the route beyond the shortest one, and the
slack is the budget minus the shortest route's length. The left side follows from p (``hits``), the
right side is a shortest path if no route can come back to a site, else labels (``best_response``)
or closed curves (``curves``) bound it from below. Neither depends on the solver
that found p, q and the price.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ...arrays import ROUNDING, FloatArray, sums
from ...errors import SolverFailed
from ..ambusher import Ambusher
from ..budget import Budget
from ..faces import Faces, make_faces
from ..game import Game
from ..hits import worst_loss
from .best_response import best_response
from .curves import curve_bound


@dataclass(frozen=True, eq=False)
class Certificate:
    """``value`` z(p) of a strategy, and the ``bound`` that no strategy within the budget beats.

    Raises SolverFailed if the bound exceeds the value by more than rounding.
    """

    value: float
    bound: float

    def __post_init__(self) -> None:
        if not 0.0 <= self.bound <= self.value * (1.0 + ROUNDING):
            raise SolverFailed(f'the lower bound {self.bound:.12g} is above the value '
                               f'{self.value:.12g}')
        object.__setattr__(self, 'bound', min(self.bound, self.value))


def certify(game: Game, p: FloatArray, ambusher: Ambusher, budget: Budget,
            bound: float | None = None) -> Certificate:
    """Certify a strategy p (M,) and an ambusher; ``bound`` is his ``lower_bound``, if it is known.

    Raises SolverFailed if p is not a unit flow from source to target or exceeds the budget, the
    ambusher is none, or the bound exceeds the value.
    """
    _check_flow(game, p)
    if not budget.keeps(p):
        raise SolverFailed(f"the strategy's length is {budget.mean(p):.9g} "
                           f'{game.network.travel_unit}, over the budget of {budget.limit:.9g}')
    value = worst_loss(game, p)
    bound = lower_bound(game, ambusher, budget) if bound is None else bound
    # Rounding may put p over the budget; the bound then holds for strategies as far over it.
    over = ambusher.price * budget.overrun(p)
    return Certificate(value, max(bound - over, 0.0))


def lower_bound(game: Game, ambusher: Ambusher, budget: Budget, faces: Faces | None = None,
                deadline: float = math.inf, enough: float = math.inf) -> float:
    """Value that no strategy within the budget can beat, as the ambusher proves it.

    By the closed curves of his circulation if he has one, else by the best response, as far as that
    is found by ``deadline`` (``time.monotonic``). ``faces`` are the network's, if they are known.
    The proof ends at a bound of ``enough``. Raises SolverFailed if he is no ambusher of the game.
    """
    ambusher.check(game)
    game = game.without_layers()  # whatever can be driven can be driven on the trip's own nodes
    if game.entries_are_hits:
        return entry_bound(game, ambusher, budget)
    if ambusher.circulation is None:
        return best_response(game, ambusher, budget, deadline, enough)
    same = faces is not None and len(faces.link) == len(game.network.edges)
    faces = replace(faces, game=game) if faces and same else make_faces(game)
    if faces is None:
        raise SolverFailed('a circulation proves nothing where links cross')
    return curve_bound(faces, ambusher, ambusher.circulation, budget, deadline, enough)


def entry_bound(game: Game, ambusher: Ambusher, budget: Budget) -> float:
    """The bound by the route of least cost if every entry is counted: one Dijkstra."""
    weights, paid = ambusher.paid(game, budget)
    weights = weights + game.mean_loss_on_edges(ambusher.q)
    return max(float(game.distances_from_source(weights)[game.network.target]) - paid, 0.0)


def _check_flow(game: Game, p: FloatArray) -> None:
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
