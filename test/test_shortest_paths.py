"""Shortest paths and reachability compared with networkx."""

import networkx
import numpy as np
import pytest
from games import examples, networks
from hypothesis import given

from ambush_planner.network.shortest_paths import (
    distances_from,
    on_some_route,
    reachable_from,
    shortest_path,
)


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


def test_an_unreachable_node_has_an_empty_path():
    assert len(shortest_path(np.empty((0, 2), np.int64), np.empty(0), 2, 0, 1)) == 0
