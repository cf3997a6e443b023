# SPDX-License-Identifier: Apache-2.0
"""Every public record that has a value and a bound, from random games: order, units, reason.

And strategy files, read back whole, their certificates computed from the probabilities.
"""

import math
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from games import examples, networks, terrain_network
from hypothesis import given
from hypothesis import strategies as st

from ambush_planner import GameOptions, SolverFailed, StrategyOptions, evaluate, frontier, solve
from ambush_planner.game.certificate.certificate import Certificate
from ambush_planner.game.revaluation import revalue
from ambush_planner.game.tolerance import Reason
from ambush_planner.recordings.attachments import strategy_file, strategy_from_file

OPTIONS = StrategyOptions(max_detour=1.3)


def check(record) -> None:
    """The bound is at most the value."""
    assert 0.0 <= record.lower_bound <= record.value, record


def check_strategy(trip, options=OPTIONS) -> None:
    """Order, reason, and lengths in the networks' own unit; a file gives the same again."""
    check(trip)
    close = trip.value <= trip.lower_bound * 1.01001
    assert trip.reason in get_args(Reason)
    assert close == (trip.reason == 'complete') or not trip.value
    for leg in trip.legs:
        network = leg.network
        cost = network.lengths if network.seconds is None else network.seconds
        assert leg.expected_length == pytest.approx(leg.edge_probability @ cost)
        assert network.travel_unit == ('m' if network.seconds is None else 's')
        assert leg.expected_length <= leg.length_budget * (1.0 + 1e-6)
        assert evaluate(leg)['stochastic'].expected_length == leg.expected_length
    again = strategy_from_file(strategy_file(trip), trip.game.options)
    assert (again.reason, again.value) == (trip.reason, pytest.approx(trip.value))
    assert again.lower_bound == pytest.approx(trip.lower_bound, rel=1e-8, abs=1e-12)
    for one, other in zip(again.legs, trip.legs, strict=True):
        check(one)
        assert (one.value, one.length_price) == pytest.approx((other.value, other.length_price))


@examples(6)
@given(st.data(), st.sampled_from((0.0, 1.5)), st.booleans())
def test_records_of_any_network(data, reach, timed):
    terrain = st.builds(terrain_network, st.integers(0, 10**6), cells=st.just(8))
    network = data.draw(networks() | terrain)
    rng = np.random.default_rng(len(network.edges))
    if timed:
        network = replace(network, seconds=network.lengths * rng.uniform(1.0, 3.0, len(
            network.lengths)))
    game = GameOptions(ambush_radius=reach)
    strategy = solve(network, game, OPTIONS)
    check_strategy(strategy.as_trip)
    for row in frontier(network, game, (1.0, 1.3), (0.1,)):
        check(row)
        assert row.shortest_length == strategy.shortest_length
    other = revalue(strategy.as_trip, strategy.network.alpha * rng.uniform(0.5, 2.0, len(
        strategy.network.alpha)))
    assert 0.0 <= other.bound <= other.value


def test_a_certificate_never_has_a_bound_above_its_value():
    for value, bound in ((1.0, 1.0 + 1e-6), (0.0, 1e-9), (1.0, math.nan), (1.0, -1.0)):
        with pytest.raises(SolverFailed, match='lower bound'):
            Certificate(value, bound)
    rounded = Certificate(1.0, 1.0 + 1e-12)
    assert rounded.bound == rounded.value
