"""Days of distinct departures in the audit: held against such days, not against single draws."""

import numpy as np
import pytest
from games import terrain_network

from ambush_planner import NotDistinct, StrategyOptions, sample_departures, solve
from ambush_planner.recordings.audit_departures import audit
from ambush_planner.recordings.audit_draws import NotAuditable
from ambush_planner.recordings.audit_groups import Day, Driven, groups_of

pytestmark = pytest.mark.usefixtures('fewer_draws')


@pytest.fixture(scope='module')
def strategy():
    return solve(terrain_network(3, cells=12), options=StrategyOptions(max_detour=1.4))


def days_of(strategy, count, n, seed, alone=0):
    """Departures of days of n convoys each, some single ones between them."""
    rng = np.random.default_rng(seed)
    found = []
    for k in range(count):
        day = Day(0.5)
        found += [Driven(strategy, route, day) for route in sample_departures(strategy, n, rng)]
        if k < alone:
            found.append(Driven(strategy, strategy.sample_route(rng)))
    return found


def as_single(departures):
    return [Driven(each.strategy, each.route) for each in departures]


def test_days_that_follow_their_law_have_no_findings(strategy):
    """At a rate of 1 % each: a second finding among three comes once in 3000 times."""
    results = [audit(days_of(strategy, 12, 2, seed, alone=5)) for seed in range(3)]
    assert sum(bool(result.findings) for result in results) <= 1
    assert all(result.impossible == 0 for result in results)


@pytest.mark.slow
def test_p_values_spread_over_all(strategy):
    """Under the law of days they are uniform; the mean of eight is 0.5 +- 0.1."""
    found = [audit(days_of(strategy, 5, 2, 100 + seed)).tests for seed in range(8)]
    for name in ('frequency', 'surprise'):
        assert 0.2 < np.mean([each[name].p_value for each in found]) < 0.8


def test_taken_for_single_draws_days_are_found_out(strategy):
    departures = days_of(strategy, 30, 2, 1)
    assert not audit(departures).findings
    assert audit(as_single(departures)).findings


def test_single_draws_are_no_days(strategy):
    rng = np.random.default_rng(5)
    departures = []
    for _ in range(6):
        day = Day(0.5)
        departures += [Driven(strategy, strategy.sample_route(rng), day) for _ in range(2)]
    result = audit(departures)
    assert 0 < result.impossible <= 6 and result.findings[0] == 'impossible'


def test_the_same_day_again_and_again_is_found(strategy):
    routes = sample_departures(strategy, 2, np.random.default_rng(2))
    departures = []
    for _ in range(6):
        day = Day(0.5)
        departures += [Driven(strategy, route, day) for route in routes]
    assert 'repeats' in audit(departures).findings


def test_passages_are_held_against_those_of_days(strategy):
    """What is expected is the mean of drawn days, not the published probability."""
    result = audit(days_of(strategy, 20, 2, 3))
    single = audit(as_single(days_of(strategy, 20, 2, 3)))
    assert result.expected.sum() == pytest.approx(result.passages.sum(), rel=0.1)
    assert np.abs(result.expected - single.expected).max() > 1.0


def test_a_day_has_one_strategy(strategy):
    other = solve(strategy.network)
    day = Day(0.5)
    rng = np.random.default_rng(1)
    departures = [Driven(each, each.sample_route(rng), day) for each in (strategy, other)]
    with pytest.raises(NotAuditable, match='several strategies'):
        groups_of(departures)


def test_more_than_there_is_room_for(strategy):
    """Recorded days that their strategy cannot have given."""
    rng = np.random.default_rng(1)
    day = Day(1.0)
    departures = [Driven(strategy, strategy.sample_route(rng), day) for _ in range(40)]
    with pytest.raises(NotDistinct, match='40 routes'):
        audit(departures)
