# SPDX-License-Identifier: Apache-2.0
"""P(hit) of a Markov chain and its derivatives, against the enumeration of all routes."""


import numpy as np
import pytest
from games import examples, planar_network, routes_of
from hypothesis import given
from hypothesis import strategies as st

from ambush_planner import GameOptions
from ambush_planner.game.distribution import triangular
from ambush_planner.game.distribution.acyclic import acyclic_subnetwork, positions_by
from ambush_planner.game.distribution.chain import MarkovChain
from ambush_planner.game.distribution.gibbs import acyclic_network
from ambush_planner.game.game import make_game
from ambush_planner.game.hits import law_of
from ambush_planner.network.network import Network


def small_grid(seed: int) -> Network:
    """An 8-connected grid of 3 x 4 places: links cross, and discs are entered again and again."""
    rng = np.random.default_rng(seed)
    points = np.argwhere(np.ones((4, 3))) + rng.uniform(-0.1, 0.1, (12, 2))
    step = np.abs(np.round(points[:, None]) - np.round(points)).max(axis=2)
    edges = [(a, b) for a, b in np.argwhere(step == 1).tolist() if b != 0 and a != 11]
    return Network(points, np.r_[0.0, rng.choice([1.0, 2.0, 5.0], 10), 0.0], edges, 0, 11)


class Case:
    """A game with discs, an acyclic part of it in a random order, and all of that part's routes."""

    def __init__(self, seed: int, reach: float) -> None:
        self.rng = np.random.default_rng(seed)
        network = small_grid(seed) if seed % 3 == 0 else planar_network(seed)
        secured = [0.0, -1.0][seed % 2]
        self.game = make_game(network, GameOptions(ambush_radius=reach, secured_radius=secured))
        ahead, part = self.game.distances_from_source(network.lengths), None
        while part is None:
            order = ahead + self.rng.uniform(0.0, 2.0, len(ahead)) * self.rng.integers(0, 2)
            order[[network.source, network.target]] = -np.inf, np.inf
            position = positions_by(order)
            part = acyclic_subnetwork(self.game, position)
        self.network = acyclic_network(network, np.flatnonzero(part.playable), position)
        self.entering = self.network.columns(self.game.entering)
        place = {edge: k for k, edge in enumerate(self.network.edge.tolist())}
        self.routes = [[place[edge] for edge in route] for route in routes_of(network)
                       if all(edge in place for edge in route)]

    def strategy(self) -> np.ndarray:
        """A random strategy p (m,), in which some edges are never used."""
        share = self.rng.random(len(self.network.edge))
        share = np.where(self.rng.random(len(share)) < 0.2, 0.0, share)
        total = np.bincount(self.network.tail, share)[self.network.tail]
        count = np.bincount(self.network.tail)[self.network.tail]
        share = np.where(total > 0.0, share / np.where(total > 0.0, total, 1.0), 1.0 / count)
        used = np.zeros(len(share))
        for route in self.routes:
            used[route] += share[route].prod()
        return used

    def by_enumeration(self, p: np.ndarray) -> tuple[np.ndarray, float]:
        """P(hit) (S,), each route counted once, and the entropy of the routes."""
        leaving = np.bincount(self.network.tail, p)[self.network.tail]
        share = np.where(p > 0.0, p / np.where(leaving > 0.0, leaving, 1.0), 0.0)
        likely = np.array([share[route].prod() for route in self.routes])
        met = np.array([self.entering[:, route].getnnz(axis=1) > 0 for route in self.routes])
        some = likely[likely > 0.0]
        return likely @ met, float(-(some * np.log(some)).sum())


cases = st.builds(Case, st.integers(0, 10**6), st.sampled_from((0.0, 0.3, 0.7, 1.2, 2.0)))


@examples(12)
@given(cases)
def test_hits_entropy_and_derivatives_are_those_of_all_routes(case):
    """The derivatives towards another strategy; rows add up to the hits."""
    p, other = case.strategy(), case.strategy()
    p = 0.9 * p + 0.1 * other  # so that the difference keeps every edge's sign
    chain, (by_hand, entropy) = MarkovChain(case.network, p), case.by_enumeration(p)
    assert chain.hits(case.entering) == pytest.approx(by_hand, abs=1e-12)
    assert chain.entropy == pytest.approx(entropy, abs=1e-9)
    most = chain.meets_at_most(case.game.entering)
    assert (by_hand <= most + 1e-12).all()
    assert (most <= np.minimum(case.entering @ p, 1.0) + 1e-12).all()
    whole = np.zeros(len(case.game.network.edges))
    whole[case.network.edge] = p
    assert law_of(case.game, whole).meets(case.game.entering) == pytest.approx(by_hand, abs=1e-12)
    hits, rows = chain.hits_with_derivatives(case.entering)
    assert hits == pytest.approx(by_hand, abs=1e-12)
    assert rows @ p == pytest.approx(hits, abs=1e-12)
    ahead, behind = (case.by_enumeration(p + h * (other - p))[0] for h in (1e-5, -1e-5))
    assert rows @ (other - p) == pytest.approx((ahead - behind) / 2e-5, abs=1e-7)


@examples(10)
@given(cases)
def test_without_rare_edges_the_other_routes_are_as_likely_as_before(case):
    often, seldom = case.strategy(), case.strategy()
    chain = MarkovChain(case.network, (1.0 - 1e-13) * often + 1e-13 * seldom).without_rare()
    assert not chain.p[often == 0.0].any()
    assert chain.p == pytest.approx(often, abs=1e-12)
    inner = (case.network.head > 0) & (case.network.head < case.network.count - 1)
    arriving, leaving = (np.bincount(nodes, chain.p, case.network.count)[case.network.head[inner]]
                         for nodes in (case.network.head, case.network.tail))
    assert arriving == pytest.approx(leaving, abs=1e-15)


def test_without_scipys_product_in_place_the_chain_is_the_same(monkeypatch):
    """That product is a private function, which a version of scipy may lack."""
    case = Case(3, 1.2)
    chain = MarkovChain(case.network, case.strategy())
    hits, rows = chain.hits_with_derivatives(case.entering)
    monkeypatch.setattr(triangular, 'csr_matvecs', None)
    slow_hits, slow_rows = chain.hits_with_derivatives(case.entering)
    assert slow_hits == pytest.approx(hits) and slow_hits.max() > 0.0
    assert slow_rows.toarray() == pytest.approx(rows.toarray())


def test_scipys_product_is_tried_before_it_is_used(monkeypatch):
    """One that reads its input before it writes would be wrong in silence."""
    assert triangular._goes_by_rows()

    def reads_first(rows, columns, count, first, column, entries, x, y):
        before = x.reshape(columns, count).copy()
        for row in range(rows):
            some = slice(first[row], first[row + 1])
            y[row * count : (row + 1) * count] += entries[some] @ before[column[some]]

    for changed in (reads_first, lambda: None):
        monkeypatch.setattr(triangular, 'csr_matvecs', changed)
        assert not triangular._goes_by_rows()
