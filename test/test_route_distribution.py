# SPDX-License-Identifier: Apache-2.0
"""The distribution's entropy against that of Clarabel, a conic solver; what it may use."""

import math

import numpy as np
import pytest
from games import METHODS, PLAIN, examples, networks, paper_example, quiet_network, terrain_network
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse import csc_matrix, csr_matrix, identity, vstack

from ambush_planner import GameOptions, StrategyOptions, solve
from ambush_planner.game.distribution.chain import chain_of

# What the distribution may exceed its limits by, as a share of them and of a budget's slack.
TOLERANCE = 4e-4
DETOURS = (1.05, 1.2, 1.5, np.inf)


def most_route_entropy(network, edges, rows, limits) -> float:
    """Largest -sum p ln(p / x_tail) of a unit flow p on ``edges`` (m,) with ``rows`` p <= limits.

    The test is skipped without Clarabel. NaN where it does not solve it to its own tolerances.
    Variables (p, t); (t_k, p_k, x_tail) in the exponential cone says t_k <= -p_k ln(p_k / x_tail).
    """
    clarabel = pytest.importorskip('clarabel', reason='no clarabel: it lacks a rosdep key')
    n, m = len(network.points), len(edges)
    tail, head = network.edges[edges].T
    ones, each = np.ones(m), np.arange(m)
    out, into = (csr_matrix((ones, (end, each)), shape=(n, m)) for end in (tail, head))
    touched = np.setdiff1d(np.union1d(tail, head), [network.target])
    supply = (touched == network.source).astype(float)
    linear = vstack([(out - into)[touched], csr_matrix(rows)]).tocsc()
    linear.resize((linear.shape[0], 2 * m))
    visits = out[tail].tocsc()  # row k: x of the tail of edge k
    visits.resize((m, 2 * m))
    cones = vstack([identity(2 * m, format='csr'), visits]).tocsr()
    order = np.arange(3 * m).reshape(3, m)[[1, 0, 2]].T.ravel()  # (t, p, x) edge by edge
    matrix = vstack([linear, -cones[order]]).tocsc()
    right = np.concatenate([supply, limits, np.zeros(3 * m)])
    kinds = [clarabel.ZeroConeT(len(supply)), clarabel.NonnegativeConeT(len(limits))]
    kinds += [clarabel.ExponentialConeT()] * m
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_feas = settings.tol_gap_abs = settings.tol_gap_rel = 1e-9
    cost = np.concatenate([np.zeros(m), -np.ones(m)])
    found = clarabel.DefaultSolver(
        csc_matrix((2 * m, 2 * m)), cost, matrix, right, kinds, settings
    ).solve()
    return float(-found.obj_val) if str(found.status) == 'Solved' else np.nan


def greatest_entropy(strategy, value: float, margin: float) -> float:
    """Clarabel's entropy on the strategy's own edges; NaN if it does not find one.

    Losses up to ``value``, by rows that are exact for the strategy itself; lengths up to this share
    of the budget's slack.
    """
    game, network = strategy.game, strategy.network
    edges, rows = np.flatnonzero(strategy.edge_probability > 0.0), game.entering
    if not game.no_reentry:
        chain = chain_of(network, strategy.edge_probability)
        _, found = chain.hits_with_derivatives(chain.network.columns(rows))
        rows = csr_matrix((found.data, chain.network.edge[found.indices], found.indptr), rows.shape)
    rows, limits = rows[:, edges], value / game.loss[game.sites]
    binding = np.flatnonzero((rows.getnnz(axis=1) > 0) & ((limits < 1.0) | (game.reach > 0.0)))
    rows, limits = rows[binding], limits[binding]
    shortest, budget = strategy.shortest_length, strategy.length_budget
    if math.isfinite(budget):
        rows = vstack((rows, csr_matrix(network.lengths[edges] / shortest)))
        limits = np.append(limits, 1.0 + margin * (budget / shortest - 1.0))
    return most_route_entropy(network, edges, rows, limits)


def check_entropy(strategy, missing: float) -> None:
    """At most ``missing`` of the optimum at the strategy's own value is missing, and never less.

    The optimum may use as much less of the limits as a distribution may exceed them by.
    """
    most = greatest_entropy(strategy, strategy.value * (1.0 + 1e-9), 1.0)
    if not math.isnan(most) and strategy.game.no_reentry:
        assert strategy.route_entropy <= most * (1.0 + 1e-6) + 1e-6
    least = greatest_entropy(strategy, strategy.value * (1.0 - 2 * TOLERANCE), 1.0 - 3 * TOLERANCE)
    if not math.isnan(least):
        assert strategy.route_entropy >= least * (1.0 - missing) - 1e-5


@examples(10)
@given(seed=st.integers(0, 10**6), method=st.sampled_from(METHODS), cells=st.integers(6, 16),
       detour=st.sampled_from(DETOURS), slack=st.sampled_from((0.01, 0.1)))
def test_without_a_reach_it_is_the_greatest_within_a_thousandth(method, seed, cells, detour, slack):
    network = terrain_network(seed, method, cells)
    strategy = solve(network, options=StrategyOptions(max_detour=detour, risk_slack=slack))
    check_entropy(strategy, 1e-3)
    most = greatest_entropy(strategy, strategy.lower_bound * (1.0 + slack), 1.0)
    if strategy.lower_bound > 0.0 and not math.isnan(most):
        assert most <= (strategy.route_entropy + strategy.entropy_gap) * (1.0 + 1e-6) + 1e-6
        assert strategy.entropy_gap <= 0.05 * strategy.route_entropy + 0.05


@examples(12)
@given(networks(alphas=PLAIN), st.sampled_from(DETOURS))
def test_on_any_network(network, detour):
    check_entropy(solve(network, options=StrategyOptions(max_detour=detour)), 1e-3)


@examples(10)
@given(st.sampled_from((1.5, 3.0)), st.integers(0, 10**6), st.sampled_from((1.2, np.inf)),
       st.sampled_from((0.01, 0.05)))
def test_with_a_reach_it_is_the_greatest_within_its_own_rows(reach, seed, detour, slack):
    """Rounds end when the entropy grows by less than a thousandth: up to 1 % may be missing."""
    network = terrain_network(seed, cells=12)
    strategy = solve(network, GameOptions(ambush_radius=reach), StrategyOptions(
        max_detour=detour, risk_slack=slack))
    check_entropy(strategy, 1e-2)


def test_the_papers_example():
    """Seven routes, three columns' rows binding at 1/3: by Clarabel 1.90 nats, e^1.90 = 6.7."""
    strategy = solve(paper_example(), options=StrategyOptions(max_detour=np.inf))
    check_entropy(strategy, 1e-3)
    assert strategy.route_entropy == pytest.approx(1.90, abs=0.01)
    assert (strategy.edge_probability > 0.0).all()


@pytest.mark.parametrize(('reach', 'detour'), [(0.0, 1.05), (2.0, 1.2), (0.0, np.inf)])
def test_more_slack_buys_more_entropy(reach, detour):
    """Also much of it: a distribution may not exceed the budget by a share of the slack."""
    network = terrain_network(5, cells=14)
    entropies = [solve(network, GameOptions(ambush_radius=reach), StrategyOptions(
        max_detour=detour, risk_slack=slack)).route_entropy
                 for slack in (0.0, 0.01, 0.1, 0.3)]
    assert all(b > a for a, b in zip(entropies[:-1], entropies[1:], strict=True))


def test_routes_that_avoid_all_sites_have_value_zero():
    points = [[0, 0], [1, 0], [1, 1], [1, -1], [2, 0]]
    network = quiet_network(points, [0, 5, 0, 0, 0], [(0, k) for k in (1, 2, 3)] + [
        (k, 4) for k in (1, 2, 3)], 0, 4)
    strategy = solve(network, options=StrategyOptions(max_detour=2.0))
    assert strategy.value == 0.0 and strategy.lower_bound == 0.0
    assert strategy.route_entropy == pytest.approx(math.log(2.0), abs=1e-9)
    assert strategy.ambush_probability.sum() == pytest.approx(1.0)
    # Too far round: the budget leaves nothing but the site.
    tight = solve(network, options=StrategyOptions(max_detour=1.0))
    assert tight.value == pytest.approx(5.0)
