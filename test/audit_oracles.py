# SPDX-License-Identifier: Apache-2.0
"""Slow, independent answers to what the audit computes."""

from __future__ import annotations

import math
from itertools import pairwise

import networkx
import numpy as np


def routes_with_probabilities(strategy):
    """Every route of a strategy (tuples of nodes) with the probability of its walk."""
    network, p = strategy.network, strategy.edge_probability
    graph = networkx.DiGraph()
    out = np.bincount(network.tails, p, len(network.points))
    for (tail, head), weight in zip(network.edges.tolist(), p, strict=True):
        if weight > 0.0:
            graph.add_edge(tail, head, choice=weight / out[tail])
    paths = networkx.all_simple_paths(graph, network.source, network.target)
    return {
        tuple(path): math.prod(graph.edges[step]['choice'] for step in pairwise(path))
        for path in paths
    }

