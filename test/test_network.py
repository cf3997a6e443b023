# SPDX-License-Identifier: Apache-2.0
"""Networks: bad inputs are named, useless edges dropped with a warning; shortest paths in them."""

import networkx
import numpy as np
import pytest
from games import examples, networks
from hypothesis import given

from ambush_planner import InvalidNetwork, Network
from ambush_planner.network.shortest_paths import (
    distances_from,
    on_some_route,
    reachable_from,
    shortest_path,
)

GOOD = {
    'points': [[0.0, 0.0], [3.0, 4.0], [6.0, 0.0]], 'alpha': [0.0, 2.0, 0.0],
    'edges': [(0, 1), (1, 2)], 'source': 0, 'target': 2,
}


def test_arrays_are_private_and_read_only():
    points = np.array(GOOD['points'])
    network = Network(**{**GOOD, 'points': points})
    points[0, 0] = 9.0
    assert network.points[0, 0] == 0.0
    for name in ('points', 'alpha', 'edges', 'lengths', 'tails', 'heads'):
        with pytest.raises(ValueError, match='read-only'):
            getattr(network, name)[...] = 0
    with pytest.raises(AttributeError):
        network.source = 1


def test_warns_of_dropped_edges_into_the_source_and_out_of_the_target():
    edges = [(1, 0), (0, 1), (2, 1), (1, 2), (2, 0)]
    with pytest.warns(UserWarning, match='3 edges into the source 0 or out of the target 2'):
        network = Network(**{**GOOD, 'edges': edges})
    assert network.edges.tolist() == [[0, 1], [1, 2]]


@pytest.mark.parametrize('change, words', [
    ({'points': [[0, 0]]}, r'points .*\(1, 2\)'),
    ({'points': [[0, 0, 0]] * 3}, r'points .*\(3, 3\)'),
    ({'points': [0, 1, 2]}, r'points .*\(3,\)'),
    ({'points': [[0, 0], [np.nan, 1], [2, 2]]}, r'points .*nan.* node 1'),
    ({'points': [[0, 0], [1], [2, 2]]}, 'points'), ({'points': 'here'}, 'points'),
    ({'points': None}, 'points'), ({'alpha': [0, 1]}, r'alpha .*\(3,\), got \(2,\)'),
    ({'alpha': [[0, 1, 0]]}, r'alpha .*\(1, 3\)'), ({'alpha': [0, -2.5, 0]}, r'alpha .*-2\.5.*1'),
    ({'alpha': [0, np.nan, 0]}, 'alpha .*nan at node 1'), ({'alpha': [0, 'high', 0]}, 'alpha'),
    ({'alpha': [1.5, 1, 0]}, r'alpha\[source\] .*1\.5 at node 0'),
    ({'alpha': [0, 1, 2.5]}, r'alpha\[target\] .*2\.5 at node 2'),
    ({'edges': [(0, 1, 2)]}, r'edges .*\(1, 3\)'), ({'edges': [0, 1]}, r'edges .*\(2,\)'),
    ({'edges': [(0.0, 1.0)]}, 'edges .*float64'), ({'edges': [(True, False)]}, 'edges .*bool'),
    ({'edges': [(0, 1), (1, 3)]}, r'edge 1 \(1, 3\).*0\.\.2'),
    ({'edges': [(0, 1), (-1, 2)]}, r'edge 1 \(-1, 2\).*0\.\.2'),
    ({'edges': [(0, 1), (1, 1), (1, 2)]}, r'edge 1 \(1, 1\).*self-loop'),
    ({'edges': [(0, 1), (1, 2), (0, 1)]}, r'edge 2 \(0, 1\).*duplicate'),
    ({'edges': [(0, 1), (1,)]}, 'edges'), ({'source': 3}, r'source .*0\.\.2, got 3'),
    ({'target': -1}, r'target .*0\.\.2, got -1'), ({'source': 0.0}, r'source .*0\.0'),
    ({'source': True}, 'source'), ({'target': None}, 'target .*None'),
    ({'source': 2}, 'source and target .*2'),
])
def test_rejects_bad_input(change, words):
    with pytest.raises(InvalidNetwork, match=words):
        Network(**{**GOOD, **change})


@examples(25)
@given(networks())
def test_distances_a_path_and_reachability(network):
    n, ends = len(network.points), (network.source, network.target)
    weights = network.alpha[network.heads]  # some of them 0: an edge of weight 0 is an edge
    graph = networkx.DiGraph()
    graph.add_nodes_from(range(n))
    graph.add_weighted_edges_from(zip(*network.edges.T.tolist(), weights.tolist(), strict=True))
    ahead = distances_from(network.edges, weights, n, ends[0])
    behind = distances_from(network.edges[:, ::-1], weights, n, ends[1])
    from_source = networkx.single_source_dijkstra_path_length(graph, ends[0])
    to_target = networkx.single_source_dijkstra_path_length(graph.reverse(), ends[1])
    assert ahead == pytest.approx([from_source.get(k, np.inf) for k in range(n)])
    assert behind == pytest.approx([to_target.get(k, np.inf) for k in range(n)])
    path = shortest_path(network.edges, weights, n, *ends).tolist()
    assert networkx.path_weight(graph, path, 'weight') == pytest.approx(ahead[ends[1]])
    reached = networkx.descendants(graph, ends[0]) | {ends[0]}
    leading = networkx.ancestors(graph, ends[1]) | {ends[1]}
    assert set(np.flatnonzero(reachable_from(network.edges, n, ends[0]))) == reached
    assert set(np.flatnonzero(on_some_route(network.edges, n, *ends))) == reached & leading
