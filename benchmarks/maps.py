"""The maps and networks that the benchmarks share."""

from __future__ import annotations

import numpy as np

from ambush_planner import Network, NetworkOptions, RiskMap, build_network
from ambush_planner.arrays import FloatArray

SIDE = 100.0  # of every map [m]


def block(cells: int) -> RiskMap:
    """Two smooth rises of risk and a square obstacle in the middle, ``cells`` x ``cells``."""
    u, v = _unit_square(cells)
    south_east = np.exp(-((u - 0.7) ** 2 + (v - 0.25) ** 2) / 0.08)
    north_west = np.exp(-((u - 0.3) ** 2 + (v - 0.8) ** 2) / 0.05)
    obstacles = (np.abs(u - 0.5) < 0.12) & (np.abs(v - 0.5) < 0.12)
    return RiskMap(1.0 + 4.0 * south_east + 2.0 * north_west, obstacles, SIDE / cells)


def hills(cells: int) -> RiskMap:
    """Terrain of six waves: losses 1..10 by height, the highest tenth is an obstacle."""
    u, v = _unit_square(cells)
    waves = np.random.default_rng(1).normal(size=(6, 3))
    height = sum(np.sin(6.0 * a * u + 6.0 * b * v + 3.0 * c) for a, b, c in waves)
    share = (height - height.min()) / np.ptp(height)
    return RiskMap(1.0 + 9.0 * share, share > np.quantile(share, 0.9), SIDE / cells)


def _unit_square(cells: int) -> tuple[FloatArray, FloatArray]:
    centre = (np.arange(cells) + 0.5) / cells
    u, v = np.meshgrid(centre, centre)
    return u, v


def block_network(nodes: int) -> Network:
    """Delaunay network of ``nodes`` x ``nodes`` over ``block``, mid-left to mid-right."""
    spacing = SIDE / nodes
    start, goal = (0.5 * spacing, 0.5 * SIDE), (SIDE - 0.5 * spacing, 0.5 * SIDE)
    return build_network(block(nodes), start, goal, NetworkOptions(spacing=spacing))


def network_across(risk_map: RiskMap, nodes: int) -> Network:
    """Delaunay network of ``nodes`` x ``nodes`` over a map, between the same two places."""
    start, goal = (0.03 * SIDE, 0.5 * SIDE), (0.97 * SIDE, 0.5 * SIDE)
    return build_network(risk_map, start, goal, NetworkOptions(spacing=SIDE / nodes))
