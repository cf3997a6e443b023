"""What a strategy is worth on other losses, and how near to the best it is known to be."""

import numpy as np
import pytest
from games import geometric_hits, hit_once, quiet_network, terrain_network

from ambush_planner import GameOptions, StrategyOptions, solve
from ambush_planner.game.revaluation import revalue


def with_alpha(network, alpha):
    return quiet_network(network.points, alpha, network.edges, network.source, network.target)


@pytest.mark.parametrize('reach', [0.0, 2.0])
def test_revalue_gives_the_value_on_the_new_losses(reach):
    network = terrain_network(4, cells=14)
    game, free = GameOptions(ambush_radius=reach), StrategyOptions(max_detour=np.inf)
    strategy = solve(network, game, free)
    same = revalue(strategy, network.alpha)
    assert same.value == pytest.approx(strategy.value) and same.bound <= same.value
    changed = with_alpha(network, network.alpha * np.linspace(0.5, 2.0, len(network.alpha)))
    other, best = revalue(strategy, changed.alpha), solve(changed, game, free)
    entered = np.arange(len(changed.alpha))[:, None] == changed.heads
    hits = geometric_hits(changed, reach).toarray() > 0.0 if reach else entered
    hit = hit_once(changed, strategy.edge_probability, hits)
    assert other.value == pytest.approx((changed.alpha * hit).max())
    assert other.bound <= best.value and best.lower_bound <= other.value


def test_twice_the_losses_give_twice_the_value():
    network = terrain_network(4, cells=10)
    strategy = solve(network, options=StrategyOptions(max_detour=np.inf))
    twice = revalue(strategy, 2.0 * network.alpha)
    assert twice.value == pytest.approx(2 * strategy.value)
    assert twice.bound == pytest.approx(2 * strategy.lower_bound)
