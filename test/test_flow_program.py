"""The linear program of the least value: what its solution means, by hand; ambushers held apart."""

from __future__ import annotations

import math

import numpy as np
import pytest
from games import examples
from hypothesis import given
from hypothesis import strategies as st

from ambush_planner import GameOptions, Network, StrategyOptions
from ambush_planner.game.flow_program import FlowProgram, capped_at_one, conservation
from ambush_planner.game.game import make_game
from ambush_planner.game.strategy import make_budgets


def two_ways() -> Network:
    """Straight on past a loss of 4, 2 m; or round by a loss of 1, 4 m."""
    points = [[0, 0], [1, 0], [1, math.sqrt(3.0)], [2, 0]]
    return Network(points, [0, 4, 1, 0], [(0, 1), (0, 2), (1, 3), (2, 3)], 0, 3)


@pytest.mark.parametrize('solver', ['interior_point', 'simplex'])
@pytest.mark.parametrize('detour, straight, price', [(np.inf, 0.2, 0.0), (1.5, 0.5, 2.0)])
def test_flow_duals_and_prices_by_hand(solver, detour, straight, price):
    """Half of the routes at 1.5 times the length: each metre more turns 1/2 of them, at loss 4."""
    game = make_game(two_ways(), GameOptions())
    budgets = make_budgets(game, StrategyOptions(max_detour=detour))
    program = FlowProgram(game, budgets, 2.0)
    size, flow, duals = program.solve(solver, 1e-9, math.inf)
    assert 2.0 / size == pytest.approx(4.0 * straight, rel=1e-6)
    assert flow / size == pytest.approx(
        [straight, 1.0 - straight, straight, 1.0 - straight], abs=1e-6
    )
    q, prices = program.ambusher(duals, 1e-6)
    assert q == pytest.approx([0.0, 0.2, 0.8, 0.0] if price == 0.0 else [0, 1, 0, 0], abs=1e-6)
    assert prices == pytest.approx((price, 0.0), abs=1e-6)


def test_several_ambushers_share_the_sum():
    """Both sites held: all drive by the cheap one."""
    game = make_game(two_ways(), GameOptions(ambushers=2))
    program = FlowProgram(game, make_budgets(game, StrategyOptions(max_detour=np.inf)), 1.0)
    size, _, duals = program.solve('simplex', 1e-9, math.inf)
    assert 1.0 / size == pytest.approx(1.0)
    q, _ = program.ambusher(duals, 1e-6)
    assert q.sum() == pytest.approx(2.0) and q.max() <= 1.0 + 1e-12 and q[2] == pytest.approx(1.0)


def test_conservation_leaves_out_the_target():
    rows, node = conservation(make_game(two_ways(), GameOptions()))
    assert node.tolist() == [0, 1, 2]
    assert rows.toarray().tolist() == [[1, 1, 0, 0], [-1, 0, 1, 0], [0, -1, 0, 1]]


@examples(90)
@given(st.lists(st.floats(0.0, 5.0), min_size=3, max_size=8), st.integers(1, 3))
def test_capped_probabilities_keep_their_sum(masses, count):
    if sum(masses) < 1e-3:
        return
    q = capped_at_one(np.array(masses) * count / sum(masses), count)
    assert q.sum() == pytest.approx(count) and q.max() <= 1.0 + 1e-9 and q.min() >= 0.0
