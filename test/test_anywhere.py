# SPDX-License-Identifier: Apache-2.0
"""Published values, against ambushers anywhere in free ground and against all other routes.

Geometry, hits and LPs share no code with the package (games.py).
"""

import math
from functools import cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pytest
from games import (
    ground,
    hit_once,
    is_acyclic,
    meets,
    plain_options,
    random_map,
    routes_of,
    standing_places,
    unbalanced,
    value_by_routes,
)

from ambush_planner import (
    GameOptions,
    NetworkOptions,
    PlanningOptions,
    RiskMap,
    StrategyOptions,
    build_network,
    plan_trip,
    solve,
)
from ambush_planner.game.distribution.chain import chain_of
from ambush_planner.game.distribution.route_distribution import RouteDistribution
from ambush_planner.game.game import make_games
from ambush_planner.game.route_sampler import shortest_route_strategy
from ambush_planner.maps.occupancy import OccupancyMap, OccupancyOptions, risk_from_occupancy
from ambush_planner.planning import cell_losses
from ambush_planner.planning.cell_losses import CellLosses, CellSearch
from ambush_planner.planning.changed_ground import ChangedGround
from ambush_planner.planning.options import DriveOptions

SPACING = 1.3
# A lattice of places in each cell, from just inside its corner, and how far any place is from it.
DENSE = (0.001, 0.25, 0.5, 0.75, 0.999)
COVER = 0.18
# Relative rounding of values.
EQUAL = 1e-9
CASES = [('hills', 2.5, -1.0, np.inf, 0.4), ('city', 1.0, 2.0, 1.15, 0.0),
         ('maze', 2.5, -1.0, 1.5, 0.3), ('random', 2.0, 0.0, np.inf, 0.3)]
SMALL = [(0, 0.6, -1.0, 1.0), (0, 1.0, 0.0, 1.15), (3, 1.3, 1.0, 1.15), (3, 0.6, -1.0, np.inf),
         (4, 1.0, 0.0, np.inf), (4, 1.3, 1.0, 1.0)]


class Case(NamedTuple):
    """A plan, and what the ambusher of its game can do [m]."""

    risk_map: RiskMap
    plan: object
    reach: float
    secured: float
    tube: float

    def losses(self):
        """Mean loss (K,) of an ambush at each place of the lattice, each route hit once."""
        return self.losses_on(self.plan.strategy.edge_probability)

    def losses_on(self, p):
        """The same for another strategy (M,) on the plan's network."""
        network = self.plan.network
        places, alpha = standing_places(self.risk_map, network, self.secured, DENSE)
        hits = meets(network, places, self.reach + self.tube, self.secured - self.tube)
        return alpha * hit_once(network, p, hits)

    def least(self, routes, detour, cover=0.0):
        """Least value of mixtures of ``routes`` (edge indices) against the places of the lattice.

        With ``cover``, against no fewer than all places that are at most so far from the lattice.
        """
        network, strategy = self.plan.network, self.plan.strategy
        places, alpha = standing_places(self.risk_map, network, self.secured - cover, DENSE)
        near = meets(network, places, self.reach + self.tube + cover, self.secured - self.tube)
        # Of places that hit the same edges, the one of the largest loss counts.
        order = np.argsort(-alpha)
        first = np.unique(np.packbits(near[order], axis=1), axis=0, return_index=True)[1]
        alpha, near = alpha[order][first], near[order][first]
        shortest = min(network.lengths[route].sum() for route in routes)
        limit = max(detour * strategy.shortest_length, shortest)
        return value_by_routes(alpha, near, routes, [(network.lengths, limit)])


def solved(risk_map, start, goal, reach, secured, detour, tube):
    options = PlanningOptions(network=plain_options(spacing=SPACING),
                              game=GameOptions(ambush_radius=reach, secured_radius=secured),
                              strategy=StrategyOptions(max_detour=detour),
                              drive=DriveOptions(tube=tube))
    radius = reach + tube if secured == -1.0 else secured
    return Case(risk_map, plan_trip(risk_map, start, goal, options), reach, radius, tube)


@cache
def solved_case(kind, reach, secured, detour, tube):
    if kind == 'random':
        risk_map = random_map(5, 14, obstacles=0.06)
        free = np.argwhere(~risk_map.obstacles)[:, ::-1]
        ends = risk_map.to_world(free[np.argsort(free[:, 0], kind='stable')][[0, -1]] + 0.5)
        return solved(risk_map, *map(tuple, ends), reach, secured, detour, tube)
    return solved(*ground(11, kind, 22), reach * SPACING, secured, detour, tube)


@pytest.mark.parametrize('case', CASES, ids=str)
def test_the_strategy_keeps_its_budget_and_nowhere_costs_more_than_its_value(case):
    solution = solved_case(*case)
    strategy = solution.plan.strategy
    network, p = strategy.network, strategy.edge_probability
    assert p.min() >= 0.0
    assert unbalanced(network, p) < 1e-9
    assert is_acyclic(network, p)
    assert strategy.expected_length <= case[3] * strategy.shortest_length * (1.0 + 1e-6)
    # No place costs more than the value: neither the cells' centres nor any place between.
    assert strategy.lower_bound <= strategy.value
    assert solution.losses().max(initial=0.0) <= strategy.value * (1.0 + EQUAL)


@pytest.mark.parametrize('case', CASES, ids=str)
def test_no_mixture_of_drawn_routes_costs_less_than_the_bound(case):
    solution = solved_case(*case)
    strategy = solution.plan.strategy
    number = {tuple(edge): k for k, edge in enumerate(strategy.network.edges.tolist())}
    drawn = [[number[step] for step in pairwise(route.tolist())]
             for route in strategy.sample_routes(80, np.random.default_rng(1))]
    least = solution.least(drawn, case[3], COVER)
    assert strategy.lower_bound <= least * (1.0 + 1e-6)


@pytest.mark.filterwarnings('ignore:the gap is')
def test_if_no_distribution_is_found_what_the_lp_draws_is_the_strategy(monkeypatch):
    kept = solved_case('hills', 2.5, -1.0, 1.2, 0.3)
    monkeypatch.setattr(RouteDistribution, 'round', lambda *_: False)
    solution = solved(*ground(11, 'hills', 22), 2.5 * SPACING, -1.0, 1.2, 0.3)
    strategy = solution.plan.strategy
    assert strategy.expected_length <= 1.2 * strategy.shortest_length * (1.0 + 1e-6)
    assert solution.losses().max() <= strategy.value * (1.0 + EQUAL)
    best = kept.plan.strategy
    shortest = kept.losses_on(shortest_route_strategy(best.game)).max()
    assert best.lower_bound <= strategy.value < shortest


@pytest.mark.parametrize('share', [0.3, 0.9])
def test_blocks_searched_best_first_leave_out_no_place(share, monkeypatch):
    monkeypatch.setattr(cell_losses, '_AT_ONCE', 5)
    rng = np.random.default_rng(4)
    obstacles = np.kron(rng.random((15, 15)) < 0.1, np.ones((4, 4))) > 0
    obstacles[:8, :8] = obstacles[-8:, -8:] = False
    risk_map = RiskMap(rng.integers(1, 4, obstacles.shape), obstacles, 1.0)  # with many ties
    network = build_network(risk_map, (3.0, 3.0), (57.0, 57.0), NetworkOptions(spacing=5.0))
    (game,) = make_games((network,), GameOptions(ambush_radius=20.0, secured_radius=8.0,
                                                 widened=math.sqrt(0.5)))
    law, cells = chain_of(network, solve(network).edge_probability), CellLosses(risk_map, False)
    search = CellSearch(cells, [game], law.uses(len(network.edges)) > 0.0)
    all_cells = cells.dear_blocks(16)
    for side in (16, 4):
        all_cells = cells.divided(all_cells, side)
    every = search._of_parts(all_cells, law, 0.0, 0.0)
    above, apart = share * every.losses[0], 6.0
    found = search.worst(law, above, apart)
    assert 1 < len(found.points) < 100 and found.mean_loss.min() > above
    assert found.mean_loss[0] == pytest.approx(every.losses[0], rel=EQUAL)
    assert (np.diff(found.mean_loss) <= EQUAL).all()
    between = np.linalg.norm(found.points[:, None] - found.points, axis=2)
    assert (between + 2.0 * apart * np.eye(len(between)) > apart).all()
    # Each place that costs more than asked is one of them, or near one that costs as much: those of
    # all cells but for ties, which rounding decides.
    dear = every.some(every.losses > above * (1.0 + EQUAL))
    near = np.linalg.norm(dear.points[:, None] - found.points, axis=2) <= apart
    assert (near & (found.mean_loss >= dear.losses[:, None] * (1.0 - EQUAL))).any(axis=1).all()


@pytest.mark.parametrize('case', SMALL, ids=str)
def test_the_least_value_over_all_routes_is_between_bound_and_value(case):
    """On networks so small that all routes can be listed."""
    seed, reach, secured, detour = case
    risk_map = random_map(seed, 5, obstacles=0.08)
    corners = risk_map.to_world([(0.5, 0.5), (4.5, 4.5)])
    solution = solved(risk_map, *map(tuple, corners), reach, secured, detour, 0.0)
    strategy, routes = solution.plan.strategy, routes_of(solution.plan.network)
    assert solution.least(routes, detour) <= strategy.value * (1.0 + 1e-6)
    assert strategy.lower_bound <= solution.least(routes, detour, COVER) * (1.0 + 1e-6)


@pytest.mark.parametrize('door', [8, 14])
def test_a_door_that_one_place_covers_is_proved(door):
    """No node covers it."""
    obstacles = np.zeros((60, 80), bool)
    obstacles[:, 38:42] = True
    obstacles[30 - door // 2 : 30 + door // 2, 38:42] = False
    risk_map = RiskMap(np.ones(obstacles.shape), obstacles, 0.25)
    strategy = solved(risk_map, (2.0, 7.5), (18.0, 7.5), 1.1, 3.0, 1.5, 0.0).plan.strategy
    assert strategy.value == pytest.approx(1.0)
    assert strategy.lower_bound == pytest.approx(1.0)


@pytest.mark.parametrize('hides', [False, True])
def test_on_a_changed_map_no_place_costs_more_than_the_value(hides):
    """Ambushers in obstacles cost what the nearest free cell does: also in those of before, in new
    ones, and in those that have gone.
    """
    rng, occupancy = np.random.default_rng(4), OccupancyOptions()
    values = rng.integers(0, 60, (14, 20), dtype=np.int8)
    values[rng.random(values.shape) < 0.06] = 100
    values[5:10, [1, 2, 3, 4, -5, -4, -3, -2]] = 0
    game = GameOptions(ambush_radius=2.0, ambush_in_obstacles=hides)
    options = PlanningOptions(network=plain_options(spacing=SPACING), game=game,
                              drive=DriveOptions(tube=0.0))
    plan = plan_trip(risk_from_occupancy(values, 1.0), (3.5, 7.5), (16.5, 7.5), options)
    changed, raised = ChangedGround(plan, OccupancyMap(values, 1.0), occupancy), 0
    for where in (None, *rng.integers((0, 6), (14, 14), (3, 2, 2)).transpose(0, 2, 1)):
        now = values.copy()
        if where is not None:
            now[tuple(where)] = rng.choice([99, 99, 100], 2) if hides else 99
        risk_map = risk_from_occupancy(now, 1.0)
        if hides:
            risk_map = RiskMap(risk_map.nearest_free_alpha(), np.zeros(now.shape, bool), 1.0)
        worst, widened = (Case(risk_map, plan, reach, 2.0, 0.0).losses().max()
                          for reach in (2.0, plan.strategy.game.reach))
        assessment = changed.assess(OccupancyMap(now, 1.0))
        if assessment.clear_share == 1.0:
            assert worst <= assessment.value * (1.0 + EQUAL)
            # The lattice does not have the very worst place.
            assert assessment.value <= max(plan.strategy.value, 1.1 * widened)
            raised += assessment.value > plan.strategy.value
    assert raised > 0
