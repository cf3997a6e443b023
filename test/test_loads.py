# SPDX-License-Identifier: Apache-2.0
"""Trips with less aboard on later legs: an LP over all trips, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from games import examples, routes_of, value_by_routes
from hypothesis import assume, given
from hypothesis import strategies as st
from test_trip import roads_of

from ambush_planner import (
    GameOptions,
    InvalidOption,
    PlanningOptions,
    RiskMap,
    StrategyOptions,
    plan_trip,
    solve,
)
from ambush_planner.commands import cli
from ambush_planner.game.distribution.chain import chain_of

LOADS = (1.0, 0.6, 0.2)
MOST_TRIPS = 5000  # of a game that is enumerated


def value_of_all_trips(game, loads):
    """Least value of any mixture of trips; the leg that meets a site first says what it costs.

    No later leg has more aboard, so that is the most that any of the trip's hits costs.
    """
    network, entering = game.network, game.entering.toarray() > 0.0
    trips = routes_of(network, most=MOST_TRIPS + 1)
    assume(len(trips) <= MOST_TRIPS)
    load = np.array(loads)[network.leg[network.tails]]
    return value_by_routes(game.loss[game.sites], entering * load, trips)


@examples(8)
@given(seed=st.integers(0, 10**6), stops=st.integers(1, 2), reach=st.sampled_from([0.0, 1.0]))
def test_the_value_agrees_with_an_lp_over_all_trips(seed, stops, reach):
    roads, loads = roads_of(seed, stops, 4), LOADS[: stops + 1]
    network = roads.network(roads.visits)
    found = solve(network, GameOptions(ambush_radius=reach, secured_radius=0.5, loads=loads),
                  StrategyOptions(max_detour=np.inf))
    least = value_of_all_trips(found.game, loads)
    assert found.lower_bound <= least * (1.0 + 1e-6) + 1e-9
    assert found.value >= least * (1.0 - 1e-6) - 1e-9
    if found.reason != 'stalled':
        assert found.value <= found.lower_bound * 1.0101
    full = solve(network, GameOptions(ambush_radius=reach, secured_radius=0.5),
                 StrategyOptions(max_detour=np.inf))
    assert found.lower_bound <= full.value * (1.0 + 1e-9)


@examples(8)
@given(seed=st.integers(0, 10**6))
def test_the_derivative_of_hits_counts_the_load(seed):
    roads = roads_of(seed, 1, 5)
    strategy = solve(roads.network(roads.visits),
                     GameOptions(ambush_radius=1.0, secured_radius=0.5, loads=(1.0, 0.3)),
                     StrategyOptions(max_detour=np.inf))
    chain = chain_of(strategy.network, strategy.edge_probability)
    rows = chain.network.columns(strategy.game.entering)
    hits, derivative = chain.hits_with_derivatives(rows)
    assert hits == pytest.approx(chain.hits(rows), abs=1e-12)
    assert derivative @ chain.p == pytest.approx(hits, abs=1e-9)


@pytest.mark.parametrize(('loads', 'stops', 'order', 'reason'), [
    ((0.5, 0.8), [(20.0, 10.0)], 'given', '0.8 after 0.5'),
    ((1.2, 0.8), [(20.0, 10.0)], 'given', '1.2 after 1'),
    ((1.0,), [(20.0, 10.0)], 'given', '1 for 2'),
    ((0.5,), [], 'given', 'stops'),
    ((1.0, 0.5), [(20.0, 10.0)], 'best', 'order'),
])
def test_loads_that_make_no_sense_are_refused(loads, stops, order, reason):
    ground = RiskMap(np.ones((12, 30)), np.zeros((12, 30), bool), 1.0)
    with pytest.raises(InvalidOption, match=reason):
        plan_trip(ground, (3.0, 6.0), (27.0, 6.0), PlanningOptions(game=GameOptions(loads=loads)),
                  stops=stops, order=order)


def test_the_command_takes_a_load_for_each_leg(tmp_path, capsys):
    line = (f'plan docs/yard.yaml --start 4 20 --goal 4 24 --via 30 30 -o {tmp_path / "r.csv"} '
            '--set network.target_nodes=150 --quiet --json --load')
    values = []
    for loads in ('1 1', '0.5 0.2'):
        cli.main([*line.split(), *loads.split()])
        values.append(float(capsys.readouterr().out.partition('"value": ')[2].split(',')[0]))
    assert values[1] == pytest.approx(values[0] / 2.0, rel=0.02)


@pytest.mark.parametrize('reach', [0.0, 1.0])
def test_with_nothing_aboard_no_ambush_counts_and_all_routes_are_equal(reach):
    roads = roads_of(3, 1, 5)
    network = roads.network(roads.visits)
    within = StrategyOptions(max_detour=np.inf)
    found = solve(network, GameOptions(ambush_radius=reach, loads=(0.0, 0.0)), within)
    free = solve(replace(network, alpha=np.zeros(len(network.alpha))), None, within)
    assert found.value == 0.0
    assert found.route_entropy == pytest.approx(free.route_entropy, rel=1e-6)
