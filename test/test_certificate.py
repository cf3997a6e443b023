# SPDX-License-Identifier: Apache-2.0
"""The certificate: it refuses wrong strategies, and holds at any scale of the losses."""

import math
from dataclasses import replace

import numpy as np
import pytest
from games import PLAIN, examples, least_weight, networks, paper_example, terrain_network
from hypothesis import given
from hypothesis import strategies as st

from ambush_planner import (
    BudgetInfeasible,
    GameOptions,
    InvalidNetwork,
    Network,
    SolverFailed,
    StrategyOptions,
    solve,
)
from ambush_planner.game.ambusher import Ambusher
from ambush_planner.game.budget import Budget, length_budget
from ambush_planner.game.certificate.certificate import lower_bounds
from ambush_planner.game.game import make_game
from ambush_planner.game.legs import Legs
from ambush_planner.game.route_sampler import shortest_route_strategy
from ambush_planner.game.strategy import make_strategies
from ambush_planner.game.tolerance import CERTIFICATE_TOLERANCE

SLACK = StrategyOptions().risk_slack


def certify(game, p, ambusher, budget, bound=None):
    """The strategy of one leg with its certificate."""
    legs = Legs((game,), (budget,))
    bounds = lower_bounds(legs, ambusher) if bound is None else np.array([bound])
    return make_strategies(legs, p, [None], ambusher, bounds).legs[0]


def lower_bound(game, ambusher, budget, deadline=math.inf):
    """The bound that the ambusher proves for a single leg."""
    return float(lower_bounds(Legs((game,), (budget,)), ambusher, deadline)[0])


def case(detour=1.2, network=None, **game):
    """The arguments of ``certify`` for a solved game: game, p, ambusher, budget."""
    network = network or terrain_network(4, cells=10)
    options = StrategyOptions(max_detour=detour)
    found = solve(network, GameOptions(**game), options)
    return found.game, found.edge_probability.copy(), found.ambusher, found.budget


def test_a_wrong_q_is_refused():
    *_, ambusher, _ = case()
    q, at = ambusher.q, np.arange(len(ambusher.q))
    entries = ((q.argmax(), np.nan), (q.argmax(), np.inf), (q.argmin(), -1e-3))
    for wrong, words in [
        *((wrong, 'sum to 1') for wrong in (q * 1.001, q * 0.999, np.zeros_like(q))),
        *((np.where(at == k, entry, q), 'must be >= 0') for k, entry in entries),
    ]:
        with pytest.raises(SolverFailed, match=words):
            replace(ambusher, q=wrong)


def test_a_wrong_p_is_refused():
    game, p, ambusher, budget = case()
    used = int(np.argmax(p))
    for change, words in ((-2.0, '>= 0'), (np.nan, '>= 0'), (0.01, 'not a flow')):
        wrong = p.copy()
        wrong[used] += change
        with pytest.raises(SolverFailed, match=words):
            certify(game, wrong, ambusher, budget)
    for wrong in (0.999 * p, np.zeros_like(p)):
        with pytest.raises(SolverFailed, match='not a flow'):
            certify(game, wrong, ambusher, budget)
    closed = game.playable.copy()
    closed[used] = False
    with pytest.raises(SolverFailed, match='not playable'):
        certify(replace(game, playable=closed), p, ambusher, budget)
    game, p, ambusher, _ = case(2.0)
    tight = length_budget(game, 1.1)
    with pytest.raises(SolverFailed, match=r'length is .* over the budget'):
        certify(game, p, ambusher, tight)


def test_a_proof_that_time_cuts_short_is_a_lower_one():
    game, _, ambusher, budget = case(1.5, terrain_network(4, 'uniform_grid8', 10),
                                     ambush_radius=1.2, secured_radius=1.0)
    whole = lower_bound(game, ambusher, budget)
    short = lower_bound(game, ambusher, budget, deadline=-math.inf)
    assert short <= whole


@pytest.mark.parametrize('price', [-1e-9, -1.0, np.nan])
def test_a_wrong_price_is_refused(price):
    *_, ambusher, _ = case()
    with pytest.raises(SolverFailed, match='price'):
        replace(ambusher, prices=(price,))


@examples(25)
@given(networks(alphas=PLAIN), st.integers(0, 10**6), st.floats(0, 5), st.floats(1.0, 2.0))
def test_weak_duality_holds_for_any_q_and_price(network, seed, price, detour):
    """Checked by an independent Dijkstra."""
    game = make_game(network, GameOptions())
    budget = length_budget(game, detour)
    q = np.random.default_rng(seed).dirichlet(np.ones(game.node_count))
    bound = lower_bound(game, Ambusher(q, (price,)), budget)
    weights = (q * network.alpha)[network.heads] + price * network.lengths
    expected = least_weight(network, weights) - price * budget.limit
    assert bound == pytest.approx(expected, rel=1e-9, abs=1e-6)
    value = solve(network, options=StrategyOptions(max_detour=detour)).value
    assert bound <= value * (1 + 1e-9) + 1e-7 * price * budget.limit


# The budget.


def test_a_budget_below_the_best_route_is_infeasible():
    game = make_game(paper_example(), GameOptions())
    with pytest.raises(BudgetInfeasible, match=r'length 3 .*raise max_detour'):
        Budget(game, 2.9, 3.0)
    shortest = length_budget(game, 1.0)
    assert 0.0 < shortest.margin < 1e-9 and shortest.keeps(shortest_route_strategy(game))
    timed = replace(game, network=replace(game.network, seconds=0.0 * game.network.lengths))
    nothing = Budget(timed, 0.0, 0.0)
    assert 0.0 < nothing.margin < 1e-9 and nothing.keeps(shortest_route_strategy(game))
    unlimited = length_budget(game, np.inf)
    assert not unlimited.is_limited and unlimited.shortest == pytest.approx(3.0)


# Scale.


@pytest.mark.parametrize(('exponent', 'detour'), [
    (-9, 1.1), (-9, np.inf), (-4, 1.1), (4, np.inf), (8, 1.1), (8, np.inf)])
def test_within_tolerance_at_every_scale(exponent, detour):
    plain = terrain_network(2, cells=9)
    alpha = plain.alpha * 10.0**exponent
    network = Network(plain.points, alpha, plain.edges, plain.source, plain.target)
    strategy = solve(network, options=StrategyOptions(max_detour=detour))
    visits = np.bincount(network.heads, strategy.edge_probability, len(alpha))
    assert strategy.value == pytest.approx((alpha * visits).max(), rel=1e-12, abs=0.0)
    assert strategy.lower_bound > 0.0
    assert strategy.value <= strategy.lower_bound * (1 + SLACK + CERTIFICATE_TOLERANCE)
    same = solve(plain, options=StrategyOptions(max_detour=detour)).value
    assert strategy.value == pytest.approx(same * 10.0**exponent, rel=SLACK, abs=0.0)


@pytest.mark.parametrize('loss', [1.1e9, 0.9e-9])
def test_losses_out_of_range_are_refused(loss):
    network = Network([[0, 0], [1, 0], [2, 0]], [0, loss, 0], [(0, 1), (1, 2)], 0, 2)
    with pytest.raises(InvalidNetwork, match=r'1e-09\.\.1e\+09.* at node 1; scale the losses'):
        solve(network)
