# SPDX-License-Identifier: Apache-2.0
"""The LP over whole routes, against linear programs over all routes of small networks."""

import math
from dataclasses import replace

import numpy as np
import pytest
from games import examples, is_acyclic, trip_value, unbalanced
from hypothesis import given, reject
from hypothesis import strategies as st
from scipy.sparse import csr_matrix
from test_trip import roads_of

from ambush_planner import GameOptions, NoRoute
from ambush_planner.game.budget import length_budget
from ambush_planner.game.certificate.certificate import lower_bounds
from ambush_planner.game.game import make_games
from ambush_planner.game.hits import largest_product, law_of
from ambush_planner.game.legs import Legs
from ambush_planner.game.value.routes import Routes

GAP = 1e-3


def worst_loss(game, p):
    """Mean loss of the best ambush against p of one leg."""
    return largest_product(game.loss[game.sites], game.entering, law_of(game, p))[0]


def least_value(legs, entering, loss):
    """The least value of any mixtures of simple routes of the legs."""
    hits = [rows.toarray() > 0.0 for rows in legs.rows_by_leg(csr_matrix(entering))]
    networks = [game.network for game in legs.games]
    limits = [budget.limit * (1.0 + 1e-9) for budget in legs.budgets]
    return trip_value(loss, networks, hits, limits)


def random_legs(seed, stops, reach, detour):
    """The legs of a trip on random roads, some one-way, some crossing."""
    roads = roads_of(seed, stops, 4)
    ways, kept = np.random.default_rng(seed), np.ones(len(roads.edges), dtype=bool)
    kept[ways.integers(0, len(kept), 2)] = False  # one-way
    pairs = np.array([(a, b) for a in range(4) for b in range(4) if a != b])
    edges = np.unique(np.concatenate((roads.edges[kept], pairs[ways.integers(0, 12, 3)])), axis=0)
    try:
        return legs_on(replace(roads, edges=edges), reach, detour)
    except NoRoute:
        reject()


def legs_on(roads, reach, detour):
    games = make_games(roads.networks(), GameOptions(ambush_radius=reach, secured_radius=0.5))
    return Legs(games, tuple(length_budget(game, detour) for game in games))


def solved(legs):
    found = Routes(legs, GAP)
    found.solve(math.inf)
    return found


@examples(40)
@given(seed=st.integers(0, 10**6), stops=st.integers(0, 2),
       reach=st.sampled_from([0.0, 1.0, 2.5]), detour=st.sampled_from([1.0, 1.05, 1.3, math.inf]))
def test_the_bound_is_below_every_mixture_and_the_value_is_one(seed, stops, reach, detour):
    legs = random_legs(seed, stops, reach, detour)
    found = solved(legs)
    check(found, legs, least_value(legs, legs.entering, legs.loss))
    # The judge reproduces the bound.
    ambusher = found.ambush.ambusher(legs.games[0], np.ones(len(legs.loss), dtype=bool))
    assert lower_bounds(legs, ambusher).sum() >= found.bound * (1.0 - 1e-9) - 1e-9
    if reach == 0.0:
        assert found.value <= found.bound * (1.0 + GAP) + 1e-9
    if reach == 0.0 and stops == 0:
        assert found.value == pytest.approx(worst_loss(legs.games[0], found.flow), rel=1e-6,
                                            abs=1e-9)


def check(found, legs, least):
    """Laws of a solved LP, whose least value is known."""
    assert found.bound <= least * (1.0 + 1e-6) + 1e-9
    assert found.value >= least * (1.0 - 1e-6) - 1e-9
    assert found.q.min(initial=0.0) >= 0.0 and found.q.max(initial=0.0) <= 1.0 + 1e-9
    assert found.bound == 0.0 or found.q.sum() == pytest.approx(1.0)
    shares = np.bincount(found.mixture.leg, found.mixture.shares)
    assert found.mixture.shares.min() > 0.0 and shares == pytest.approx(np.ones(len(legs.games)))
    for game, budget, p in zip(legs.games, legs.budgets, legs.split(found.flow), strict=True):
        assert unbalanced(game.network, p) < 1e-9 and is_acyclic(game.network, p)
        assert budget.keeps(p)
    assert found.prices.min() >= 0.0
