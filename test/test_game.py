# SPDX-License-Identifier: Apache-2.0
"""The options of the game: forbidden nodes, the secured area, sites off the road, ranges."""

import numpy as np
import pytest
from games import examples, networks
from hypothesis import given, reject
from hypothesis import strategies as st

from ambush_planner import GameOptions, Network, NoRoute, StrategyOptions, solve
from ambush_planner.game.game import make_game


@examples(10)
@given(networks(), st.sampled_from((0.5, 2.0, 3.0)))
def test_nodes_over_the_threshold_are_never_driven_through(network, limit):
    free = StrategyOptions(max_detour=np.inf)
    try:
        strategy = solve(network, GameOptions(alpha_threshold=limit), free)
    except NoRoute:
        reject()
    assert network.alpha[strategy.visit_probability > 0.0].max() <= limit


@examples(10)
@given(networks(), st.floats(0, 8))
def test_the_ambusher_never_waits_on_secured_ground(network, radius):
    game = make_game(network, GameOptions(secured_radius=radius))
    ends = network.points[[network.source, network.target]]
    near = np.linalg.norm(network.points[:, None] - ends, axis=2).min(axis=1) <= radius
    assert (game.loss[near] == 0.0).all()
    q = solve(network, GameOptions(secured_radius=radius)).ambush_probability
    if len(game.sites):
        assert (q[near] == 0.0).all()


def test_no_route_says_what_the_threshold_discards():
    network = Network([[0, 0], [1, 0], [2, 0]], [0, 9, 0], [(0, 1), (1, 2)], 0, 2)
    with pytest.raises(NoRoute, match=r'from \(.*\) to \(.*\); alpha_threshold 5 discards 1 nodes'):
        solve(network, GameOptions(alpha_threshold=5.0))


# Sites off the road.


def road(alpha=(0, 1, 1, 1, 0), aside=(9.0,)) -> Network:
    """A road of nodes 1 m apart and, from 1 m next to its middle, nodes without edges."""
    points = [[k, 0] for k in range(5)] + [[2, 1 + k] for k in range(len(aside))]
    edges = [(k, k + 1) for k in range(4)]
    return Network(points, [*alpha, *aside], edges, 0, 4)


def losses_at(network, **options) -> dict[int, float]:
    """Loss of an ambush on the only route, by site."""
    game = make_game(network, GameOptions(**options))
    losses = game.loss[game.sites] * (game.entering @ np.where(game.playable, 1.0, 0.0))
    return dict(zip(game.sites.tolist(), losses.tolist(), strict=True))


def test_with_a_reach_sites_may_be_off_the_road():
    assert losses_at(road(), ambush_radius=1.1) == {2: 1.0, 5: 9.0}
    assert solve(road(), GameOptions(ambush_radius=1.1)).value == pytest.approx(9.0)
    # An ambush out of reach of the road causes no loss.
    assert losses_at(road(aside=(1.0, 9.0)), ambush_radius=1.1) == {2: 1.0, 5: 1.0, 6: 0.0}


def test_with_a_reach_sites_may_be_on_forbidden_ground():
    network = road(aside=(12.0,))
    two_way = np.vstack((network.edges, [(2, 5), (5, 2)]))
    network = Network(network.points, network.alpha, two_way, 0, 4)
    strategy = solve(network, GameOptions(ambush_radius=1.1, alpha_threshold=5.0))
    assert strategy.value == pytest.approx(12.0)
    assert strategy.ambush_probability[5] == pytest.approx(1.0)
    assert strategy.visit_probability[5] == 0.0


def test_a_disc_that_contains_or_touches_an_end_is_not_a_site():
    assert losses_at(road(aside=()), ambush_radius=2.0) == {}
    assert losses_at(road(aside=()), ambush_radius=1.9) == {2: 1.0}
