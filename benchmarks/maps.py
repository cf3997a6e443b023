"""The maps and networks that the benchmarks share."""

from __future__ import annotations

import numpy as np

from ambush_planner import Network, NetworkOptions, RiskMap, build_network

SIDE = 100.0  # of the square map [m]


def terrain(cells: int) -> RiskMap:
    """Two hills of risk and a square obstacle in the middle, on ``cells`` x ``cells`` cells."""
    centre = (np.arange(cells) + 0.5) / cells
    v, u = np.meshgrid(centre, centre, indexing="ij")
    south_east = np.exp(-((u - 0.7) ** 2 + (v - 0.25) ** 2) / 0.08)
    north_west = np.exp(-((u - 0.3) ** 2 + (v - 0.8) ** 2) / 0.05)
    block = (np.abs(u - 0.5) < 0.12) & (np.abs(v - 0.5) < 0.12)
    return RiskMap(1.0 + 4.0 * south_east + 2.0 * north_west, block, SIDE / cells)


def network_across(nodes: int, risk_map: RiskMap | None = None) -> Network:
    """Delaunay network on a lattice of ``nodes`` x ``nodes``, mid-left to mid-right.

    Without a map the lattice's nodes are the centres of ``terrain``'s cells.
    """
    spacing = SIDE / nodes
    start, goal = (0.5 * spacing, 0.5 * SIDE), (SIDE - 0.5 * spacing, 0.5 * SIDE)
    if risk_map is not None:
        start, goal = (0.03 * SIDE, 0.5 * SIDE), (0.97 * SIDE, 0.5 * SIDE)
    return build_network(
        risk_map or terrain(nodes), start, goal, NetworkOptions(spacing=spacing)
    )
