# SPDX-License-Identifier: Apache-2.0
"""A strategy on condition that routes avoid some edges, against all routes one by one."""

import math
from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest
from games import drawn_routes, examples
from hypothesis import given
from hypothesis import strategies as st

from ambush_planner.game.distribution.chain import RouteMixture
from ambush_planner.game.hits import law_of
from ambush_planner.planning.conditioning import ConditionedStrategy


def strategy_on(count, edges, flows, source=0, target=None, mixture=None):
    edges = np.array(edges, dtype=np.int64).reshape(-1, 2)
    network = SimpleNamespace(
        points=np.zeros((count, 2)), edges=edges, tails=edges[:, 0], heads=edges[:, 1],
        source=source, target=count - 1 if target is None else target)
    p = np.array(flows, dtype=float)
    return SimpleNamespace(network=network, edge_probability=p, mixture=mixture,
                           law=mixture or law_of(SimpleNamespace(network=network), p))


@st.composite
def strategies(draw):
    """A strategy on all edges forward between some nodes, in a drawn numbering."""
    count = draw(st.integers(2, 6))
    rng = np.random.default_rng(draw(st.integers(0, 10**6)))
    names = rng.permutation(count)
    p, edges, visits = [], [], np.eye(count)[0]
    for tail in range(count - 1):
        heads = [h for h in range(tail + 1, count) if h == count - 1 or rng.random() < 0.6]
        shares = rng.dirichlet(np.ones(len(heads)))
        for head, share in zip(heads, shares, strict=True):
            edges.append((names[tail], names[head]))
            p.append(visits[tail] * share)
            visits[head] += p[-1]
    order = rng.permutation(len(edges))
    made = strategy_on(
        count, np.array(edges)[order], np.array(p)[order], names[0], names[-1])
    lost = draw(st.lists(st.booleans(), min_size=len(edges), max_size=len(edges)))
    return made, np.array(lost)


def routes_of(strategy):
    """Each route as its edges, with its chance."""
    routes = drawn_routes(strategy.network, strategy.edge_probability)
    return [(list(route), chance) for route, chance in routes.items()]


@examples(40)
@given(strategies())
def test_the_share_and_the_flow_are_those_of_the_routes_that_are_left(drawn):
    strategy, lost = drawn
    left = [(route, chance) for route, chance in routes_of(strategy) if not lost[route].any()]
    share, law = ConditionedStrategy(strategy).avoiding(lost)
    assert share == pytest.approx(sum(chance for _, chance in left), abs=1e-12)
    if not left:
        assert law is None
        return
    wanted = np.zeros(len(lost))
    for route, chance in left:
        wanted[route] += chance / share
    np.testing.assert_allclose(law.uses(len(lost)), wanted, atol=1e-9)


def test_a_strategy_with_circles_has_no_condition():
    circle = ConditionedStrategy(
        strategy_on(4, [(0, 1), (1, 2), (2, 1), (2, 3)], [1.0, 1.5, 0.5, 1.0]))
    assert circle.avoiding(np.array([True, False, False, False])) == (0.0, None)
    assert circle.avoiding(np.zeros(4, bool)) == (1.0, circle.strategy.law)


def test_whole_routes_that_are_clear_keep_their_odds():
    edges = [(0, 1), (0, 2), (1, 3), (2, 3), (3, 4), (3, 5), (4, 6), (5, 6)]
    routes = [np.array([0, 2, 4, 6]), np.array([1, 3, 5, 7]), np.array([0, 2, 5, 7])]
    mixture = RouteMixture(routes, np.array([0.5, 0.3, 0.2]), np.zeros(3, int))
    conditioned = ConditionedStrategy(strategy_on(7, edges, mixture.uses(8), mixture=mixture))
    lost = np.arange(8) == 4
    share, law = conditioned.avoiding(lost)
    assert share == pytest.approx(0.5) and law.shares == pytest.approx([0.6, 0.4])
    assert [route.tolist() for route in law.routes] == [[1, 3, 5, 7], [0, 2, 5, 7]]
    assert conditioned.avoiding(lost | (np.arange(8) == 7)) == (0.0, None)


def test_a_rest_is_drawn_in_the_order_of_edges_on_every_machine():
    """So that ``ambush verify`` draws the same one from the recorded entropy."""
    count, rng = 30, np.random.default_rng(0)
    middle, shares = rng.permutation(np.arange(1, count + 1)), rng.dirichlet(np.ones(count))
    edges = [*((0, k) for k in middle), *((k, count + 1) for k in middle)]
    conditioned = ConditionedStrategy(strategy_on(count + 2, edges, [*shares, *shares]))
    lost = np.zeros(2 * count, bool)
    for seed in range(20):
        nodes = conditioned.draw_rest(0, lost, np.random.default_rng(seed))
        drawn = np.random.default_rng(seed).choice(count, p=shares / shares.sum())
        assert nodes.tolist() == [0, middle[drawn], count + 1]


@examples(15)
@given(strategies(), st.data())
def test_the_rest_of_a_route_has_its_conditional_probability(drawn, data):
    """P(rest | it begins at the node and is clear), from all routes one by one."""
    strategy, lost = drawn
    network, conditioned = strategy.network, ConditionedStrategy(strategy)
    node, rng = data.draw(st.sampled_from(range(len(network.points)))), np.random.default_rng(1)
    rests = Counter()
    for route, chance in routes_of(strategy):
        nodes = [network.source, *network.heads[route].tolist()]
        if node in nodes and not lost[route[nodes.index(node):]].any():
            rests[tuple(nodes[nodes.index(node):])] += chance
    if not rests or node == network.target:
        there = conditioned.draw_rest(node, lost, rng)
        assert (there is None) if node != network.target else there.tolist() == [node]
        return
    draws = 400
    found = Counter(tuple(conditioned.draw_rest(node, lost, rng).tolist()) for _ in range(draws))
    assert found.keys() <= rests.keys()
    for rest, chance in rests.items():
        share = chance / rests.total()
        error = math.sqrt(draws * share * (1.0 - share))
        assert found[rest] == pytest.approx(draws * share, abs=5.0 * error + 3.0)
