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
    """Row of the table for one planner.

    ``expected_length`` is E [m, or s if the network has driving times]. ``p_first`` is P_1, the
    probability of being hit by the equilibrium ambusher. ``p_repeated`` and ``v_repeated`` are
    P_inf and V_inf: probability of a hit and mean loss if the ambusher has learnt the planner's
    strategy. On a trip with stops, losses are summed over the legs.
    """

    planner: str
    expected_length: float
    p_first: float
    p_repeated: float
    v_repeated: float


def evaluate(planned: Strategy | Plan) -> dict[str, Measures]:
    """Compare a plan or a strategy with planners that always drive the same route.

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
        return compare_with_fixed(planned.drawn_from, planned.trip)
    return compare_with_fixed(planned.as_trip, planned.as_trip)


def compare_with_fixed(drawn: TripStrategy, whole: TripStrategy) -> dict[str, Measures]:
    """Compare the strategies that departures are ``drawn`` from with fixed routes.

    Fixed routes are those of the ``whole`` networks; the strategies differ only if departures are
    drawn from few routes.
    """
    legs = drawn.joint
    p_first = _hit_probability(legs, [leg.law for leg in drawn.legs], drawn.ambusher.q)
    stochastic = Measures('stochastic', drawn.expected_length, p_first, p_first, drawn.value)
    return {
        'stochastic': stochastic,
        'energy_efficient': _measure_fixed('energy_efficient', whole, energy_efficient_route),
        'risk_avoidance': _measure_fixed('risk_avoidance', whole, risk_avoiding_route),
    }


def energy_efficient_route(game: Game) -> IndexArray:
    """Return the nodes (K,) of a shortest route."""
    return shortest_route(game.network, np.flatnonzero(game.playable))


def risk_avoiding_route(game: Game) -> IndexArray:
    """Return the nodes (K,) of a route of least sum of alpha; of several, of a shortest one."""
    least_alpha = game.least_weights(game.network.alpha[game.network.heads])
    tied = least_alpha <= least_alpha.min() * (1.0 + TIE)
    return shortest_route(game.network, np.flatnonzero(tied))


def _measure_fixed(planner: str, trip: TripStrategy,
                   choose: Callable[[Game], IndexArray]) -> Measures:
    legs = trip.joint
    flows = [route_strategy(game.network, choose(game)) for game in legs.games]
    laws = [law_of(game, p) for game, p in zip(legs.games, flows, strict=True)]
    worst, _ = largest_product(legs.loss, legs.entering, joint_law(legs, laws))
    length = sum(float(p @ game.network.travel_costs)
                 for game, p in zip(legs.games, flows, strict=True))
    return Measures(planner, length, _hit_probability(legs, laws, trip.ambusher.q),
                    1.0 if worst > 0.0 else 0.0, worst)


def _hit_probability(legs: Legs, laws: Sequence[Law], q: FloatArray) -> float:
    """Probability that an ambusher with the strategy q (N,) hits some leg (paper, equation 8)."""
    site_q = q[legs.games[0].sites]
    rows = np.flatnonzero(site_q > 0.0)
    missed = [1.0 - law.meets(leg_rows) for law, leg_rows in zip(
        laws, legs.rows_by_leg(csr_matrix(legs.entering[rows])), strict=True)]
    return float(site_q[rows] @ (1.0 - np.prod(missed, axis=0)))
