"""The value with a reach, against all routes, against chains of discs, and against drawn routes."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import networkx
import numpy as np
import pytest
from games import examples, geometric_hits, hit_once, may_wait, meets, terrain_network
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linprog
from scipy.sparse import csr_matrix
from scipy.spatial import Delaunay

from ambush_planner import (
    GameOptions,
    Network,
    NetworkOptions,
    RiskMap,
    StrategyOptions,
    build_network,
    solve,
)
from ambush_planner.game import best_response
from ambush_planner.game.certificate.certificate import hit_bound
from ambush_planner.game.disc_chain import chain_ambusher
from ambush_planner.game.entries import entry_value
from ambush_planner.game.face_program import FaceProgram
from ambush_planner.game.value.faces import make_faces
from ambush_planner.game.game import make_game
from ambush_planner.game.route_program import solve_on_routes
from ambush_planner.game.route_sampler import route_edges
from ambush_planner.game.strategy import make_budgets

ROUTES = 10_000
# Chance that any of the sites exceeds the value by luck: 5 standard deviations for each.
DEVIATIONS = 5.0
EXACT = StrategyOptions(max_detour=np.inf, risk_slack=0.0)


@examples(40)
@given(st.integers(0, 10**6), st.floats(0.2, 1.2), st.sampled_from([-1.0, 0.0, 0.5, 2.0]))
def test_value_and_bound_enclose_the_value_over_all_routes_which_is_the_chains(seed, reach, held):
    """And the bound is that value; so is the strategy's if its gap closes."""
    game = GameOptions(ambush_radius=reach, secured_radius=held)
    held = game.held_radius
    network = planar_network(seed)
    routes = routes_of(network)
    if len(routes) > 4000 or frozenset((network.source, network.target)) in {
        frozenset(e) for e in network.edges.tolist()
    }:
        return
    near = reached(network, reach, held)
    once, chain = value_by_routes(network, near, routes), value_by_chain(network, near)
    certain = np.all([near[:, route].any(axis=1) for route in routes], axis=0)
    chain = max(chain, network.alpha[certain].max(initial=0.0))
    assert once == pytest.approx(chain, abs=1e-7)
    strategy = solve(network, game, EXACT)
    assert strategy.lower_bound == pytest.approx(once, rel=1e-5, abs=1e-7)
    assert strategy.value >= once * (1 - 1e-7)
    if not strategy.counting_gap:
        assert strategy.value == pytest.approx(once, rel=2e-5, abs=1e-7)


@examples(20)
@given(st.integers(0, 10**6), st.floats(0.0, 2.0), st.sampled_from((1.1, np.inf)))
def test_the_optimum_never_falls_when_the_reach_grows(seed, held, detour):
    network = terrain_network(seed, cells=9)
    options = StrategyOptions(max_detour=detour)
    bound = 0.0
    for reach in (0.0, 0.7, 1.5, 3.0, 6.0):
        strategy = solve(network, GameOptions(reach, held), options)
        assert strategy.value >= bound * (1.0 - 1e-6)
        bound = max(bound, strategy.lower_bound)


def at_nodes(game, q):
    """The ambusher's strategy (N,) from that of the sites."""
    found = np.zeros(game.node_count)
    found[game.sites] = q
    return found


@examples(60)
@given(st.integers(0, 10**6), st.floats(0.2, 1.5))
def test_the_cheapest_chain_gives_the_value_over_all_routes_wherever_the_ends_are(seed, reach):
    network = planar_network(seed, inside=True)
    routes = routes_of(network)
    if not 0 < len(routes) <= 1000:
        return
    game = make_game(network, GameOptions(ambush_radius=reach))
    once = value_by_routes(network, reached(network, reach, reach), routes)
    faces = make_faces(game)
    found = chain_ambusher([faces]) if faces.touched.nnz else None
    assert (found is None) == (once < 1e-9)
    if found is not None:
        assert hit_bound(game, at_nodes(game, found.q)) == pytest.approx(once, rel=1e-6)


@examples(40)
@given(st.integers(0, 10**6), st.floats(0.2, 1.5), st.sampled_from((1.02, 1.1, 1.3)))
def test_level_lines_attain_the_value_over_all_routes_within_a_budget(seed, reach, detour):
    """And their ambusher proves it, unless a route meets a disc twice as a spiral does."""
    network = planar_network(seed, inside=True)
    routes = routes_of(network)
    if not 0 < len(routes) <= 1000:
        return
    game, options = make_game(network, GameOptions(ambush_radius=reach)), StrategyOptions()
    budgets = make_budgets(game, replace(options, max_detour=detour))
    once = value_by_routes(network, reached(network, reach, reach), routes, budgets[0].limit)
    faces = make_faces(game)
    chain = chain_ambusher([faces]) if faces.touched.nnz else None
    if chain is None:
        return
    q = at_nodes(game, chain.q)
    program = FaceProgram(faces, budgets[0], hit_bound(game, q), 1e-6, np.inf)
    strips = [program.solve(width) for width in (1.0, 3.0, np.inf)]
    values, found = [strip.value for strip in strips], strips[-1]
    assert values[0] >= values[1] * (1 - 1e-4) and values[1] >= values[2] * (1 - 1e-4)
    prices = (found.price, 0.0)
    bound = hit_bound(game, q if found.q is None else found.q, budgets, prices)
    assert bound <= once * (1 + 1e-6)
    assert bound == pytest.approx(once, rel=1e-4)
    assert budgets[0].mean(found.p) <= budgets[0].limit * (1 + 1e-4)


@examples(40)
@given(st.integers(0, 10**6), st.floats(0.2, 1.5), st.integers(2, 4))
def test_chains_give_the_value_over_all_routes_against_several_ambushers(seed, reach, ambushers):
    network = planar_network(seed)
    routes = routes_of(network)
    if not 0 < len(routes) <= 1000:
        return
    game = make_game(network, GameOptions(ambush_radius=reach, ambushers=ambushers))
    once = value_by_routes(network, reached(network, reach, reach), routes, ambushers=ambushers)
    faces = make_faces(game)
    found = chain_ambusher([faces]) if faces.touched.nnz else None
    assert (found is None) == (once < 1e-9)
    if found is not None:
        assert found.value == pytest.approx(once, rel=1e-6)
        assert found.q.max() <= 1.0 + 1e-9 and found.q.sum() <= ambushers + 1e-9
        worst = np.sort(found.level)[-ambushers:]
        assert worst.sum() >= once * (1.0 - 1e-6)


def test_an_ambusher_whom_no_known_route_meets_is_not_counted_elsewhere():
    """Two ambushers, two sites, and a road past one of them."""
    network = Network([[0, 0], [2, 0], [4, 0], [2, 9]], [0, 3, 0, 1], [(0, 1), (1, 2)], 0, 2)
    game = make_game(network, GameOptions(ambush_radius=0.5, ambushers=2))
    found = solve_on_routes(game, [np.array([0, 1])], (), np.array([0.0, 0.5, 0.5, 1.0]), (),
                            1e-3, np.inf)
    assert found.q.tolist() == [0.0, 1.0, 0.0, 1.0]
    assert found.bound == found.value == pytest.approx(3.0)


def test_links_that_cross_have_no_faces():
    points = [[0, 0], [1, 1], [0, 1], [1, 0]]
    pairs = [(0, 1), (2, 3), (0, 2), (1, 2), (1, 3), (0, 3)]
    edges = [e for a, b in pairs for e in ((a, b), (b, a)) if e[1] != 0 and e[0] != 1]
    game = make_game(Network(points, [0, 0, 1, 1], edges, 0, 1), GameOptions(ambush_radius=0.1))
    assert make_faces(game) is None


@examples(40)
@given(st.integers(0, 10**6), st.floats(0.5, 2.0), st.floats(0.0, 2.0), st.booleans())
def test_the_best_response_is_the_best_of_all_routes_and_merged_labels_bound_it(
    seed, reach, price, cut_short
):
    rng, network = np.random.default_rng(seed), planar_network(seed)
    game = make_game(network, GameOptions(ambush_radius=reach))
    q = np.zeros(game.node_count)
    q[game.sites] = rng.random(len(game.sites)) * (rng.random(len(game.sites)) < 0.7)
    budgets = make_budgets(game, StrategyOptions(max_detour=1.1))[:1]
    routes = routes_of(network)
    if len(routes) > 1000:
        return
    met = np.array([(game.hits[:, route].getnnz(axis=1) > 0) for route in routes])
    over = np.array([budgets[0].excess[route].sum() - budgets[0].margin for route in routes])
    costs = met @ (game.loss * q)[game.sites] + price * over
    with pytest.MonkeyPatch.context() as patch:
        if cut_short:
            patch.setattr(best_response, 'SEARCHES', best_response.SEARCHES[:2])
        found = best_response.best_response(game, q, budgets, (price,))
    assert found.bound <= max(costs.min(), 0.0) + 1e-9
    assert sorted(found.edges.tolist()) in [sorted(route) for route in routes]
    if not cut_short:
        assert found.bound == pytest.approx(max(costs.min(), 0.0), abs=1e-9)
    assert found.bound >= price * over.min() - 1e-9


def test_a_route_that_comes_back_to_a_disc_is_hit_once():
    # A hairpin: in, out and in again of the disc around node 3.
    points = [[0, -3], [0.2, 0], [4, 0.5], [0, 0.5], [0.2, 1.0], [0, 4]]
    edges = [(0, 1), (1, 2), (2, 4), (4, 5)]
    network = Network(points, [0, 0, 0, 3.0, 0, 0], edges, 0, 5)
    strategy = solve(network, GameOptions(ambush_radius=1.0), EXACT)
    assert entry_value(strategy.game, strategy.edge_probability) == pytest.approx(6.0)
    assert strategy.value == pytest.approx(3.0) and strategy.lower_bound == pytest.approx(3.0)


@examples(12)
@given(st.integers(0, 10**6), st.floats(0.8, 3.0), st.sampled_from((1.2, np.inf)))
def test_the_value_is_the_worst_loss_with_each_route_counted_once(seed, reach, detour):
    network = terrain_network(seed, cells=11)
    strategy = solve(network, GameOptions(ambush_radius=reach), StrategyOptions(max_detour=detour))
    hits = geometric_hits(network, reach).toarray() > 0.0
    losses = network.alpha * hit_once(network, strategy.edge_probability, hits)
    assert strategy.value == pytest.approx(losses.max(), rel=1e-9, abs=1e-12)


def hilly_network(nodes_across: int) -> Network:
    """A 100 m square with a smooth risk and a block in the middle, mid-left to mid-right."""
    cells = 100
    v, u = np.meshgrid(*2 * [(np.arange(cells) + 0.5) / cells], indexing='ij')
    alpha = 1 + 4 * np.exp(-((u - 0.7) ** 2 + (v - 0.25) ** 2) / 0.08)
    block = (np.abs(u - 0.5) < 0.12) & (np.abs(v - 0.5) < 0.12)
    return build_network(
        RiskMap(alpha, block, 1.0),
        (3.0, 50.0),
        (97.0, 50.0),
        NetworkOptions(spacing=cells / nodes_across),
    )


@pytest.mark.parametrize('radius', [0.0, 10.0])
def test_no_site_is_hit_more_often_than_the_value_allows(radius):
    strategy = solve(hilly_network(20), GameOptions(ambush_radius=radius, secured_radius=12.0))
    network, rng = strategy.network, np.random.default_rng(7)
    near = (reached(network, radius, 12.0) if radius else
            np.equal.outer(np.arange(len(network.points)), network.heads))
    used = [route_edges(network, route) for route in strategy.sample_routes(ROUTES, rng)]
    which = np.repeat(np.arange(ROUTES), [len(edges) for edges in used])
    shape = (ROUTES, len(network.edges))
    drives = csr_matrix((np.ones(len(which)), (which, np.concatenate(used))), shape=shape)
    hits = np.asarray((drives @ csr_matrix(near.T.astype(float)) > 0).sum(axis=0)).ravel()
    frequency = hits / ROUTES
    error = np.sqrt(np.maximum(frequency * (1 - frequency), 1 / ROUTES) / ROUTES)
    loss = strategy.game.loss
    assert (loss * (frequency - DEVIATIONS * error) <= strategy.value).all()


def test_a_ring_of_discs_that_winds_twice_beats_the_chain_that_winds_once():
    """Five sites around the start, each over two fifths of the ways out: 2/5, not 1/3."""
    turn = np.arange(10) * np.pi / 5
    ring = np.stack((np.cos(turn), np.sin(turn)), axis=1)
    aim = (np.arange(5) * 4 + 3) * np.pi / 10
    sites = 3.0 * np.stack((np.cos(aim), np.sin(aim)), axis=1)
    points = np.vstack(([[0.0, 0.0]], 2.0 * ring, 6.0 * ring, sites, [[9.0, 0.0]]))
    pairs = [(0, k) for k in range(1, 11)] + [(k, k + 10) for k in range(1, 11)]
    pairs += [(11 + k, 11 + (k + 1) % 10) for k in range(10)] + [(11, 26)]
    edges = [e for a, b in pairs for e in ((a, b), (b, a)) if e[1] != 0 and e[0] != 26]
    alpha = np.zeros(27)
    alpha[21:26] = 1.0
    network = Network(points, alpha, edges, 0, 26)
    game = make_game(network, GameOptions(ambush_radius=2.5, secured_radius=0.4))
    chain = chain_ambusher([make_faces(game)])
    assert hit_bound(game, at_nodes(game, chain.q)) == pytest.approx(1 / 3)
    once = value_by_routes(network, reached(network, 2.5, 0.4), routes_of(network))
    assert once == pytest.approx(2 / 5)
    assert hit_bound(game, np.repeat([0.0, 0.2, 0.0], [21, 5, 1])) == pytest.approx(once)
