# SPDX-License-Identifier: Apache-2.0
"""Bounds of circulations, against the best response and against all routes."""

import math
from dataclasses import replace

import numpy as np
import pytest
from games import (
    examples,
    neighbours,
    planar_network,
    reached,
    routes_of,
    terrain_network,
    value_by_routes,
)
from hypothesis import assume, given
from hypothesis import strategies as st

from ambush_planner import GameOptions, Network, SolverFailed
from ambush_planner.game.ambusher import Ambusher
from ambush_planner.game.budget import length_budget
from ambush_planner.game.certificate import curves as curves_module
from ambush_planner.game.certificate.best_response import SEARCHES, Subnetwork
from ambush_planner.game.certificate.certificate import lower_bounds
from ambush_planner.game.certificate.curves import _Crossings, curve_bound
from ambush_planner.game.faces import Circulation, make_faces
from ambush_planner.game.game import make_game
from ambush_planner.game.legs import Legs
from ambush_planner.game.value.potential import Potential


def proof(game, detour):
    """The ambusher whom the LP in potentials finds, the budget, and the LP's bound."""
    budget = length_budget(game, detour)
    lp = Potential(Legs((game,), (budget,)), make_faces(game), 1e-3)
    lp.solve(math.inf)
    ambusher = lp.ambush.ambusher(game, np.ones(len(game.sites), dtype=bool))
    return ambusher, budget, lp.bound


def lower_bound(game, ambusher, budget) -> float:
    """The bound by the curves of a leg's ambusher, at least 0."""
    (curves,), (price,) = ambusher.circulations, ambusher.prices
    return max(curve_bound(make_faces(game), curves, game.loss * ambusher.q, budget, price), 0.0)


class Case:
    """A small planar game with all its routes, and an ambusher with a circulation; or nothing."""

    def __init__(self, seed: int, reach: float, detour: float) -> None:
        network = planar_network(seed, inside=seed % 2 == 1)
        routes = routes_of(network)
        self.ambusher = None
        if not 0 < len(routes) <= 1000:
            return
        self.game = make_game(network, GameOptions(ambush_radius=reach))
        self.near = reached(network, reach, self.game.options.secured_distance)
        self.ambusher, self.budget, self.bound = proof(self.game, detour)
        self.met = np.array([self.near[:, route].any(axis=1) for route in routes])
        self.length = np.array([network.lengths[route].sum() for route in routes])
        self.once = value_by_routes(network.alpha, self.near, routes,
                                    [(network.lengths, self.budget.limit)])

    def least_cost(self, ambusher: Ambusher) -> float:
        """The best response among all routes, less what the budget is worth."""
        (price,), limit = ambusher.prices, self.budget.limit
        costs = self.met @ (ambusher.q * self.game.network.alpha) + price * self.length
        return float(costs.min()) - (price * limit if price > 0.0 else 0.0)

    def bound_of(self, ambusher: Ambusher) -> float:
        """The bound that the ambusher proves; 0 if he is refused."""
        try:
            return lower_bound(self.game, ambusher, self.budget)
        except SolverFailed:
            return 0.0


cases = st.builds(Case, st.integers(0, 10**6), st.floats(0.2, 1.5),
                  st.sampled_from((1.02, 1.1, 1.3, np.inf)))


def perturbed(ambusher: Ambusher, game, rng) -> Ambusher:
    """The ambusher with something changed: his q, his price, or his circulation."""
    q, (price,), (curves,) = ambusher.q.copy(), ambusher.prices, ambusher.circulations
    kind = rng.integers(0, 8)
    sites = game.sites
    if kind == 0:
        j, k = rng.choice(sites, 2)
        moved = rng.uniform(0.0, q[j])
        q[j], q[k] = q[j] - moved, q[k] + moved
    elif kind == 1:
        q = q * rng.choice([0.5, 0.999, 1.001, 2.0])
    elif kind == 2:
        price = price * rng.choice([0.0, 0.5, 1.5, 3.0]) + rng.choice([0.0, 0.1])
    elif kind == 3:
        curves = replace(curves, through=curves.through * rng.choice([-1.0, 0.0, 1.1, 10.0])
                         + rng.choice([0.0, 1.0]) * rng.normal(size=len(curves.through)))
    elif kind == 4:
        curves = replace(curves, flow=curves.flow * rng.uniform(-2.0, 3.0, len(curves.flow)))
    elif kind == 5:
        curves = replace(curves, face=rng.permutation(curves.face))
    elif kind == 6:
        curves = replace(curves, site=rng.choice(sites, len(curves.site)))
    else:
        count, faces = 60, make_faces(game)
        curves = Circulation(rng.normal(size=len(curves.through)), rng.choice(sites, count),
                             rng.integers(0, faces.count, count), rng.normal(size=count))
    return Ambusher(q, (price,), (curves,))


@examples(12)
@given(cases, st.integers(0, 10**6))
def test_a_perturbed_ambusher_is_refused_or_proves_no_more_than_is_true(case, seed):
    """Neither for this ambusher, nor for any."""
    assume(case.ambusher is not None and case.ambusher.circulations)
    assume(len(case.game.sites) > 1)
    rng, ambusher = np.random.default_rng(seed), case.ambusher
    for _ in range(12):
        before = ambusher if rng.random() < 0.5 else case.ambusher
        try:
            ambusher = perturbed(before, case.game, rng)
        except SolverFailed:  # q is none of an ambusher's
            continue
        bound = case.bound_of(ambusher)
        assert bound <= max(case.least_cost(ambusher), 0.0) + 1e-9
        assert bound <= case.once * (1.0 + 1e-9)


@examples(30)
@given(cases, st.integers(0, 10**6), st.sampled_from((3, 40, 10_000)))
def test_the_least_number_of_meetings_is_that_of_all_routes(case, seed, labels):
    """For any links and sites; searches that are cut short never say more."""
    assume(case.ambusher is not None and len(case.game.sites) > 1)
    rng, faces, game = np.random.default_rng(seed), make_faces(case.game), case.game
    links = rng.choice(len(faces.left), min(rng.integers(0, 6), len(faces.left)), replace=False)
    rows = rng.choice(len(game.sites), rng.integers(1, min(6, len(game.sites)) + 1), replace=False)
    crossed = [np.isin(faces.link[route], links).sum() for route in routes_of(game.network)]
    met = case.met[:, game.sites[rows]].sum(axis=1) + crossed
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(curves_module, 'MAX_LABELS', labels)
        found = _Crossings(faces).least_met(links, rows, 5)
    assert found <= min(5, met.min())
    assert found == min(5, met.min()) or labels < 10_000


def test_the_circulation_of_another_network_is_refused():
    game = make_game(terrain_network(3, cells=14), GameOptions(ambush_radius=2.0))
    ambusher, budget, _ = proof(game, 1.2)
    (curves,) = ambusher.circulations
    for wrong in (replace(curves, through=curves.through[:-1]),
                  replace(curves, site=curves.site + len(game.loss))):
        with pytest.raises(SolverFailed, match='another network'):
            lower_bound(game, replace(ambusher, circulations=(wrong,)), budget)
    crossing = make_game(terrain_network(5, 'uniform_grid8', 14), GameOptions(ambush_radius=2.0))
    q = np.zeros(crossing.node_count)
    q[crossing.sites[0]] = 1.0
    with pytest.raises(SolverFailed, match='links cross'):
        lower_bounds(Legs((crossing,), (length_budget(crossing, 1.2),)),
                     Ambusher(q, (0.0,), (curves,)))


def nearly_two_secured_radii_apart(seed):
    """A game and a detour: the secured discs of start and goal overlap in a narrow lens."""
    rng = np.random.default_rng(seed)
    n = rng.integers(25, 90)
    points = rng.uniform(-1.0, 1.0, (n, 2)) * [1.3, 1.0]
    half = rng.uniform(0.3, 0.6)
    points[:2] = (-half, 0.0), (half, 0.0)
    links = neighbours(points)
    links = links[links.sum(axis=1) > 1]  # not from start to goal
    alpha = rng.uniform(1.0, 10.0, n)
    alpha[:2] = 0.0
    with pytest.warns(UserWarning, match='dropped'):
        network = Network(points, alpha, np.vstack((links, links[:, ::-1])), 0, 1)
    secured = half / rng.uniform(0.88, 0.99)
    game = make_game(network,
                     GameOptions(ambush_radius=secured * rng.uniform(0.9, 1.2),
                                 secured_radius=secured))
    return game, rng.choice([1.05, 1.2, 1.5, 3.0])


def test_a_curve_does_not_lead_through_a_secured_area_that_cuts_a_disc_in_two():
    """The curves prove no more than some route costs."""
    game, detour = nearly_two_secured_radii_apart(1519)
    faces = make_faces(game)
    discs = faces.discs(game.entering)
    assert len(np.unique(discs.part)) > len(np.unique(discs.disc))
    ambusher, budget, bound = proof(game, detour)
    site_prices, (price,) = (game.loss * ambusher.q)[game.sites], ambusher.prices
    base = price * budget.reduced_cost
    _, route = Subnetwork(game, game.entering).least_cost(base, site_prices, SEARCHES)
    met = game.entering[:, route].getnnz(axis=1) > 0
    cost = (game.loss[game.sites] * ambusher.q[game.sites])[met].sum()
    cost += price * (budget.cost[route].sum() - budget.limit)
    assert ambusher.circulations
    assert bound * (1.0 - 1e-6) <= lower_bound(game, ambusher, budget) <= max(cost, 0.0) + 1e-9
