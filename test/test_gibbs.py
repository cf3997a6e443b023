# SPDX-License-Identifier: Apache-2.0
"""The Gibbs distribution: routes by hand, limits, weights beyond e^700; its part of a network."""

import math

import networkx
import numpy as np
import pytest
from games import PLAIN, examples, networks, routes_of, terrain_network, unbalanced
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.sparse import csr_matrix

from ambush_planner import GameOptions, Network
from ambush_planner.game.distribution.acyclic import (
    acyclic_subnetwork,
    order_potential,
    positions_by,
)
from ambush_planner.game.distribution.entropy_search import Accuracy, maximize_entropy
from ambush_planner.game.distribution.gibbs import acyclic_network
from ambush_planner.game.game import make_game

NEVER = math.inf


def forward(network):
    """The acyclic part by the harmonic potential, and its edges in order; None without a route."""
    game = make_game(network, GameOptions())
    position = positions_by(order_potential(game))
    part = acyclic_subnetwork(game, position)
    return None if part is None else (
        part, acyclic_network(network, np.flatnonzero(part.playable), position))


def on_all(network, acyclic, values) -> np.ndarray:
    """Values (m,) of the acyclic part's edges as (M,)."""
    whole = np.zeros(len(network.edges))
    whole[acyclic.edge] = values
    return whole


@pytest.mark.parametrize(('method', 'seed'), [
    ('uniform_delaunay', 1), ('uniform_grid8', 2), ('random_delaunay', 3)])
def test_the_harmonic_order_keeps_one_direction_of_every_two_way_edge(method, seed):
    """The voltage lies between its neighbours', so no node that can lie on a route is lost."""
    network = terrain_network(seed, method, 14)
    game = make_game(network, GameOptions())
    part = acyclic_subnetwork(game, positions_by(order_potential(game)))
    undirected = {frozenset(e) for e in network.edges[game.playable].tolist()}
    kept = {frozenset(e) for e in network.edges[part.playable].tolist()}
    simple = networkx.Graph([tuple(e) for e in undirected])
    simple.add_edge(network.source, network.target)
    core = max(
        (c for c in networkx.biconnected_components(simple) if network.source in c
         and network.target in c), key=len,
    )
    ends = {network.source, network.target}
    able = {e for e in undirected if e <= core and e != ends}
    assert len(kept & able) == len(able)


@examples(15)
@given(networks(), st.integers(0, 10**6), st.sampled_from((0.1, 1.0, 30.0)))
def test_every_route_has_the_probability_of_its_weight(network, seed, size):
    case = forward(network)
    assume(case is not None)
    acyclic = case[1]
    weights = size * np.random.default_rng(seed).random(len(acyclic.edge))
    log_z, p, share = acyclic.distribution(weights)
    place = np.full(len(network.edges), -1)
    place[acyclic.edge] = np.arange(len(acyclic.edge))
    routes = [place[route] for route in routes_of(network, place >= 0)]
    by_hand = np.array([weights[route].sum() for route in routes])
    assert log_z == pytest.approx(np.logaddexp.reduce(-by_hand), abs=1e-9)
    likely = np.exp(-by_hand - log_z)
    assert [share[route].prod() for route in routes] == pytest.approx(likely, abs=1e-12)
    used = np.zeros(len(p))
    for route, chance in zip(routes, likely, strict=True):
        used[route] += chance
    assert p == pytest.approx(used, abs=1e-12)


@examples(8)
@given(networks(alphas=PLAIN), st.floats(0.2, 0.99), st.sampled_from((0.0, 5.0)))
def test_infeasible_limits_are_proved_infeasible(network, tightness, heaviest):
    """All of the source's edges together may be used less than once."""
    case = forward(network)
    assume(case is not None)
    part, acyclic = case
    out = (network.tails[acyclic.edge] == network.source) / tightness
    weights = np.random.default_rng(0).uniform(0.0, heaviest, len(acyclic.edge))
    found = maximize_entropy(acyclic, csr_matrix(out), weights, np.zeros(1),
                             Accuracy(0.0, 5e-4), NEVER)
    assert found.infeasible
    # And limits that can be kept are never called infeasible.
    kept = maximize_entropy(acyclic, csr_matrix(out * tightness), weights, np.zeros(1),
                            Accuracy(1e-9, 5e-4), NEVER)
    assert not kept.infeasible and kept.violation <= 1e-9


def ladder(rungs: int) -> Network:
    """Two sides with crossings: 2^rungs routes."""
    points = [[-1, 0], *([k, side] for k in range(rungs) for side in (0, 1)), [rungs, 0]]
    edges = [(0, 1), (0, 2), (2 * rungs - 1, 2 * rungs + 1), (2 * rungs, 2 * rungs + 1)]
    for k in range(rungs - 1):
        edges += [(2 * k + a, 2 * k + 2 + b) for a in (1, 2) for b in (1, 2)]
    alpha = [0.0, *[1.0] * (2 * rungs), 0.0]
    return Network(np.array(points, float), alpha, np.array(edges), 0, 2 * rungs + 1)


@pytest.mark.parametrize('weight', [-3.0, 0.5, 200.0])
def test_partition_functions_beyond_floating_point(weight):
    """1500 rungs: log Z from 1039 - 1501 w, far beyond e^700 on either side; levels jump, too."""
    rungs = 1500
    network = ladder(rungs)
    _, acyclic = forward(network)
    exact = rungs * math.log(2.0) - (rungs + 1) * weight
    for _ in range(2):
        log_z, p, _ = acyclic.distribution(np.full(len(acyclic.edge), weight))
        assert log_z == pytest.approx(exact, rel=1e-10)
        assert unbalanced(network, on_all(network, acyclic, p)) < 1e-9
        acyclic.distribution(np.full(len(acyclic.edge), weight + 1.0))
