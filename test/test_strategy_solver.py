"""The default strategy against the most route entropy by Clarabel; its stages; its budgets."""

from __future__ import annotations

import math

import numpy as np
import pytest
from games import (
    METHODS,
    PLAIN,
    examples,
    geometric_hits,
    ground_network,
    is_acyclic,
    least_weight,
    networks,
    paper_example,
    program_value,
    quiet_network,
    terrain_network,
)
from hypothesis import given
from hypothesis import strategies as st
from route_entropy import most_route_entropy
from scipy.sparse import csr_matrix, vstack

from ambush_planner import GameOptions, SolverFailed, StrategyOptions, TimeLimit, solve
from ambush_planner.game import face_program, least_on_faces, strategy_solver
from ambush_planner.game.certificate import certify
from ambush_planner.game.entries import entry_value
from ambush_planner.game.entropy_stage import EntropyStage
from ambush_planner.game.game import make_game
from ambush_planner.game.hits import worst_loss
from ambush_planner.game.limit_rows import LimitRows
from ambush_planner.game.route_sampler import shortest_route_strategy
from ambush_planner.game.strategy import make_budgets
from ambush_planner.game.strategy_solver import max_entropy_strategy

DETOURS = (1.05, 1.2, 1.5, np.inf)


def maximize_entropy(strategy, value: float, budget: float) -> float:
    """Clarabel's entropy on the strategy's own edges, losses up to ``value``; NaN: no answer."""
    game, network = strategy.game, strategy.network
    edges = np.flatnonzero(strategy.edge_probability > 0.0)
    rows, limits = game.hits[:, edges], value / game.loss[game.sites]
    binding = (limits < 1.0) | (game.reach > 0.0)
    rows, limits = rows[np.flatnonzero(binding)], limits[binding]
    if math.isfinite(budget):
        rows = vstack((rows, csr_matrix(network.lengths[edges] / budget)))
        limits = np.append(limits, 1.0)
    return most_route_entropy(network, edges, rows, limits)


def check_entropy(strategy, slack: float) -> None:
    """Not more than anybody can have, nor less than what a tenth less of the slack allows."""
    budget = strategy.length_budget
    value = entry_value(strategy.game, strategy.edge_probability)
    most = maximize_entropy(strategy, value, budget * (1 + 1e-9))
    if not math.isnan(most):
        assert strategy.route_entropy <= most * (1 + 1e-5) + 1e-5
    least = strategy.lower_bound * (1 + 0.8 * slack)
    shortest = strategy.shortest_length
    sure = maximize_entropy(strategy, least, shortest + 0.99 * (budget - shortest))
    if not math.isnan(sure):
        assert strategy.route_entropy >= sure * (1 - 5e-3) - 1e-3


@pytest.mark.parametrize('method', METHODS)
@examples(6)
@given(seed=st.integers(0, 10**6), cells=st.integers(6, 16), detour=st.sampled_from(DETOURS),
       slack=st.sampled_from((0.01, 0.1)))
def test_terrain(method, seed, cells, detour, slack):
    network = terrain_network(seed, method, cells)
    options = StrategyOptions(max_detour=detour, risk_slack=slack)
    check_entropy(solve(network, options=options), slack)


@examples(28)
@given(networks(alphas=PLAIN), st.sampled_from(DETOURS))
def test_any_network(network, detour):
    check_entropy(solve(network, options=StrategyOptions(max_detour=detour)), 0.01)


@examples(12)
@given(st.integers(0, 10**6), st.floats(1.0, 4.0), st.sampled_from((1.2, np.inf)))
def test_with_a_reach(seed, reach, detour):
    network = terrain_network(seed, cells=11)
    options = StrategyOptions(max_detour=detour, risk_slack=0.05)
    strategy = solve(network, GameOptions(ambush_radius=reach), options)
    if strategy.value > 0.0:
        check_entropy(strategy, 0.05)


def test_a_medium_game():
    check_entropy(solve(terrain_network(2, cells=36)), 0.01)


def test_the_papers_example():
    """Seven routes, three columns' rows binding at 1/3: by Clarabel 1.90 nats, e^1.90 = 6.7."""
    strategy = solve(paper_example(), options=StrategyOptions(max_detour=np.inf))
    most = maximize_entropy(strategy, 1 / 3, np.inf)
    assert strategy.route_entropy == pytest.approx(most, abs=0.01)
    assert (strategy.edge_probability > 0.0).all()


# The stages.


@examples(28)
@given(networks(), st.sampled_from((1.0, *DETOURS)), st.integers(1, 3),
       st.sampled_from((0.0, 0.01, 0.3)))
def test_value_within_the_slack_of_the_linear_programs(network, detour, count, slack):
    shortest, count = least_weight(network, network.lengths), min(count, len(network.points))
    strategy = solve(network, GameOptions(ambushers=count), StrategyOptions(
        max_detour=detour, risk_slack=slack))
    # Where a budget is as good as none for detours, the value is steep in it.
    loose = program_value(network, None, detour * shortest * (1 + 2e-6), count)
    tight = program_value(network, None, detour * shortest * (1 + 1e-12), count)
    assert strategy.value >= loose * (1 - 1e-6) - 1e-9
    assert strategy.value <= tight * (1 + slack + 2e-5) + 1e-9
    assert is_acyclic(network, strategy.edge_probability)


@pytest.mark.parametrize('reach', [0.0, 2.1])
@examples(2)
@given(st.integers(0, 10**6), st.sampled_from((1.05, 1.1, 1.2)), st.sampled_from((0.0, 0.01)))
def test_rooms_and_corridors_with_binding_budgets(reach, seed, detour, slack):
    """As in a depot: narrow places, and a budget that decides which of them can be reached."""
    network = ground_network(seed, 'depot')
    reach *= float(np.median(network.lengths))
    strategy = solve(network, GameOptions(ambush_radius=reach), StrategyOptions(
        max_detour=detour, risk_slack=slack))
    hits = geometric_hits(network, reach) if reach else None
    least = program_value(network, hits, strategy.length_budget)
    assert strategy.expected_length <= strategy.length_budget * (1 + 1e-6)
    assert strategy.lower_bound <= least * (1 + 1e-5)
    assert strategy.value <= least * (1 + slack + 2e-5)
    if not reach:
        assert strategy.value >= least * (1 - 2e-5)


def test_routes_that_avoid_all_sites_have_value_zero():
    points = [[0, 0], [1, 0], [1, 1], [1, -1], [2, 0]]
    network = quiet_network(points, [0, 5, 0, 0, 0], [(0, k) for k in (1, 2, 3)] + [
        (k, 4) for k in (1, 2, 3)], 0, 4)
    strategy = solve(network, options=StrategyOptions(max_detour=2.0))
    assert strategy.value == 0.0 and strategy.lower_bound == 0.0
    assert strategy.route_entropy == pytest.approx(math.log(2.0), abs=1e-9)
    assert strategy.ambush_probability.sum() == pytest.approx(1.0)
    # Too far round: the budget leaves nothing but the site.
    tight = solve(network, options=StrategyOptions(max_detour=1.0))
    assert tight.value == pytest.approx(5.0)


@pytest.fixture
def failing_program(monkeypatch):
    def fail(*_):
        raise SolverFailed('not today')

    monkeypatch.setattr(strategy_solver, 'least_risk', fail)


def test_the_certificate_of_the_soft_search_holds(failing_program):
    """A user gets this at the time limit: a strategy, a bound, and a true gap."""
    network = terrain_network(3, cells=14)
    game = make_game(network, GameOptions(ambush_radius=2.0))
    budgets = make_budgets(game, StrategyOptions())
    least = program_value(network, geometric_hits(network, 2.0), budgets[0].limit)
    stage = EntropyStage(game, budgets, 0.01, math.inf, None)
    solution = max_entropy_strategy(stage)
    found = certify(game, solution.p, solution.q, budgets, solution.prices)
    assert 0.0 < found.bound <= found.value
    assert found.bound <= least * (1 + 1e-6)
    assert entry_value(game, solution.p) <= least * 1.1


@pytest.mark.parametrize('reach', [0.0, 2.0])
def test_without_time_there_is_a_strategy_within_both_budgets(reach):
    """Also if the shortest route is over one of them."""
    network = terrain_network(3, cells=14)
    game = make_game(network, GameOptions(ambush_radius=reach))
    budgets = make_budgets(game, StrategyOptions(max_detour=1.5, max_exposure=1.02))
    assert not all(budget.keeps(shortest_route_strategy(game)) for budget in budgets)
    stage = EntropyStage(game, budgets, 0.01, -math.inf, None)
    solution = max_entropy_strategy(stage)
    found = certify(game, solution.p, solution.q, budgets, solution.prices)
    assert 0.0 < found.bound <= found.value


@pytest.mark.parametrize('seed', [1, 2, 3])
def test_a_program_that_is_cut_short_does_not_replace_a_better_first_strategy(seed, monkeypatch):
    network = terrain_network(seed, cells=20)
    game = make_game(network, GameOptions(ambush_radius=2.0))
    budgets = make_budgets(game, StrategyOptions(max_detour=1.05))
    monkeypatch.setattr(EntropyStage, 'in_a_hurry', True)
    monkeypatch.setattr(least_on_faces, 'STRIPS', (1.0,))
    monkeypatch.setattr(face_program, 'MAX_ROUNDS', 1)
    stage = EntropyStage(game, budgets, 0.01, math.inf, None)
    solution = max_entropy_strategy(stage)
    assert stage.level_lines is not None
    first = stage.laws[-1]
    assert worst_loss(game, solution.p) <= worst_loss(game, first.p)
    assert stage.hit_bound(solution.q, solution.prices) >= stage.hit_bound(first.q, first.prices)


@pytest.mark.parametrize('detour', [1.0, 1.0 + 1e-9])
def test_with_a_reach_a_budget_without_room_leaves_no_gap(detour):
    for seed in (0, 1, 2):
        found = solve(terrain_network(seed, cells=16), GameOptions(ambush_radius=1.5),
                      StrategyOptions(max_detour=detour))
        assert found.gap <= 1e-4 * found.value


@examples(6)
@given(st.integers(0, 10**6), st.sampled_from((0.01, 0.1)))
def test_soft_limits_are_exceeded_by_the_softness_and_the_others_kept(seed, softness):
    """The first order conditions of the soft search, with a hard limit of the length."""
    network = terrain_network(seed, cells=12)
    game = make_game(network, GameOptions(ambush_radius=2.0))
    budgets = make_budgets(game, StrategyOptions(max_detour=1.1))
    stage = EntropyStage(game, budgets, 0.01, math.inf, None)
    part = stage.acyclic_part(game, shortest_route_strategy(game))
    level = np.full(len(game.sites), entry_value(game, shortest_route_strategy(game)) / 2)
    limits = LimitRows(game, part, level, budgets)
    _, found = stage.gibbs_strategy(part, limits, limits.start(None), softness)
    used, v = limits.rows @ found.p, found.multipliers
    over = softness * v[: limits.sites].sum()
    assert used[: limits.sites].max() <= 1.0 + over + 0.02 * (1.0 + over)
    assert used[limits.sites :].max() <= 1.0 + 0.02


@pytest.mark.parametrize('reach', [0.0, 1.5])
def test_without_program_and_detour_the_soft_search_takes_the_shortest_route(
    failing_program, reach
):
    for seed in (0, 5):
        try:
            reached = solve(terrain_network(seed, cells=10), GameOptions(ambush_radius=reach),
                            StrategyOptions(max_detour=1.0))
        except TimeLimit as late:
            reached = late.strategy
        assert reached.expected_length == pytest.approx(reached.shortest_length, rel=1e-6)


def test_more_slack_buys_more_entropy():
    network = terrain_network(5, cells=14)
    entropies = [solve(network, options=StrategyOptions(risk_slack=slack)).route_entropy
                 for slack in (0.0, 0.003, 0.01, 0.03, 0.1, 0.3)]
    assert all(b > a for a, b in zip(entropies[:-1], entropies[1:], strict=True))


def test_an_exposure_budget_lowers_exposure_and_entropy():
    network = terrain_network(6, cells=14)
    free, dark = (
        solve(network, options=StrategyOptions(max_detour=1.5, max_exposure=e, risk_slack=0.05))
        for e in (np.inf, 1.1)
    )
    assert dark.expected_exposure <= 1.1 * dark.least_exposure * (1 + 1e-6)
    assert free.expected_exposure > dark.expected_exposure
    assert dark.route_entropy < free.route_entropy


def test_an_excessively_costly_site_is_avoided():
    network = terrain_network(2, cells=12)
    alpha = network.alpha.copy()
    alpha[len(alpha) // 2] = 1e9
    barred = quiet_network(network.points, alpha, network.edges, network.source, network.target)
    strategy = solve(barred)
    assert strategy.visit_probability[len(alpha) // 2] == 0.0
