"""A plan's value against ambushers at every cell, by geometry that shares no code with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from games import ground, hit_once, may_wait, meets
from scipy.optimize import linprog

from ambush_planner import (
    GameOptions,
    NetworkOptions,
    PlanningOptions,
    RiskMap,
    StrategyOptions,
)
from ambush_planner.game.certificate.certificate import certify
from ambush_planner.game.route_sampler import route_edges
from ambush_planner.game.strategy import make_budgets
from ambush_planner.maps.occupancy import (
    OccupancyMap,
    OccupancyOptions,
    risk_map_from_occupancy,
)
from ambush_planner.planning.cell_losses import CellLosses, CellSearch, LatestLosses
from ambush_planner.planning.changed_ground import ChangedGround
from ambush_planner.planning.options import DriveOptions
from ambush_planner.planning.trip import plan_trip

SPACING = 1.3
OPTIONS = PlanningOptions(NetworkOptions(spacing=SPACING), drive=DriveOptions(tube=0.0))


def losses_at_cells(risk_map, strategy, held):
    """Mean loss (K,) of an ambush at each free cell outside held ground, each route hit once."""
    network, reach = strategy.network, strategy.game.reach
    rows, columns = np.nonzero(~risk_map.obstacles)
    centres = risk_map.to_world(np.stack((columns, rows), axis=1) + 0.5)
    apart = np.linalg.norm(centres[:, None] - network.points[network.ends], axis=2)
    outside = (apart > held).all(axis=1)
    hits = meets(network, centres[outside], reach, held)
    alpha = risk_map.alpha[rows, columns][outside]
    return alpha * hit_once(network, strategy.edge_probability, hits)


def least_of_sampled_routes(strategy, held, detour):
    """Least value of mixtures of drawn routes within the budget, an upper bound of the optimum."""
    network = strategy.network
    near = meets(network, network.points, strategy.game.reach, held)
    near &= may_wait(network, held)[:, None]
    drawn = strategy.sample_routes(150, np.random.default_rng(1))
    routes = [route_edges(network, route) for route in drawn]
    hit = network.alpha[:, None] * np.array([near[:, each].any(axis=1) for each in routes]).T
    length = np.array([network.lengths[each].sum() for each in routes])
    rows = np.vstack((np.c_[hit, -np.ones(len(hit))], np.r_[length, 0.0]))
    most = np.r_[np.zeros(len(hit)), min(max(detour * strategy.shortest_length, length.min()), 1e9)]
    found = linprog(np.r_[0.0 * length, 1.0], rows, most, np.r_[0.0 * length + 1.0, 0.0][None],
                    [1.0], method='highs-ds')
    return float(found.fun)


@pytest.mark.parametrize('spacings, detour', [(1.0, 1.15), (2.5, np.inf), (6.0, 1.15)])
@pytest.mark.parametrize('kind', ['hills', 'city', 'maze', 'depot'])
def test_no_cell_costs_more_than_the_value_and_no_mixture_less_than_the_bound(
    kind, spacings, detour
):
    risk_map, start, goal = ground(11, kind, 26)
    game = GameOptions(spacings * SPACING, secured_radius=[-1.0, 2.0][kind in ('city', 'hills')])
    options = replace(OPTIONS, game=game, strategy=StrategyOptions(max_detour=detour))
    strategy = plan_trip(risk_map, start, goal, options).strategy
    losses = losses_at_cells(risk_map, strategy, game.held_radius)
    assert losses.max(initial=0.0) <= strategy.value * (1.0 + 1e-9)
    least = least_of_sampled_routes(strategy, game.held_radius, detour)
    assert strategy.lower_bound <= least * (1.0 + 1e-6)
    assert strategy.lower_bound <= strategy.value


@pytest.mark.parametrize('in_obstacles', [False, True])
def test_the_search_finds_the_worst_cell(in_obstacles):
    rng = np.random.default_rng(3)
    risk_map, start, goal = ground(5, 'city', 30)
    rough = RiskMap(1.0 + 9.0 * rng.random(risk_map.alpha.shape), risk_map.obstacles, 1.0)
    options = replace(OPTIONS, game=GameOptions(2.0, 3.0, ambush_in_obstacles=in_obstacles))
    strategy = plan_trip(rough, start, goal, options).strategy
    open_ground = RiskMap(rough.nearest_free_alpha(), np.zeros_like(rough.obstacles), 1.0)
    losses = losses_at_cells(open_ground if in_obstacles else rough, strategy, 3.0)
    p = strategy.edge_probability
    search = CellSearch(CellLosses(rough, in_obstacles), strategy.game)
    found = search.worst(p, 0.0)
    assert found.mean_loss[0] == pytest.approx(losses.max(), rel=1e-9)
    assert (np.diff(found.mean_loss) <= 0.0).all()


def test_on_a_changed_map_no_cell_costs_more_than_the_value():
    rng, occupancy = np.random.default_rng(2), OccupancyOptions()
    values = rng.integers(0, 60, (20, 26), dtype=np.int8)
    values[7:14, 12:14] = 100
    planned_on, game = OccupancyMap(values, 1.0), GameOptions(2.0)
    plan = plan_trip(risk_map_from_occupancy(values, 1.0), (3.5, 10.5), (22.5, 10.5),
                     replace(OPTIONS, game=game))
    ground, strategy = ChangedGround(plan, planned_on, occupancy), plan.strategy
    raised = 0
    for row, column in rng.integers(2, 18, (12, 2)) + (0, 4):
        now = values.copy()
        now[row - 1:row + 2, column - 1:column + 2] = 99
        risk_map = risk_map_from_occupancy(now, 1.0)
        worst = losses_at_cells(risk_map, strategy, strategy.game.options.held_radius).max()
        value = ground.assess(OccupancyMap(now, 1.0)).value
        assert worst <= value * (1.0 + 1e-9)
        assert value == strategy.value or value == pytest.approx(worst, rel=1e-6)
        raised += value > strategy.value
    assert 0 < raised < 12


def test_on_a_changed_map_ambushers_in_obstacles_cost_what_the_nearest_free_cell_does():
    """Also those in obstacles that were there before, have appeared or have gone."""
    rng, occupancy = np.random.default_rng(4), OccupancyOptions()
    values = rng.integers(0, 60, (20, 26), dtype=np.int8)
    values[rng.random(values.shape) < 0.06] = 100
    values[8:13, [1, 2, 3, 4, -5, -4, -3, -2]] = 0
    game = GameOptions(2.0, ambush_in_obstacles=True)
    plan = plan_trip(risk_map_from_occupancy(values, 1.0), (3.5, 10.5), (22.5, 10.5),
                     replace(OPTIONS, game=game))
    ground = ChangedGround(plan, OccupancyMap(values, 1.0), occupancy)
    strategy, compared = plan.strategy, 0
    for _ in range(60):
        now = values.copy()
        where = rng.integers(0, 20, 2), rng.integers(6, 20, 2)
        now[where] = rng.choice([100, 99, 30], 2)
        assessment = ground.assess(OccupancyMap(now, 1.0))
        if assessment.clear_share < 1.0:
            continue
        risk_map = risk_map_from_occupancy(now, 1.0)
        hidden = RiskMap(risk_map.nearest_free_alpha(), np.zeros(now.shape, bool), 1.0)
        worst = losses_at_cells(hidden, strategy, strategy.game.options.held_radius).max()
        assert assessment.lower_bound <= worst * (1.0 + 1e-9)
        assert worst <= assessment.value * (1.0 + 1e-9)
        # A node may be at a worse place than the centre of its cell.
        assert assessment.value == strategy.value or assessment.value < 1.02 * worst
        compared += 1
    assert compared > 10


@pytest.mark.parametrize('changes', [0, 1, 30, 400])
def test_losses_follow_the_changes_of_a_map(changes):
    rng, options, latest = np.random.default_rng(changes), OccupancyOptions(), LatestLosses()
    values = rng.integers(-1, 101, (37, 51), dtype=np.int8)
    for _ in range(4):
        values = values.copy()
        values.ravel()[rng.integers(0, values.size, changes)] = rng.integers(-1, 101, changes)
        grid = OccupancyMap(values, 0.5)
        losses = latest.on(grid, options, False)
        fresh = CellLosses(risk_map_from_occupancy(values, 0.5, options=options), False)
        for side in (1, 4, 16):
            np.testing.assert_array_equal(losses.of_blocks(side), fresh.of_blocks(side))
    places = rng.uniform(-1.0, 30.0, (500, 2))
    np.testing.assert_array_equal(losses.at(places), fresh.at(places))
    for other, read in ((replace(grid, resolution=1.0), options),
                        (grid, OccupancyOptions(alpha_max=5.0))):
        risk_map = risk_map_from_occupancy(values, other.resolution, options=read)
        np.testing.assert_array_equal(latest.on(other, read, False).at(places),
                                      CellLosses(risk_map, False).at(places))


@pytest.mark.parametrize('door', [8, 10, 12, 14])
def test_a_door_between_nodes_is_held_by_a_cell(door):
    """A door that one cell covers, but no node: only an ambusher who joins proves the value.
    """
    obstacles = np.zeros((60, 80), bool)
    obstacles[:, 38:42] = True
    obstacles[30 - door // 2 : 30 + door // 2, 38:42] = False
    risk_map = RiskMap(np.ones(obstacles.shape), obstacles, 0.25)
    options = replace(OPTIONS, game=GameOptions(ambush_radius=1.1, secured_radius=3.0),
                      strategy=StrategyOptions(max_detour=1.5))
    strategy = plan_trip(risk_map, (2.0, 7.5), (18.0, 7.5), options).strategy
    certified = certify(strategy.game, strategy.edge_probability, strategy.ambusher,
                        make_budgets(strategy.game, options.strategy))
    assert strategy.value == certified.value == pytest.approx(1.0)
    assert strategy.lower_bound == certified.bound == pytest.approx(1.0)
    assert strategy.gap == strategy.value - strategy.lower_bound
