# SPDX-License-Identifier: Apache-2.0
"""The exact value by minimum cut: laws, exact rational arithmetic, a linear program, tiny games."""

import numpy as np
import pytest
from games import (
    NASTY,
    connected_flow,
    exact_value,
    examples,
    is_acyclic,
    least_weight,
    networks,
    quiet_network,
    terrain_networks,
    unbalanced,
)
from hypothesis import given
from hypothesis import strategies as st

from ambush_planner import GameOptions
from ambush_planner.game.game import make_game
from ambush_planner.game.value.cut import CutSolution, solve_by_min_cut


def solved(network) -> CutSolution:
    return solve_by_min_cut(make_game(network, GameOptions()))


def check_laws(network, found: CutSolution) -> None:
    """Both players' strategies are strategies, and each guarantees the value."""
    p, q = found.p, found.q
    assert p.min() >= 0.0 and q.min() >= 0.0
    assert q.sum() == pytest.approx(float(found.value > 0.0), abs=1e-12)
    assert unbalanced(network, p) < 1e-12
    visits = np.bincount(network.heads, weights=p, minlength=len(q))
    assert (network.alpha * visits).max() <= found.value * (1 + 1e-9)
    assert least_weight(network, (q * network.alpha)[network.heads]) >= found.value * (1 - 1e-9)
    assert is_acyclic(network, p)
    assert connected_flow(network, p) == pytest.approx(1.0, abs=1e-9)


def check_cut(network, found: CutSolution) -> None:
    """The support of q is a cut, with q in proportion to 1 / alpha."""
    cut = np.flatnonzero(found.q)
    gone = np.isin(network.heads, cut)
    assert least_weight(network, np.where(gone, np.inf, 0.0)) == np.inf
    assert (found.q * network.alpha)[cut] == pytest.approx(found.value, rel=1e-12)


@examples(60)
@given(st.one_of(networks(), networks(alphas=NASTY), terrain_networks))
def test_value_and_strategies_on_any_network(network):
    found = solved(network)
    check_laws(network, found)
    assert found.value == pytest.approx(float(exact_value(network)), rel=1e-9)
    if found.value > 0.0:
        check_cut(network, found)


def line(alphas, edges=None):
    """Nodes in a row, joined one after the other unless ``edges`` says otherwise."""
    n = len(alphas)
    edges = [(k, k + 1) for k in range(n - 1)] if edges is None else edges
    points = np.stack((np.arange(n), np.zeros(n)), axis=1)
    return quiet_network(points, np.array(alphas, float), np.array(edges), 0, n - 1)


@pytest.mark.parametrize(('alphas', 'edges', 'value', 'p'), [
    ([0, 0], None, 0.0, [1]),
    ([0, 5, 0], [(0, 1), (1, 2), (0, 2)], 0.0, [0, 0, 1]),
    ([0, 1, 4, 2, 0], None, 4.0, [1, 1, 1, 1]),
    ([0, 3, 3, 0], None, 3.0, [1, 1, 1]),
    ([0, 9, 0, 0], [(0, 1), (1, 3), (0, 2), (2, 3)], 0.0, [0, 0, 1, 1]),
    # The node of loss 1e-9 takes all but 1e-18 of the flow: 1 / (1e9 + 1e-9).
    ([0, 1e-9, 1e9, 0], [(0, 1), (1, 3), (0, 2), (2, 3)], 1e-9, [1, 1, 0, 0]),
    # Edges into the source and out of the target must not let flow circulate there.
    ([0, 1, 1, 0], [(0, 1), (1, 2), (2, 3), (1, 0), (2, 0), (3, 1), (3, 2), (2, 1)], 1.0, None),
])
def test_tiny_games_solved_by_hand(alphas, edges, value, p):
    found = solved(line(alphas, edges))
    assert found.value == pytest.approx(value, rel=1e-12, abs=0.0)
    assert found.q.sum() == pytest.approx(float(value > 0.0))
    assert p is None or found.p == pytest.approx(p, abs=1e-12)
