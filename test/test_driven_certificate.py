# SPDX-License-Identifier: Apache-2.0
"""The value bounds the mean loss of driven paths, measured by geometry alone."""

import numpy as np
import pytest
from drive_samples import dense
from games import HUNT, plain_options
from scipy.spatial import cKDTree

from ambush_planner import GameOptions, RiskMap, StrategyOptions
from ambush_planner.planning.options import DriveOptions, PlanningOptions
from ambush_planner.planning.plan import departure_paths
from ambush_planner.planning.trip import plan_trip

SIDE, SPACING, REACH, SECURED = 100.0, 6.0, 6.0, 12.0
DRAWS, PLACES = 400 * HUNT, 1000
# Without a reach, a path that comes as near to a node as this passes it [spacings].
PASSES = 0.01


def hills():
    """Risk that rises and falls, and two blocks in the way."""
    v, u = np.mgrid[0:50, 0:50] / 50
    alpha = 2.0 + np.sin(7 * u + 3 * v) + np.cos(5 * v - 2 * u)
    obstacles = ((np.abs(u - 0.4) < 0.08) & (np.abs(v - 0.6) < 0.15)) | (
        (np.abs(u - 0.7) < 0.1) & (np.abs(v - 0.3) < 0.1))
    return alpha, obstacles


def strewn():
    """Even ground with rocks on it."""
    rng = np.random.default_rng(4)
    obstacles = rng.random((50, 50)) < 0.03
    obstacles[23:27, :4] = obstacles[23:27, -4:] = False
    return np.ones((50, 50)), obstacles


def gates():
    """A wall with three gates, the middle one cheap to watch."""
    alpha, obstacles = np.full((50, 50), 2.0), np.zeros((50, 50), bool)
    obstacles[:, 24:26] = True
    for low, loss in ((5, 3.0), (22, 1.0), (38, 2.0)):
        obstacles[low : low + 8, 24:26] = False
        alpha[low : low + 8, 20:30] = loss
    return alpha, obstacles


def planned(ground, reach, tube, tracking_error=0.0, spacing=SPACING, secured=SECURED):
    alpha, obstacles = ground()
    return plan_trip(
        RiskMap(alpha, obstacles, SIDE / 50), (3.0, 50.0), (97.0, 50.0),
        PlanningOptions(
            network=plain_options(spacing=spacing),
            game=GameOptions(ambush_radius=reach, secured_radius=secured),
            strategy=StrategyOptions(max_detour=1.3),
            drive=DriveOptions(tube=tube, tracking_error=tracking_error),
        ),
    )


def losses(a_plan, lines, reach, places=None, radius=SECURED):
    """Mean loss by an ambush at each place (P, 2), by default the nodes, and its standard error.

    Points along lines (L, 2), half a metre apart at most, against discs.
    """
    risk_map, network = a_plan.risk_map, a_plan.network
    loss = network.alpha if places is None else risk_map.alpha[risk_map.cells(places)]
    places = network.points if places is None else places
    ends = network.points[[network.source, network.target]]

    def secured(points):
        return np.linalg.norm(points[:, None] - ends, axis=2).min(axis=1) <= radius

    hits = np.zeros(len(places))
    for line in lines:
        near, _ = cKDTree(line[~secured(line)]).query(places, distance_upper_bound=reach + 1.0)
        hits += near <= reach
    share = hits / len(lines)
    loss = np.where(secured(places), 0.0, loss)
    return loss * share, loss * np.sqrt(share * (1 - share) / len(lines))


def anywhere(risk_map, rng):
    """Places (P, 2) on free ground."""
    free = np.argwhere(~risk_map.obstacles)
    cells = free[rng.integers(len(free), size=PLACES)]
    return risk_map.resolution * (cells[:, ::-1] + rng.random((PLACES, 2)))


@pytest.mark.parametrize(('ground', 'tube', 'tracking_error'), [
    (strewn, 1.0, 0.0), (hills, None, 2.0)])
def test_with_a_reach_no_ambush_costs_more_than_the_value(ground, tube, tracking_error):
    a_plan = planned(ground, REACH, tube, tracking_error)
    paths = departure_paths(a_plan, DRAWS, 0.5, np.random.default_rng(1))
    # The robot strays from its path, to one side and then to the other.
    waves = tracking_error * np.sin(np.arange(2000) / 8)
    mean, error = losses(a_plan, [
        path[:, :2] + waves[:len(path), None] * np.column_stack(
            (-np.sin(path[:, 2]), np.cos(path[:, 2]))) for path in paths], REACH)
    assert (mean - 4 * error).max() <= a_plan.strategy.value
    # And the value is not far above: the test could fail.
    assert mean.max() > 0.5 * a_plan.strategy.value


@pytest.mark.parametrize('ground', [hills, gates])
def test_by_default_no_ambush_costs_more_than_the_value_wherever_it_waits(ground):
    a_plan, rng = planned(ground, REACH, None, spacing=None, secured=None), np.random.default_rng(1)
    paths = departure_paths(a_plan, DRAWS, 0.1 * REACH, rng)
    mean, error = losses(a_plan, [dense(path[:, :2], 0.02 * REACH) for path in paths], REACH,
                         anywhere(a_plan.risk_map, rng), radius=1.1 * REACH)
    assert (mean - 4 * error).max() <= a_plan.value
    assert mean.max() > 0.8 * a_plan.value


def test_without_a_reach_no_ambush_costs_more_than_the_value():
    a_plan, near = planned(gates, 0.0, None), PASSES * SPACING
    paths = departure_paths(a_plan, DRAWS, 0.5, np.random.default_rng(1))
    mean, error = losses(a_plan, [dense(path[:, :2], near / 2) for path in paths], near)
    assert (mean - 4 * error).max() <= a_plan.strategy.value
    # The routes as they are drawn come as close to the value as sampling allows.
    rng = np.random.default_rng(1)
    routes = [a_plan.network.points[a_plan.strategy.sample_route(rng)] for _ in range(DRAWS)]
    mean, error = losses(a_plan, routes, near)
    assert (mean - 4 * error).max() <= a_plan.strategy.value
    assert (mean + 4 * error).max() >= 0.95 * a_plan.strategy.value
