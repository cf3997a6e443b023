# SPDX-License-Identifier: Apache-2.0
"""The audit of departures: an exact test that finds what it should, and a foresight by hand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from games import paper_example, terrain_network
from scipy.stats import binom

from ambush_planner import GameOptions, Network, StrategyOptions, solve
from ambush_planner.game.game import make_games
from ambush_planner.game.route_sampler import RouteSampler
from ambush_planner.game.solver import solve_legs
from ambush_planner.game.strategy import TripStrategy
from ambush_planner.operations.slots import Slots
from ambush_planner.recordings.audit import audit

# Probability that a correct audit fails a statistical test; all seeds are fixed.
FALSE_ALARM = 1e-6


@dataclass
class Departure:
    drawn_from: TripStrategy
    route: tuple[np.ndarray, ...]
    drawn_slot: tuple[str, Slots] | None = None

    @property
    def covered(self):
        return self.drawn_slot[1].covered if self.drawn_slot else 1.0

    @property
    def value(self):
        return self.drawn_from.value * self.covered


def departed(strategy, route, slot=None):
    """A departure on a single leg."""
    return Departure(strategy.as_trip, (np.asarray(route),), slot)


@pytest.fixture(scope='module')
def paper():
    return solve(paper_example())


@pytest.fixture(scope='module')
def terrain():
    return solve(terrain_network(5, cells=20))


@pytest.fixture(scope='module')
def two_ways():
    """Two ways, through node 1 (loss 2) and node 2 (loss 3), driven with 0.6 and 0.4."""
    network = Network([[0, 0], [1, 1], [1, -1], [2, 0]], [0, 2, 3, 0],
                      [(0, 1), (0, 2), (1, 3), (2, 3)], 0, 3)
    strategy = solve(network, options=StrategyOptions(max_detour=np.inf, risk_slack=0.0))
    # 1e-5 of the value may be given up for more entropy.
    np.testing.assert_allclose(strategy.edge_probability, [0.6, 0.4, 0.6, 0.4], atol=0.6e-5)
    return strategy


def run(strategy, routes, **options):
    return audit([departed(strategy, route) for route in routes], **options)


def drawn(strategy, count, seed):
    return strategy.sample_routes(count, np.random.default_rng(seed))


# The test


@pytest.mark.parametrize(('name', 'departures'), [('paper', 5), ('terrain', 12)])
def test_p_values_of_honest_draws_are_uniform(request, name, departures):
    """P(p <= u) is at most u; on terrain, with few ties, it is u."""
    strategy, runs = request.getfixturevalue(name), 60
    p_values = np.array([
        run(strategy, drawn(strategy, departures, seed), rng=seed, resamples=99).p_value
        for seed in range(runs)
    ])
    for level in (0.01, 0.05, 0.2, 0.5):
        found = (p_values <= level).sum()
        assert found <= binom.isf(FALSE_ALARM, runs, level)
        assert name == 'paper' or found >= binom.ppf(FALSE_ALARM, runs, level)


def cycled(strategy, count, different):
    return [drawn(strategy, different, 2)[k % different] for k in range(count)]


def reweighted(strategy, count, power):
    """Choices made with probabilities to a power: 0 forgets the weights, 2 is too bold."""
    network, p = strategy.network, strategy.edge_probability
    out = np.bincount(network.tails, p, len(network.points))[network.tails]
    weight = np.where(p > 0.0, (p / np.where(p > 0.0, out, 1.0)) ** power, 0.0)
    return RouteSampler(network, weight).draw_many(count, np.random.default_rng(3))


@pytest.mark.parametrize(('planner', 'options'), [
    (cycled, (18, 3)), (reweighted, (20, 0.0)), (reweighted, (100, 2.0)),
])
def test_planners_that_do_not_follow_the_strategy_are_found(terrain, planner, options):
    routes = planner(terrain, *options)
    result = run(terrain, routes)
    assert result.finding and result.impossible == 0 and result.departures == len(routes)


def test_two_strategies_are_tested_each_under_its_own_distribution(terrain, paper):
    other = solve(terrain.network, options=StrategyOptions(max_detour=1.05))
    three = (terrain, paper, other)
    honest = [departed(s, route) for s in three for route in drawn(s, 20, 8)]
    result = audit(honest)
    assert (result.departures, result.strategies) == (60, 3) and not result.finding
    assert result.value == pytest.approx(
        (19 * terrain.value + 20 * paper.value + 20 * other.value) / 59
    )
    wrong = [departed(terrain, route) for route in drawn(other, 60, 8)]
    assert audit([*honest, *wrong]).finding


def test_times_of_departure_follow_their_shares_or_are_a_finding(terrain):
    """Honest draws of routes, with honest times or with 08:00 every time."""
    slots = Slots(('08:00', '09:00', '10:00', '11:00'), (0.25,) * 4, 1)
    routes, rng = drawn(terrain, 20, 3), np.random.default_rng(4)
    fair = [(slots.times[k], slots) for k in rng.choice(4, 20)]
    for times, finding in ((fair, False), ([('08:00', slots)] * 20, True)):
        result = audit([departed(terrain, route, slot)
                        for route, slot in zip(routes, times, strict=True)])
        assert result.finding == finding, result.p_value


@pytest.mark.parametrize(('wrong', 'count'), [
    ([0, 1, 6, 7], 1), ([0, 1, 6], 2),
])
def test_impossible_steps_and_ends_are_counted_and_are_a_finding(paper, wrong, count):
    result = run(paper, [*drawn(paper, 8, 1), wrong])
    assert (result.impossible, result.p_value, result.finding) == (count, 0.0, True)


# Foresight


def test_an_observer_by_hand(two_ways):
    """He waits at 1, 2 (3 > 2), 1 (4 > 3), 1, 1; the routes then pass 2, 1, 1, 1, 2."""
    result = run(two_ways, [[0, node, 3] for node in (1, 2, 1, 1, 1, 2)])
    assert result.observer_losses.tolist() == [0.0, 0.0, 2.0, 2.0, 0.0]
    assert result.observer_loss == pytest.approx(0.8)
    assert result.value == pytest.approx(1.2, rel=1e-5)


def test_legs_of_a_trip_are_audited_together(two_ways):
    """There and back by hand: he waits where both legs passed together cost most so far."""
    back = Network(two_ways.network.points, two_ways.network.alpha,
                   two_ways.network.edges[:, ::-1], 3, 0)
    trip = solve_legs(make_games((two_ways.network, back), GameOptions()), StrategyOptions())
    ways = [(1, 1), (2, 1), (2, 2), (1, 2), (1, 1), (2, 2)]
    result = audit([Departure(trip, (np.array([0, out, 3]), np.array([3, home, 0])))
                    for out, home in ways])
    # He waits at 1 (4), 1 (6 > 3), 2 (9 > 6), 2 (12 > 8), 2 (12 = 12, or 1).
    assert result.observer_losses[:4].tolist() == [2.0, 0.0, 3.0, 0.0]
    assert result.observer_losses[4] in (0.0, 6.0)
    assert (result.departures, result.strategies, result.impossible) == (6, 1, 0)
    assert not result.finding
    swapped = audit([Departure(trip, (np.array([3, 1, 0]), np.array([0, 1, 3])))] * 5)
    assert swapped.impossible == 5 * 2 * (2 + 2) and swapped.finding


def test_watching_honest_draws_brings_about_the_value():
    """He chooses before the draw, so by 5 standard errors he gets at most the value."""
    strategy = solve(terrain_network(3, cells=12), GameOptions(ambush_radius=2.0))
    result = run(strategy, drawn(strategy, 800, 6), resamples=19)
    losses = result.observer_losses
    assert result.observer_loss <= strategy.value + 5.0 * losses.std() / np.sqrt(len(losses))
    assert result.observer_loss >= 0.7 * strategy.value
    low, high = result.observer_range
    assert low < strategy.value < 1.2 * high
