"""Ambushes with a reach: edges that enter discs, and drawn routes against the published value."""

import numpy as np
import pytest

from ambush_planner import (
    GameOptions,
    Network,
    NetworkOptions,
    RiskMap,
    StrategyOptions,
    build_network,
    solve,
)

ROUTES = 20_000
# Chance that any of the sites exceeds the value by luck: 5 standard deviations for each.
DEVIATIONS = 5.0


def hilly_network(nodes_across: int) -> Network:
    """A 100 m square with a smooth risk and a block in the middle, mid-left to mid-right."""
    cells = 100
    v, u = np.meshgrid(*2 * [(np.arange(cells) + 0.5) / cells], indexing="ij")
    alpha = 1 + 4 * np.exp(-((u - 0.7) ** 2 + (v - 0.25) ** 2) / 0.08)
    block = (np.abs(u - 0.5) < 0.12) & (np.abs(v - 0.5) < 0.12)
    return build_network(
        RiskMap(alpha, block, 1.0),
        (3.0, 50.0),
        (97.0, 50.0),
        NetworkOptions(spacing=cells / nodes_across),
    )


def test_edges_that_enter_a_disc_count_once():
    # A row of nodes one metre apart; discs of 1.2 m. s and t and their neighbours are no sites.
    points = np.column_stack((np.arange(7.0), np.zeros(7)))
    alpha = np.array([0, 1, 1, 1, 1, 1, 0.0])
    edges = np.column_stack((np.arange(6), np.arange(1, 7)))
    game = solve(Network(points, alpha, edges, 0, 6), GameOptions(ambush_radius=1.2)).game
    assert game.sites.tolist() == [2, 3, 4]
    assert game.hits.toarray().tolist() == [
        [1, 0, 0, 0, 0, 0],
        [0, 1, 0, 0, 0, 0],
        [0, 0, 1, 0, 0, 0],
    ]


def test_an_edge_that_only_passes_through_a_disc_hits():
    points = np.array([[0, 0], [10, 0], [5, 1.0]])
    network = Network(points, np.array([0, 0, 1.0]), np.array([[0, 1], [0, 2], [2, 1]]), 0, 1)
    assert solve(network, GameOptions(ambush_radius=2.0)).value == pytest.approx(1.0, rel=1e-6)
    assert solve(network, GameOptions(ambush_radius=0.5)).value == 0.0


@pytest.mark.parametrize("radius", [0.0, 10.0])
def test_no_site_is_hit_more_often_than_the_value_allows(radius):
    strategy = solve(hilly_network(20), GameOptions(ambush_radius=radius, secured_radius=12.0))
    game, rng = strategy.game, np.random.default_rng(7)
    passages = np.zeros(len(game.sites))
    edge_of = {tuple(edge): k for k, edge in enumerate(strategy.network.edges.tolist())}
    hits = game.hits.tocsc()
    for _ in range(ROUTES):
        route = strategy.sample_route(rng).tolist()
        used = [edge_of[pair] for pair in zip(route[:-1], route[1:], strict=True)]
        passages[np.unique(hits[:, used].indices)] += 1
    frequency = passages / ROUTES
    error = np.sqrt(np.maximum(frequency * (1 - frequency), 1 / ROUTES) / ROUTES)
    loss = game.loss[game.sites]
    assert (loss * (frequency - DEVIATIONS * error) <= strategy.value).all()


def test_the_reach_makes_the_value_converge():
    """Without a reach the value falls with the mesh; with it, it settles."""
    options = StrategyOptions(max_detour=np.inf)
    networks = [hilly_network(nodes_across) for nodes_across in (12, 20, 30)]
    points = [solve(n, GameOptions(secured_radius=25.0), options).value for n in networks]
    discs = [
        solve(n, GameOptions(ambush_radius=10.0, secured_radius=25.0), options).value
        for n in networks
    ]
    assert points[0] > 1.3 * points[1] > 1.3**2 * points[2]
    assert max(discs) < 1.2 * min(discs)
