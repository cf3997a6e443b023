# SPDX-License-Identifier: Apache-2.0
"""The LP in face potentials: against linear programs, in parts, and its flows.

Its value is compared with that of all mixtures of routes in test_reach.
"""

import math

import numpy as np
import pytest
from games import (
    examples,
    least_weight,
    lp_value,
    reached,
    routes_of,
    terrain_network,
    value_by_routes,
)
from hypothesis import given
from hypothesis import strategies as st

from ambush_planner import GameOptions, Network
from ambush_planner.game.ambusher import Ambusher
from ambush_planner.game.budget import length_budget
from ambush_planner.game.certificate.certificate import lower_bounds
from ambush_planner.game.faces import make_faces
from ambush_planner.game.game import make_game
from ambush_planner.game.legs import Legs
from ambush_planner.game.value.potential import POTENTIAL, Potential


def one_leg(game, detour=np.inf) -> Legs:
    return Legs((game,), (length_budget(game, detour),))


def lp_of(legs, gap=1e-3) -> Potential:
    """The LP of a leg, solved."""
    lp = Potential(legs, make_faces(legs.games[0]), gap)
    lp.solve(math.inf)
    return lp


@examples(10)
@given(st.integers(0, 10**6), st.sampled_from((1.02, 1.2, np.inf)),
       st.sampled_from(('uniform_delaunay', 'random_delaunay', 'lattice_delaunay')))
def test_without_a_reach_the_value_is_that_of_the_linear_program(seed, detour, method):
    network = terrain_network(seed, method, 14)
    lp = lp_of(one_leg(make_game(network, GameOptions()), detour))
    least = lp_value(network, detour * least_weight(network, network.lengths))
    assert least * (1.0 - POTENTIAL.precision) <= lp.bound <= least * (1.0 + 1e-6)


def test_a_ring_of_discs_that_winds_twice_beats_one_that_winds_once():
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
    near = reached(network, 2.5, 0.4)
    assert value_by_routes(alpha, near, routes_of(network)) == pytest.approx(2 / 5)
    lp = lp_of(one_leg(game))
    assert lp.bound == pytest.approx(2 / 5, rel=POTENTIAL.precision)
    (curves,) = lp.ambush.ambusher(game, np.ones(len(game.sites), dtype=bool)).circulations
    q = np.repeat([0.0, 0.2, 0.0], [21, 5, 1])
    for ambusher in Ambusher(q, (0.0,)), Ambusher(q, (0.0,), (curves,)):
        assert lower_bounds(one_leg(game), ambusher) == pytest.approx(2 / 5)


def test_links_that_cross_or_are_one_way_have_no_faces():
    points = [[0, 0], [1, 1], [0, 1], [1, 0]]
    pairs = [(0, 1), (2, 3), (0, 2), (1, 2), (1, 3), (0, 3)]
    edges = [e for a, b in pairs for e in ((a, b), (b, a)) if e[1] != 0 and e[0] != 1]
    game = make_game(Network(points, [0, 0, 1, 1], edges, 0, 1), GameOptions(ambush_radius=0.1))
    assert make_faces(game) is None
    one_way = [e for e in edges if e not in ((0, 1), (3, 2))]
    game = make_game(Network(points, [0, 0, 1, 1], one_way, 0, 1), GameOptions(ambush_radius=0.1))
    assert make_faces(game) is None
