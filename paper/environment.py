# SPDX-License-Identifier: Apache-2.0
"""The environment of the repeated experiments, which is our choice.

The paper publishes neither its risk map nor its start and goal. Its figures show about 30 x 30
nodes, a square obstacle in the centre, high alpha in the south-east, and a journey from side to
side. Here

* the map is a square of ``SIDE`` = 31 m in cells of 0.2 m, with 31 x 31 lattice nodes 1 m apart:
  the lengths of the paper's table III, 31.24 = 27 + 3 sqrt(2) and 40.87 = 14 + 19 sqrt(2), are
  those of such steps;
* alpha(x, y) = 2 + 2 (1 - y / 31) + 6 exp(-((x - 22)^2 + (y - 8)^2) / (2 * 5.5^2)): a gentle fall
  from south to north and one hill in the south-east; from 2.0 to 9.5 over the map;
* the obstacle is the square 13 < x, y < 18;
* start (0.5, 15.5) is in the west, goal (30.5, 11.5) in the east: the shortest route runs south of
  the obstacle across the flank of the hill, the one with low losses north of it.

The numbers were chosen among a few dozen to reproduce the pattern of the paper's table III (value
near 1, fixed routes several times worse, the risk avoiding route about 1.3 times the shortest);
they are not fitted to it.
"""

from __future__ import annotations

import numpy as np

from ambush_planner.maps.risk_map import RiskMap
from ambush_planner.network.construction import NetworkOptions, build_network
from ambush_planner.network.network import Network

SIDE = 31.0
RESOLUTION = 0.2
SPACING = 1.0
OBSTACLE_SIDE = 5.0
MIN_ALPHA, SLOPE = 2.0, 2.0
HILL, HILL_CENTRE, HILL_WIDTH = 6.0, (22.0, 8.0), 5.5
START, GOAL = (0.5, 15.5), (30.5, 11.5)
# Random sampling of Method 1.
SEED = 0

# Alpha above which the figures are dark.
HIGH_ALPHA = 5.0
# Thresholds of figure 7, from hardly any effect to a single node that all routes pass.
THRESHOLDS = (7.0, 6.0, 5.0, 4.5)
# Radius around start and goal without ambushes, for one of our strategies [m].
SECURED_RADIUS = 5.0

EXAMPLE = '8 nodes'
# The paper's table I.
METHODS = {
    'Method 1': 'random_delaunay',
    'Method 2': 'uniform_grid8',
    'Method 3': 'lattice_delaunay',
}


def make_risk_map() -> RiskMap:
    """Return the risk map described at the top of this file."""
    centre = (np.arange(round(SIDE / RESOLUTION)) + 0.5) * RESOLUTION
    x, y = np.meshgrid(centre, centre)
    squared = (x - HILL_CENTRE[0]) ** 2 + (y - HILL_CENTRE[1]) ** 2
    alpha = MIN_ALPHA + SLOPE * (1.0 - y / SIDE)
    alpha += HILL * np.exp(-squared / (2.0 * HILL_WIDTH**2))
    middle, half = SIDE / 2, OBSTACLE_SIDE / 2
    obstacles = (np.abs(x - middle) < half) & (np.abs(y - middle) < half)
    return RiskMap(alpha, obstacles, RESOLUTION)


def make_networks(risk_map: RiskMap) -> dict[str, Network]:
    """Return the four networks of the paper's table II by name."""
    networks = {EXAMPLE: make_example()}
    for name, method in METHODS.items():
        options = NetworkOptions(method, SPACING, seed=SEED)
        networks[name] = build_network(risk_map, START, GOAL, options)
    return networks


def make_example() -> Network:
    """Return the paper's figure 1: 8 nodes, 13 edges, alpha 1 inside, 7 routes.

    The paper states these numbers and draws the network. They match two columns of three nodes,
    joined along the rows and to the neighbouring rows.
    """
    points = [(0, 1), *((1, k) for k in range(3)), *((2, k) for k in range(3)), (3, 1)]
    edges = [(0, k) for k in (1, 2, 3)] + [(k, 7) for k in (4, 5, 6)]
    edges += [(1 + i, 4 + j) for i in range(3) for j in range(3) if abs(i - j) <= 1]
    alpha = np.array([0, 1, 1, 1, 1, 1, 1, 0], dtype=np.float64)
    return Network(np.array(points, dtype=np.float64), alpha, np.array(edges), 0, 7)
