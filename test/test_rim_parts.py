"""Held ground that cuts a disc in two: a curve does not lead through it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import Delaunay

from ambush_planner import GameOptions, Network
from ambush_planner.game.ambusher import Ambusher, at_nodes
from ambush_planner.game.budget import Budget
from ambush_planner.game.certificate.best_response import best_response
from ambush_planner.game.certificate.certificate import lower_bound
from ambush_planner.game.game import make_game
from ambush_planner.game.value.faces import make_faces
from ambush_planner.game.value.potential import Potential


def nearly_two_held_radii_apart(seed):
    """A game and its length budget: the held discs of start and goal overlap in a narrow lens."""
    rng = np.random.default_rng(seed)
    n = rng.integers(25, 90)
    points = rng.uniform(-1.0, 1.0, (n, 2)) * [1.3, 1.0]
    half = rng.uniform(0.3, 0.6)
    points[:2] = (-half, 0.0), (half, 0.0)
    corners = Delaunay(points).simplices
    links = np.unique(np.sort(np.vstack((corners[:, :2], corners[:, 1:], corners[:, ::2])), axis=1),
                      axis=0)
    links = links[links.sum(axis=1) > 1]  # not from start to goal
    alpha = rng.uniform(1.0, 10.0, n)
    alpha[:2] = 0.0
    with pytest.warns(UserWarning, match='dropped'):
        network = Network(points, alpha, np.vstack((links, links[:, ::-1])), 0, 1)
    held = half / rng.uniform(0.88, 0.99)
    game = make_game(network, GameOptions(held * rng.uniform(0.9, 1.2), held))
    return game, Budget.length(game, rng.choice([1.05, 1.2, 1.5, 3.0]))


@pytest.mark.parametrize('seed', [1011, 1029, 1234, 1425])
def test_curves_prove_no_more_than_some_route_costs(seed):
    game, budget = nearly_two_held_radii_apart(seed)
    faces = make_faces(game)
    parts = faces.parts(game.hits, faces.discs(game.hits))
    assert len(np.unique(parts)) > len(np.unique(faces.discs(game.hits).disc))
    program = Potential(faces, budget, math.inf)
    if len(program.q) < len(game.sites):
        program.add_sites(game.hits, game.loss[game.sites])
    program.solve()
    curves = replace(program.circulation, site=game.sites[program.circulation.site])
    ambusher = Ambusher(at_nodes(game, program.q), (program.price,), curves)
    route = best_response(game, ambusher.q, (budget,), ambusher.prices).edges
    met = game.hits[:, route].getnnz(axis=1) > 0
    cost = (game.loss[game.sites] * ambusher.q[game.sites])[met].sum()
    cost += program.price * (budget.cost[route].sum() - budget.limit)
    assert lower_bound(game, ambusher, (budget,)) <= max(cost, 0.0) + 1e-9
