# SPDX-License-Identifier: Apache-2.0
"""Mixtures of given paths against their meaning: distances from every place, and small games."""

import time
from dataclasses import replace

import numpy as np
import pytest
from drive_samples import distance_to
from games import examples, least_value, plain_options
from hypothesis import given
from hypothesis import strategies as st

from ambush_planner import GameOptions, PlanningOptions, RiskMap, TimeLimit, plan_trip
from ambush_planner.errors import BudgetInfeasible
from ambush_planner.operations.path_mixtures import MAX_GAP, PathMixtures

START, GOAL = (3.0, 10.0), (37.0, 10.0)
OPTIONS = PlanningOptions(network=plain_options(spacing=2.0), game=GameOptions(ambush_radius=2.0))


def ground(seed=0, walls=True):
    rng = np.random.default_rng(seed)
    alpha, obstacles = rng.uniform(1.0, 5.0, (20, 40)), np.zeros((20, 40), dtype=bool)
    obstacles[6:14, 18:22] = walls
    return RiskMap(alpha, obstacles, 1.0, (0.0, 0.0, 0.0))


def mixtures_of(risk_map, plan, paths):
    """Mixtures of paths of a plan without stops."""
    return PathMixtures(risk_map, plan, paths, np.zeros(len(paths), np.int64))


@given(st.integers(0, 10**6))
@examples(2)
def test_value_is_the_loss_at_the_worst_place_on_the_map(seed):
    rng, risk_map = np.random.default_rng(seed), ground(seed)
    plan = plan_trip(risk_map, START, GOAL, OPTIONS)
    paths, shares = plan.paths(5, rng), rng.dirichlet(np.ones(5))
    found = mixtures_of(risk_map, plan, paths).judge(shares)
    # Dense places outside the secured area; nobody is hit whose whole path near them is in it.
    game = plan.strategy.game.options
    cells = rng.uniform(0.0, 1.0, (3000, 2)) * (40.0, 20.0)
    away = np.min([np.hypot(*(cells - end).T) for end in (START, GOAL)], axis=0)
    cells = cells[away > game.secured_distance]
    loss = np.where(risk_map.obstacles, 0.0, risk_map.alpha)[tuple(cells[:, ::-1].astype(int).T)]
    far = [p[np.min([np.hypot(*(p[:, :2] - end).T) for end in (START, GOAL)], axis=0)
             > game.secured_distance] for p in paths]
    hit = [distance_to(cells, path[:, :2]) <= game.ambush_radius for path in far]
    assert (loss * (shares @ hit)).max() <= found.value * (1.0 + 1e-9)
    at = found.worst_xy[None]
    reach = game.ambush_radius + game.widened + 1e-9
    near = [distance_to(at, path[:, :2]) <= reach for path in paths]
    loss = risk_map.alpha[int(at[0, 1]), int(at[0, 0])]
    assert found.value <= loss * (shares @ near).max() * (1.0 + 1e-9)


def test_best_shares_are_those_of_a_linear_program_on_all_sites():
    risk_map, rng = ground(), np.random.default_rng(1)
    plan = plan_trip(risk_map, START, GOAL, OPTIONS)
    mixtures = mixtures_of(risk_map, plan, plan.paths(60, rng))
    best = mixtures.best(np.zeros(60))
    assert best.shares.sum() == pytest.approx(1.0)
    for _ in range(5):
        assert best.value <= mixtures.judge(rng.dirichlet(np.ones(60))).value * 1.001
    least = least_value(mixtures.losses.toarray())
    assert least * (1.0 - 1e-6) <= best.value <= least * (1.0 + MAX_GAP) * (1.0 + 1e-6)


def test_two_ways_round_a_wall_are_driven_alike():
    alpha, obstacles = np.ones((20, 40)), np.zeros((20, 40), dtype=bool)
    obstacles[6:14, 8:32] = True
    risk_map = RiskMap(alpha, obstacles, 1.0, (0.0, 0.0, 0.0))
    secured = GameOptions(ambush_radius=2.0, secured_radius=4.0)  # where the ways part
    plan = plan_trip(risk_map, START, GOAL, replace(OPTIONS, game=secured))
    paths = [np.array([START, (8.0, y), (32.0, y), GOAL]) for y in (4.0, 16.0, 3.5)]
    best = mixtures_of(risk_map, plan, paths).best(np.zeros(3))
    assert best.value == pytest.approx(0.5, rel=1e-3)
    assert best.shares[1] == pytest.approx(0.5, abs=1e-3)


def test_a_length_budget_limits_the_shares():
    risk_map = ground(walls=False)
    plan = plan_trip(risk_map, START, GOAL, OPTIONS)
    paths = plan.paths(30, np.random.default_rng(2))
    costs = np.array([np.hypot(*np.diff(path[:, :2], axis=0).T).sum() for path in paths])
    mixtures, budget = mixtures_of(risk_map, plan, paths), float(costs.min()) * 1.02
    best = mixtures.best(costs / budget)
    assert best.shares @ costs <= budget * (1.0 + 1e-6)
    assert best.value >= mixtures.best(costs / np.inf).value * 0.999
    with pytest.raises(BudgetInfeasible, match='max_detour'):
        mixtures.best(costs)
    with pytest.raises(TimeLimit):
        mixtures.best(costs / budget, time.monotonic())
