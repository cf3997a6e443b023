"""The value program against HiGHS on all edges: budgets, a reach, several ambushers."""

from __future__ import annotations

import math
import time
from itertools import combinations

import numpy as np
import pytest
from games import (
    METHODS,
    PLAIN,
    examples,
    geometric_hits,
    is_acyclic,
    least_weight,
    networks,
    program_value,
    terrain_network,
    unbalanced,
)
from hypothesis import given
from hypothesis import strategies as st

from ambush_planner import BudgetInfeasible, GameOptions, Network, StrategyOptions, solve
from ambush_planner.game.acyclic import order_potential
from ambush_planner.game.cut import solve_by_min_cut
from ambush_planner.game.entries import entry_bound, entry_value
from ambush_planner.game.game import make_game
from ambush_planner.game.least_risk import least_risk, least_risk_by_cut, least_value
from ambush_planner.game.route_sampler import shortest_route_strategy
from ambush_planner.game.strategy import make_budgets
from ambush_planner.game.two_routes import strategy_within_budgets

NEVER = math.inf
CLOSED = 1e-6
OPTIMAL = 2e-5  # of value and bound, relative: see CERTIFICATE_TOLERANCE


def solved(network, detour=np.inf, exposure=np.inf, deadline=NEVER, **options):
    game = make_game(network, GameOptions(**options))
    budgets = make_budgets(game, StrategyOptions(max_detour=detour, max_exposure=exposure))
    return game, budgets, least_risk(game, budgets, order_potential(game), CLOSED, deadline)


def check(game, budgets, risk, expected) -> None:
    """A strategy within the budgets, an ambusher, and the value of the program between them."""
    network = game.network
    assert unbalanced(network, risk.p) < 1e-9 and is_acyclic(network, risk.p)
    assert all(b.mean(risk.p) <= b.limit * (1 + 1e-6) for b in budgets)
    assert risk.q.sum() == pytest.approx(game.ambushers) and risk.q.max() <= 1 + 1e-12
    assert risk.value == entry_value(game, risk.p)
    assert risk.bound == entry_bound(game, risk.q, budgets, risk.prices)
    assert risk.bound <= expected * (1 + OPTIMAL)
    assert risk.bound == pytest.approx(expected, rel=OPTIMAL)
    assert risk.value == pytest.approx(expected, rel=OPTIMAL)


@examples(35)
@given(networks(alphas=PLAIN), st.integers(1, 3))
def test_several_ambushers_on_any_network(network, count):
    expected = program_value(network, ambushers=count)
    if expected == 0.0 or make_game(network, GameOptions()).avoiding_all_sites() is not None:
        return
    check(*solved(network, ambushers=count), expected)


@pytest.mark.parametrize('method', METHODS)
@pytest.mark.parametrize('reach', [0.0, 1.5, 3.0])
@pytest.mark.parametrize('count, detour', [(1, 1.05), (1, np.inf), (2, 1.2)])
def test_terrain(method, reach, count, detour):
    network = terrain_network(8, method, 12)
    hits = geometric_hits(network, reach) if reach else None
    if hits is not None and not hits.nnz:
        return
    budget = detour * least_weight(network, network.lengths)
    expected = program_value(network, hits, budget, count)
    check(*solved(network, detour, ambush_radius=reach, ambushers=count), expected)


def test_a_thousand_nodes_with_budget_and_reach():
    network = terrain_network(11, cells=40)
    assert 800 < len(network.points) < 1500
    budget = 1.1 * least_weight(network, network.lengths)
    expected = program_value(network, geometric_hits(network, 4.0), budget)
    check(*solved(network, 1.1, ambush_radius=4.0), expected)


@pytest.mark.parametrize('reach', [0.0, 3.0])
def test_the_strategy_to_begin_around_does_not_matter(reach):
    network = terrain_network(8, cells=20)
    game, budgets, risk = solved(network, 1.1, ambush_radius=reach)
    on_budget, over_budget = risk.p, solve_by_min_cut(make_game(network, GameOptions())).p
    assert over_budget @ network.lengths > budgets[0].limit
    for good in (shortest_route_strategy(game), on_budget, over_budget):
        again = least_risk(game, budgets, order_potential(game), CLOSED, NEVER, good)
        check(game, budgets, again, risk.value)


def parallel(alphas) -> Network:
    """Parallel ways of one node each, all equally long."""
    n = len(alphas)
    points = [[0, 0], *([1, 0.0] for _ in alphas), [2, 0]]
    edges = [(0, k + 1) for k in range(n)] + [(k + 1, n + 1) for k in range(n)]
    return Network(points, [0, *alphas, 0], edges, 0, n + 1)


def test_several_ambushers_by_hand():
    # Three equal parallel nodes, two ambushers: each way has 1/3, and two of them are held.
    assert solved(parallel([3, 3, 3]), ambushers=2)[2].value == pytest.approx(2.0)
    # As many ambushers as ways.
    assert solved(parallel([3, 3]), ambushers=2)[2].value == pytest.approx(3.0)
    # Losses 1, 10, 10: k q_j <= 1 fails for the cheap one. All routes through it cost 1 in
    # total; any share x elsewhere costs more: 1 - x + 10 x / 2.
    risk = solved(parallel([1, 10, 10]), ambushers=2)[2]
    assert risk.value == pytest.approx(1.0, rel=1e-6)
    assert risk.q[1] == pytest.approx(1.0, abs=1e-6)


def test_more_ambushers_than_sites_with_a_budget():
    # One site on the short way; the budget lets 3 / 4 pass it; the second ambusher is idle.
    height = np.sqrt(3.0)
    points = [[0, 0], [1, 0], [1, height], [2, 0]]
    network = Network(points, [0, 4, 0, 0], [(0, 1), (0, 2), (1, 3), (2, 3)], 0, 3)
    risk = solved(network, 1.25, ambushers=2)[2]
    assert risk.value == pytest.approx(3.0) and risk.bound == pytest.approx(3.0, rel=OPTIMAL)


def test_a_corridor_is_held_once_by_each_ambusher():
    network = Network([[k, 0] for k in range(5)], [0, 2, 7, 3, 0],
                      [(k, k + 1) for k in range(4)], 0, 4)
    for count, value in ((1, 7.0), (2, 10.0), (3, 12.0)):
        assert solved(network, ambushers=count)[2].value == pytest.approx(value)


@examples(40)
@given(st.lists(st.sampled_from(PLAIN), min_size=2, max_size=6), st.integers(1, 4))
def test_parallel_ways_against_all_sets_of_ambushers(alphas, count):
    """The value is the largest mean loss over all sets of sites."""
    network, count = parallel(alphas), min(count, len(alphas))
    risk = solved(network, ambushers=count)[2]
    x = np.array([risk.p[k] for k in range(len(alphas))])
    worst = max(sum(alphas[j] * x[j] for j in held) for held in
                combinations(range(len(alphas)), count))
    assert risk.value == pytest.approx(worst, rel=1e-9)
    assert risk.value == pytest.approx(program_value(network, ambushers=count), rel=OPTIMAL)


def test_an_exposure_budget_binds():
    # Straight past loss 4, 2 m; or a detour past loss 1, 4 m.
    points = [[0, 0], [1, 0], [1, np.sqrt(3)], [2, 0]]
    network = Network(points, [0, 4, 1, 0], [(0, 1), (0, 2), (1, 3), (2, 3)], 0, 3)
    free, tight = (solved(network, exposure=e)[2] for e in (np.inf, 1.1))
    # Least risk: 1/5 straight, 4/5 round, 0.8; exposure 8/5 + 16/5 = 4.8, allowed 4.4: 1/10.
    assert free.value == pytest.approx(0.8) and tight.value == pytest.approx(0.9)
    assert tight.prices[1] > 0.0 and free.prices == (0.0, 0.0)


def test_budgets_that_contradict_each_other_are_named():
    points = [[0, 0], [1, 0], [1, 3], [2, 0]]
    network = Network(points, [0, 9, 0.1, 0], [(0, 1), (0, 2), (1, 3), (2, 3)], 0, 3)
    with pytest.raises(BudgetInfeasible, match='max_detour and max_exposure'):
        solved(network, 1.01, 1.01)


@pytest.mark.parametrize('seed', [3, 7, 9, 28, 33])
def test_two_budgets_that_hardly_any_strategy_fits(seed):
    network = terrain_network(seed, cells=20)
    game = make_game(network, GameOptions())

    def options(detour):
        return StrategyOptions(max_detour=detour, max_exposure=1.02)

    def fits(detour):
        try:
            strategy_within_budgets(game, make_budgets(game, options(detour)))
        except BudgetInfeasible:
            return False
        return True

    low, high = 1.0, 3.0
    for _ in range(40):
        middle = (low + high) / 2.0
        low, high = (low, middle) if fits(middle) else (middle, high)
    strategy = solve(network, options=options(high * (1.0 + 1e-6)))
    assert strategy.lower_bound <= strategy.value <= strategy.lower_bound * 1.0101


@examples(20)
@given(networks(), st.integers(1, 3), st.sampled_from((1.0, 1.2, np.inf)))
def test_cut_and_least_value_agree_with_the_linear_program(network, count, detour):
    game = make_game(network, GameOptions(ambushers=min(count, len(network.points))))
    free = program_value(network, ambushers=game.ambushers)
    loose = least_risk_by_cut(game)
    if loose is not None:
        assert loose.value == pytest.approx(free, rel=OPTIMAL, abs=1e-9)
        assert loose.bound == pytest.approx(free, rel=OPTIMAL, abs=1e-9)
        assert entry_bound(game, loose.q) == pytest.approx(loose.bound, rel=1e-9)
        assert is_acyclic(network, loose.p)
    budgets = make_budgets(game, StrategyOptions(max_detour=detour))
    shortest = least_weight(network, network.lengths)
    loosely = program_value(network, None, detour * shortest * (1 + 2e-6), game.ambushers)
    tightly = program_value(network, None, detour * shortest * (1 + 1e-12), game.ambushers)
    least = least_value(game, budgets, 1e-3, NEVER)
    assert loosely * (1 - 2e-3) - 1e-9 <= least <= tightly * (1 + OPTIMAL) + 1e-9


def test_at_the_deadline_the_least_value_is_the_cut():
    game = make_game(terrain_network(1, cells=10), GameOptions())
    budgets = make_budgets(game, StrategyOptions(max_detour=1.0))
    past = time.monotonic() - 1.0
    assert least_value(game, budgets, CLOSED, past) == least_risk_by_cut(game).bound
    reaching = make_game(game.network, GameOptions(ambush_radius=2.0))
    budgets = make_budgets(reaching, StrategyOptions(max_detour=1.0))
    assert least_value(reaching, budgets, CLOSED, past) == 0.0
