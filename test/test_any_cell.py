"""The search for the worst cells, and certificates from different rounds of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from games import ground, hit_once, meets, standing_places, terrain_network

from ambush_planner import (
    GameOptions,
    NetworkOptions,
    PlanningOptions,
    RiskMap,
    StrategyOptions,
    solve,
)
from ambush_planner.game.certificate import certify
from ambush_planner.game.strategy import make_budgets
from ambush_planner.maps.occupancy import (
    OccupancyMap,
    OccupancyOptions,
    risk_map_from_occupancy,
)
from ambush_planner.planning.cell_losses import CellLosses, LatestLosses
from ambush_planner.planning.options import DriveOptions
from ambush_planner.planning.solving import _proved_by
from ambush_planner.planning.trip import plan_trip

SPACING = 1.3
OPTIONS = PlanningOptions(NetworkOptions(spacing=SPACING), drive=DriveOptions(tube=0.0))


def losses_at_cells(risk_map, strategy, held):
    """Mean loss (K,) of an ambush at each free cell outside held ground, each route hit once."""
    network, places = strategy.network, standing_places(risk_map, strategy.network, held)
    hits = meets(network, places[0], strategy.game.reach, held)
    return places[1] * hit_once(network, strategy.edge_probability, hits)


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
    found = CellLosses(rough, in_obstacles).worst(strategy.game, p, 0.0, 2.0)
    assert found.mean_loss[0] == pytest.approx(losses.max(), rel=1e-9)
    assert (np.diff(found.mean_loss) <= 0.0).all()


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
            np.testing.assert_array_equal(losses._loss_of_blocks(side), fresh._loss_of_blocks(side))
    places = rng.uniform(-1.0, 30.0, (500, 2))
    np.testing.assert_array_equal(losses.at(places), fresh.at(places))
    for other, read in ((replace(grid, resolution=1.0), options),
                        (grid, OccupancyOptions(alpha_max=5.0))):
        risk_map = risk_map_from_occupancy(values, other.resolution, options=read)
        np.testing.assert_array_equal(latest.on(other, read, False).at(places),
                                      CellLosses(risk_map, False).at(places))


def test_a_bound_from_another_round_allows_for_how_far_rounding_puts_the_strategy_over_its_budget():
    network, game = terrain_network(3, cells=14), GameOptions(2.0)
    short, long = (solve(network, game, StrategyOptions(max_detour=detour))
                   for detour in (1.05, np.inf))
    budget, p = short.length_budget, short.edge_probability
    over = budget * (1.0 + 4e-7) - short.expected_length
    p = p + over / (long.expected_length - short.expected_length) * (long.edge_probability - p)
    options = replace(OPTIONS, game=game, strategy=StrategyOptions(max_detour=1.05))
    proved = _proved_by(replace(short, edge_probability=p), short, options)
    certified = certify(proved.game, p, proved.ambush_probability,
                        make_budgets(proved.game, options.strategy),
                        (proved.length_price, proved.exposure_price))
    assert (proved.value, proved.lower_bound) == (certified.value, certified.bound)
    assert 0.0 < proved.lower_bound < short.lower_bound
