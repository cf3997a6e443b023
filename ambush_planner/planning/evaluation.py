# SPDX-License-Identifier: Apache-2.0
"""Comparison of the stochastic planner with deterministic ones (the paper's table III)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray, IndexArray
from ..game.game import Game
from ..game.hits import law_of, meeting_probability, worst_loss
from ..game.route_sampler import route_strategy, shortest_route
from ..game.strategy import Strategy
from .plan import Plan

# Relative difference up to which sums of alpha are ties.
TIE = 1e-12


@dataclass(frozen=True)
class Measures:
    """One planner's row of the table.

    ``expected_length`` is E [m, or s if the network has driving times]; ``p_first`` is P_1, the
    probability of an ambush by the equilibrium ambusher; ``p_repeated`` and ``v_repeated`` are
    P_inf and V_inf, probability and mean loss of an ambush by one who has learnt the planner's
    strategy.
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
        (drawn,) = planned.drawn_from.legs
        return compared(drawn, planned.strategy)
    return compared(planned, planned)


def compared(drawn: Strategy, whole: Strategy) -> dict[str, Measures]:
    """Compare a strategy with the planners that always drive one route of a whole network.

    The strategies are the same unless departures are ``drawn`` from few routes.
    """
    p_first = meeting_probability(drawn.game, drawn.law, drawn.ambush_probability)
    stochastic = Measures('stochastic', drawn.expected_length, p_first, p_first, drawn.value)
    game, q = whole.game, whole.ambush_probability
    return {
        'stochastic': stochastic,
        'energy_efficient': _fixed('energy_efficient', game, energy_efficient_route(game), q),
        'risk_avoidance': _fixed('risk_avoidance', game, risk_avoiding_route(game), q),
    }


def energy_efficient_route(game: Game) -> IndexArray:
    """Nodes (K,) of a shortest route."""
    return shortest_route(game.network, np.flatnonzero(game.playable))


def risk_avoiding_route(game: Game) -> IndexArray:
    """Nodes (K,) of a route of least sum of alpha; among these, of a shortest one."""
    through = game.least_weights(game.network.alpha[game.network.heads])
    tied = through <= through.min() * (1.0 + TIE)
    return shortest_route(game.network, np.flatnonzero(tied))


def _fixed(planner: str, game: Game, route: IndexArray, q: FloatArray) -> Measures:
    p = route_strategy(game.network, route)
    worst = worst_loss(game, p)
    return Measures(planner, float(p @ game.network.travel_costs),
                    meeting_probability(game, law_of(game, p), q),
                    1.0 if worst > 0.0 else 0.0, worst)
