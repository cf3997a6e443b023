# SPDX-License-Identifier: Apache-2.0
"""Orders of the nodes, the parts of the network that go forward in them, and cycles taken off."""

import networkx
import numpy as np
import pytest
from games import connected_flow, examples, is_acyclic, networks, terrain_network, unbalanced
from hypothesis import given
from hypothesis import strategies as st

from ambush_planner import GameOptions
from ambush_planner.game.distribution.acyclic import (
    acyclic_subnetwork,
    order_potential,
    positions_by,
    topological_order,
    without_cycles,
)
from ambush_planner.game.distribution.chain import conserved_strategy
from ambush_planner.game.game import make_game


def mixed_walks(network, seed: int, walks: int = 16) -> np.ndarray:
    """Uses p (M,) of random walks from source to target: a flow of 1 with cycles.

    The number of walks is a power of 2, so that differences of p are exact.
    """
    rng, p = np.random.default_rng(seed), np.zeros(len(network.edges))
    graph = networkx.DiGraph(network.edges.tolist())
    leads = networkx.ancestors(graph, network.target) | {network.target}
    leaving: dict[int, list[int]] = {}
    for k, (tail, head) in enumerate(network.edges.tolist()):
        if head in leads:
            leaving.setdefault(tail, []).append(k)
    for _ in range(walks):
        node = network.source
        while node != network.target:
            k = int(rng.choice(leaving[node]))
            p[k] += 1.0 / walks
            node = int(network.edges[k, 1])
    return p


@examples(25)
@given(networks())
def test_forward_parts_are_acyclic_and_every_edge_is_on_a_route(network):
    game = make_game(network, GameOptions())
    for potential in (order_potential(game), np.arange(game.node_count)):
        part = acyclic_subnetwork(game, positions_by(potential))
        if part is None:
            continue
        used = part.playable.astype(float)
        assert is_acyclic(network, used)
        graph = networkx.DiGraph(network.edges[part.playable].tolist())
        assert set(graph) == (
            networkx.descendants(graph, network.source) & networkx.ancestors(graph, network.target)
        ) | {network.source, network.target}


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


@examples(25)
@given(networks(), st.integers(0, 10**6))
def test_an_order_around_a_strategy_keeps_it(network, seed):
    game = make_game(network, GameOptions())
    p = without_cycles(network, mixed_walks(network, seed))
    position = topological_order(game, p, order_potential(game))
    used = p > 0.0
    assert (position[network.tails[used]] < position[network.heads[used]]).all()
    part = acyclic_subnetwork(game, position)
    assert part.playable[used].all() and is_acyclic(network, part.playable.astype(float))


@examples(25)
@given(networks(), st.integers(0, 10**6))
def test_cancelling_cycles_keeps_the_unit_flow(network, seed):
    p = mixed_walks(network, seed)
    less = without_cycles(network, p)
    assert is_acyclic(network, less)
    assert unbalanced(network, less) < 1e-12
    assert (less <= p + 1e-15).all() and less.min() >= 0.0
    assert connected_flow(network, less) == pytest.approx(1.0)


@examples(25)
@given(networks(), st.integers(0, 10**6))
def test_an_almost_conserved_flow_becomes_an_exact_one_with_the_same_shares(network, seed):
    game = make_game(network, GameOptions())
    exact = without_cycles(network, mixed_walks(network, seed))
    rng = np.random.default_rng(seed)
    rough = exact * (1.0 + 1e-6 * rng.normal(size=len(exact))) + 1e-12 * rng.random(len(exact))
    p = conserved_strategy(game, rough, 1e-9)
    assert unbalanced(network, p) < 1e-12 and is_acyclic(network, p)
    assert p == pytest.approx(exact, abs=1e-4)
    assert conserved_strategy(game, np.zeros(len(exact))) is None
