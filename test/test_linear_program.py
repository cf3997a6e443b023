# SPDX-License-Identifier: Apache-2.0
"""The paper's linear programs: its 8-node example, its observations, and length weights."""

import math

import numpy as np
import pytest
from games import (
    METHODS,
    PLAIN,
    examples,
    least_weight,
    lp_value,
    networks,
    paper_example,
    terrain_network,
)
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import OptimizeResult
from scipy.sparse import csr_matrix

from ambush_planner import SolverFailed, StrategyOptions, TimeLimit, solve
from ambush_planner.game.value import highs
from ambush_planner.game.value.highs import LP, run

ANY = np.inf
LINEAR = ('interior_point', 'simplex')


def solved(network, solver, length_weight=0.0, max_detour=ANY):
    return solve(network, options=StrategyOptions(solver=solver, max_detour=max_detour,
                                                  length_weight=length_weight))


def test_the_papers_example_simplex_uses_three_routes():
    strategy = solved(paper_example(), 'simplex')
    p = strategy.edge_probability
    assert strategy.value == pytest.approx(1 / 3, rel=1e-9)
    assert np.count_nonzero(p > 1e-9) == 9
    assert p[p > 1e-9] == pytest.approx(1 / 3, rel=1e-9)
    assert strategy.edge_entropy == pytest.approx(3.30, abs=5e-3)
    assert strategy.route_entropy == pytest.approx(np.log(3), rel=1e-6)


def test_the_papers_example_interior_point_uses_all_seven():
    strategy = solved(paper_example(), 'interior_point')
    assert strategy.value == pytest.approx(1 / 3, rel=1e-6)
    assert (strategy.edge_probability > 1e-3).all()
    assert strategy.edge_entropy == pytest.approx(4.10, abs=5e-3)
    assert strategy.route_entropy == pytest.approx(1.90, abs=5e-3)


@examples(15)
@given(networks(alphas=PLAIN), st.sampled_from((0.01, 0.3, 0.9)), st.sampled_from(LINEAR))
def test_length_weight_minimises_the_weighted_sum(network, weight, solver):
    """No budget gives a better (1 - w) z + w length; the bound holds for its own length."""
    strategy = solved(network, solver, weight)
    shortest = least_weight(network, network.lengths)

    def weighted(value, length):
        return (1 - weight) * value + weight * length

    own = weighted(strategy.value, strategy.expected_length)
    for detour in (1.0001, 1.1, 1.5, 3.0):
        budget = detour * shortest
        assert own <= weighted(lp_value(network, budget), budget) * (1 + 1e-6) + 1e-7
    assert strategy.lower_bound <= strategy.value


@pytest.mark.parametrize('seed', [16, 17])
def test_the_interior_point_method_finds_the_shortest_routes(seed):
    """At a max_detour of 1, the routes within the budget have no interior on the whole network."""
    network = terrain_network(seed, METHODS[seed % 5], 20 + seed)
    strategy = solved(network, 'interior_point', max_detour=1.0)
    assert strategy.expected_length == pytest.approx(strategy.shortest_length, rel=1e-8)
    assert strategy.value == pytest.approx(solved(network, 'simplex', max_detour=1.0).value)


def test_the_other_method_solves_what_one_ends_in_an_unknown_state(monkeypatch):
    unknown = OptimizeResult(status=4, x=None, nit=0, message='model_status is Unknown')
    monkeypatch.setattr(highs, '_interior_point', lambda *_: unknown)
    assert solved(paper_example(), 'interior_point').value == pytest.approx(1 / 3, rel=1e-9)


@pytest.mark.parametrize('solver', LINEAR)
def test_an_lp_without_time_or_without_an_optimum_is_an_error_by_name(solver):
    nothing, empty = np.empty(0), csr_matrix((0, 1))
    endless = LP(np.array([-1.0]), empty, nothing, empty, nothing)
    with pytest.raises(TimeLimit, match=f'{solver}: the time limit passed'):
        run(endless, solver, 0.0)
    with pytest.raises(SolverFailed, match=solver):
        run(endless, solver, math.inf)
