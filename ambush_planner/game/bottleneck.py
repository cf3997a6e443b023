# SPDX-License-Identifier: Apache-2.0
"""The sites that decide the value, and what remains of it if the ends were secured."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..arrays import NEGLIGIBLE, ROUNDING, IndexArray, frozen_array
from .discs import secured_area
from .revaluation import budget_in_game
from .search import SearchProblem
from .solver import find_value
from .strategy import Strategy

# Sites are near the source, a stop or the target within this many median edge lengths.
NEAR_EDGES = 2.0
# Risk slack of the search for the secured bound.
SECURED_SLACK = 0.05


@dataclass(frozen=True, eq=False)
class Bottleneck:
    """The ambusher's sites and where they lie.

    The equilibrium ambusher waits only at ``sites`` (K,): in the plain game, a minimum cut.
    ``near_ends`` counts the sites within ``distance`` [m] of source, stops or target.
    """

    sites: IndexArray
    near_ends: int
    distance: float


def find_bottleneck(strategy: Strategy) -> Bottleneck:
    """Report the sites that decide the strategy's value."""
    game, q = strategy.game, strategy.ambush_at_places
    network, first = game.network, game.network.representatives
    decisive = (q > NEGLIGIBLE * q.max()) & (game.loss[first] > 0.0)
    sites = first[decisive & (strategy.value > 0.0)]
    distance = NEAR_EDGES * float(np.median(network.lengths[game.playable]))
    near = secured_area(network, distance).covers(network.points[sites])
    return Bottleneck(frozen_array(sites, np.int64), int(near.sum()), distance)


def secured_bound(strategy: Strategy, distance: float,
                  deadline: float = math.inf) -> float | None:
    """A lower bound of the value if nobody could wait within ``distance`` [m] of the ends.

    It keeps the strategy's budget and counts the sites known so far, so that another search could
    find a greater one. None if nothing is proved by ``deadline`` (``time.monotonic``).
    """
    near = secured_area(strategy.network, distance).covers(strategy.network.points)
    game = strategy.game.without_layers().without_sites(near)
    budget = budget_in_game(game, strategy)
    search = find_value(SearchProblem(game, budget, SECURED_SLACK, deadline, judged=deadline))
    kept, enough = np.ones(len(game.sites), dtype=bool), search.lp.bound * (1.0 - ROUNDING)
    bound, _ = search.proof(game, kept, budget, enough)
    return None if search.problem.late or search.reason != 'stalled' else min(bound, strategy.value)
