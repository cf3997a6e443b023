# SPDX-License-Identifier: Apache-2.0
"""Comparison of the stochastic planner with deterministic ones (the paper's table III)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from ..arrays import FloatArray, IndexArray
from ..game.game import Game
from ..game.hits import Law, joint_law, largest_product, law_of
from ..game.legs import Legs
from ..game.route_sampler import route_strategy, shortest_route
from ..game.strategy import Strategy, TripStrategy
from .plan import Plan

# Relative difference up to which sums of alpha are ties.
TIE = 1e-12


@dataclass(frozen=True)
class Measures:
    """One planner's row of the table.

    ``expected_length`` is E [m, or s if the network has driving times]; ``p_first`` is P_1, the
    probability of an ambush by the equilibrium ambusher; ``p_repeated`` and ``v_repeated`` are
    P_inf and V_inf, probability and mean loss of an ambush by one who has learnt the planner's
    strategy. Losses of a trip with stops are added up over its legs.
    """

    planner: str
    expected_length: float
    p_first: float
    p_repeated: float
    v_repeated: float


def evaluate(planned: Strategy | Plan) -> dict[str, Measures]:
    """Compare a plan, or a strategy, with the planners that always drive the same route.

    An ambusher who has learnt a fixed route waits at its worst site; against the stochastic planner
    nothing beats the equilibrium.

    Returns
    -------
    dict of Measures
        'stochastic', 'energy_efficient' (shortest length) and 'risk_avoidance' (least sum of alpha,
        ties by length), all on the playable edges.

    Examples
    --------
    >>> from ambush_planner import Network, evaluate, solve
    >>> network = Network(points=[(0, 0), (1, 1), (1, -2), (2, 0)], alpha=[0, 1, 3, 0],
    ...                   edges=[(0, 1), (0, 2), (1, 3), (2, 3)], source=0, target=3)
    >>> round(evaluate(solve(network))['energy_efficient'].v_repeated, 3)
    1.0
    """
    if isinstance(planned, Plan):
        return compared(planned.drawn_from, planned.trip)
    return compared(planned.as_trip, planned.as_trip)


def compared(drawn: TripStrategy, whole: TripStrategy) -> dict[str, Measures]:
    """Compare strategies with the planners that always drive one route of a leg's whole network.

    The strategies are the same unless departures are ``drawn`` from few routes.
    """
    legs = drawn.joint
    p_first = _meets(legs, [leg.law for leg in drawn.legs], drawn.ambusher.q)
    stochastic = Measures('stochastic', drawn.expected_length, p_first, p_first, drawn.value)
    return {
        'stochastic': stochastic,
        'energy_efficient': _fixed('energy_efficient', whole, energy_efficient_route),
        'risk_avoidance': _fixed('risk_avoidance', whole, risk_avoiding_route),
    }


def energy_efficient_route(game: Game) -> IndexArray:
    """Nodes (K,) of a shortest route."""
    return shortest_route(game.network, np.flatnonzero(game.playable))


def risk_avoiding_route(game: Game) -> IndexArray:
    """Nodes (K,) of a route of least sum of alpha; among these, of a shortest one."""
    through = game.least_weights(game.network.alpha[game.network.heads])
    tied = through <= through.min() * (1.0 + TIE)
    return shortest_route(game.network, np.flatnonzero(tied))


def _fixed(planner: str, trip: TripStrategy, choose: Callable[[Game], IndexArray]) -> Measures:
    legs = trip.joint
    flows = [route_strategy(game.network, choose(game)) for game in legs.games]
    laws = [law_of(game, p) for game, p in zip(legs.games, flows, strict=True)]
    worst, _ = largest_product(legs.loss, legs.entering, joint_law(legs, laws))
    length = sum(float(p @ game.network.travel_costs)
                 for game, p in zip(legs.games, flows, strict=True))
    return Measures(planner, length, _meets(legs, laws, trip.ambusher.q),
                    1.0 if worst > 0.0 else 0.0, worst)


def _meets(legs: Legs, laws: Sequence[Law], q: FloatArray) -> float:
    """P(the ambusher who waits by q (N,) hits any leg), the paper's equation 8."""
    at_sites = q[legs.games[0].sites]
    rows = np.flatnonzero(at_sites > 0.0)
    missed = [1.0 - law.meets(own) for law, own in zip(
        laws, legs.rows_by_leg(csr_matrix(legs.entering[rows])), strict=True)]
    return float(at_sites[rows] @ (1.0 - np.prod(missed, axis=0)))
