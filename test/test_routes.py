# SPDX-License-Identifier: Apache-2.0
"""The LP over whole routes, against linear programs over all routes of small networks."""

import math
from dataclasses import replace

import numpy as np
import pytest
from games import examples, is_acyclic, routes_of, unbalanced, value_by_routes
from hypothesis import given, reject
from hypothesis import strategies as st
from scipy.sparse import csr_matrix
from test_trip import roads_of

from ambush_planner import GameOptions, Network, NoRoute, TimeLimit
from ambush_planner.game.budget import Budget
from ambush_planner.game.certificate.best_response import best_response
from ambush_planner.game.game import make_game
from ambush_planner.game.hits import worst_loss
from ambush_planner.game.value.routes import Routes

GAP = 1e-3


def least_value(game, budget, hits, loss):
    """The least value of any mixture of simple routes; None if none is within the budget."""
    limits = [(budget.cost, budget.limit * (1.0 + 1e-9))] if budget.binds else []
    routes = routes_of(game.network, game.playable)
    return value_by_routes(loss, hits.toarray(), routes, limits)


def games(seed, stops, reach, detour):
    """A game on random roads, some one-way, some crossing; and its budget."""
    roads = roads_of(seed, stops, 4)
    ways, kept = np.random.default_rng(seed), np.ones(len(roads.edges), dtype=bool)
    kept[ways.integers(0, len(kept), 2)] = False  # one-way
    pairs = np.array([(a, b) for a in range(4) for b in range(4) if a != b])
    edges = np.unique(np.concatenate((roads.edges[kept], pairs[ways.integers(0, 12, 3)])), axis=0)
    roads = replace(roads, edges=edges)
    try:
        game, budget = game_on(roads, reach, detour)
    except NoRoute:
        reject()
    return game, budget


def game_on(roads, reach, detour):
    game = make_game(roads.network(roads.visits),
                     GameOptions(ambush_radius=reach, secured_radius=0.5))
    return game, Budget.length(game, detour)


GAMES = {
    'seed': st.integers(0, 10**6), 'stops': st.integers(0, 1),
    'reach': st.sampled_from([0.0, 1.0, 2.5]),
    'detour': st.sampled_from([1.0, 1.05, 1.3, math.inf]),
}


@examples(40)
@given(**GAMES)
def test_the_bound_is_below_every_mixture_and_the_value_is_one(seed, stops, reach, detour):
    game, budget = games(seed, stops, reach, detour)
    least = least_value(game, budget, game.entering, game.loss[game.sites])
    found = Routes(game, budget, GAP, math.inf)
    if stops and seed % 2:  # which adds routes to begin with
        found.prove_by_legs()
        assert found.bound <= least * (1.0 + 1e-6)  # as in check
    found.solve()
    check(found, budget, least)
    # The judge reproduces the bound.
    him = found.ambusher(game, np.ones(len(game.sites), dtype=bool))
    judged = best_response(game, him, budget)
    assert judged >= found.bound * (1.0 - 1e-9) - 1e-12
    if reach == 0.0 and stops == 0:
        assert found.value <= found.bound * (1.0 + GAP) + 1e-9
        assert found.value == pytest.approx(worst_loss(game, found.flow), rel=1e-6, abs=1e-9)


def check(found, budget, least):
    """Laws of a solved LP, whose least value is known."""
    game = found.game
    assert found.bound <= least * (1.0 + 1e-6) + 1e-9
    assert found.value >= least * (1.0 - 1e-6) - 1e-9
    assert found.q.min(initial=0.0) >= 0.0 and found.q.max(initial=0.0) <= 1.0 + 1e-9
    assert not len(found.q) or found.q.sum() == pytest.approx(1.0)
    assert found.shares.min() >= 0.0 and found.shares.sum() == pytest.approx(1.0)
    assert unbalanced(game.network, found.flow) < 1e-9 and is_acyclic(game.network, found.flow)
    assert budget.keeps(found.flow) and found.price >= 0.0


@examples(10)
@given(seed=st.integers(0, 10**6), stops=st.integers(0, 1),
       reach=st.sampled_from([1.0, 2.0]))
def test_sites_that_join_count_like_those_from_the_beginning(seed, stops, reach):
    game, budget = games(seed, stops, reach, 1.2)
    rng = np.random.default_rng(seed)
    more = csr_matrix((rng.random((3, len(game.playable))) < 0.2).astype(float))
    loss = rng.uniform(1.0, 5.0, 3)
    found = Routes(game, budget, GAP, math.inf)
    found.solve()
    before = found.bound, found.value
    found.add_sites(more, loss)
    assert found.bound == before[0] and found.value >= before[1] * (1.0 - 1e-9)
    assert len(found.q) == len(game.sites) + 3
    found.solve()
    entering = csr_matrix(np.vstack((game.entering.toarray(), more.toarray())))
    check(found, budget, least_value(game, budget, entering,
                                      np.append(game.loss[game.sites], loss)))


def test_without_sites_the_value_is_0():
    points = np.array([(0.0, 0.0), (1.0, 0.0), (2.0, 0.0)])
    game = make_game(Network(points, np.zeros(3), [(0, 1), (1, 2)], 0, 2), GameOptions())
    found = Routes(game, Budget.length(game, 1.2), GAP, math.inf)
    found.solve()
    assert (found.bound, found.value, found.flow.tolist()) == (0.0, 0.0, [1.0, 1.0])


def test_at_the_deadline_there_is_a_strategy():
    game, budget = game_on(roads_of(5, 1, 4), 1.0, 1.3)
    found = Routes(game, budget, GAP, -math.inf)
    with pytest.raises(TimeLimit):
        found.solve()
    assert found.bound <= found.value < math.inf
    assert found.flow[game.network.tails == game.network.source].sum() == pytest.approx(1.0)
    with pytest.raises(TimeLimit):
        found.mixtures.solve(1e-3, -math.inf)


def test_sites_that_join_between_two_proofs_without_time():
    game, budget = game_on(roads_of(5, 1, 4), 1.0, 1.3)
    found = Routes(game, budget, GAP, math.inf)
    found.prove_by_legs()
    found.bound, found.deadline = 0.0, -math.inf
    found.add_sites(game.entering[:2], game.loss[game.sites[:2]])
    with pytest.raises(TimeLimit):
        found.prove_by_legs()
    assert found.bound == 0.0 and len(found.q) == len(found.loss)
