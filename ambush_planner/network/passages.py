# SPDX-License-Identifier: Apache-2.0
"""Passages too narrow for a network's mesh, found on the cells of the map itself."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy  # loads ndimage when it is used
from scipy.spatial import cKDTree

from ..arrays import BoolArray, FloatArray, IndexArray
from ..maps.obstacles import ObstacleField
from ..maps.risk_map import RiskMap
from .shortest_paths import shortest_path

# Maximum distance from any point to the nearest lattice node [spacings]. Along a line
# with that much free space around it, the nodes next to it are joined.
MAX_NODE_DISTANCE = 1.1
# Additional cost of the narrowest cells, relative to that of the widest.
NARROW_COST = 10.0
# Least distance of the obstacles on either side of a pass, in margins; 2 in a straight corridor.
# In the corner of a room it is less.
OPPOSITE = 1.6
# Distance of nodes along a passage, as a share of its margin.
NODE_DISTANCE = 0.7


def widest_cell_path(risk_map: RiskMap, field: ObstacleField, uv_ends: FloatArray,
                     clearance: float) -> tuple[FloatArray, FloatArray]:
    """The widest path over cells: centres (K, 2) in map axes and their margins (K,) [m].

    Consecutive cells share a side, and their centres keep the clearance; the margin is the distance
    to obstacles in excess of it. Empty if no path joins the two ``uv_ends`` (2, 2).
    """
    free = _free_cells(risk_map, field, clearance)
    ends = np.stack(risk_map.cells(uv_ends), axis=1)
    free[tuple(ends.T)] = True
    regions = scipy.ndimage.label(free)[0]
    if regions[tuple(ends[0])] != regions[tuple(ends[1])]:
        return np.empty((0, 2)), np.empty(0)
    passable = np.pad(~risk_map.obstacles, 1, constant_values=not field.clear_of_edge)
    margin = scipy.ndimage.distance_transform_edt(passable)[1:-1, 1:-1] - 0.5
    margin = np.asarray(margin * risk_map.resolution - clearance, dtype=np.float64)
    cells = _cheapest_cell_path(regions == regions[tuple(ends[0])], margin, ends)
    return _centres(risk_map, cells), margin[tuple(cells.T)]


def passage_nodes(path: FloatArray, margin: FloatArray, spacing: float) -> FloatArray:
    """Nodes (K, 2) along the narrow parts of a path over cells, closer where it is narrower.

    Together with the lattice nodes they connect the path's ends.
    """
    chosen: list[int] = []
    last = -2
    for k in np.flatnonzero(margin < MAX_NODE_DISTANCE * spacing).tolist():
        distance = np.hypot(*(path[k] - path[chosen[-1]])) if k == last + 1 else np.inf
        if distance >= NODE_DISTANCE * margin[k]:
            chosen.append(k)
        last = k
    return path[chosen]


def pass_nodes(risk_map: RiskMap, field: ObstacleField, clearance: float,
               wanted: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """Nodes (K, 2) in map axes along the middle of all passes that the lattice may miss.

    Those are narrower than ``MAX_NODE_DISTANCE`` times the spacing that is ``wanted`` on each side,
    and wider than a block of cells (``obstacle_blocks``).
    """
    obstacles, block = risk_map.obstacle_blocks
    passable = np.pad(~obstacles, 1, constant_values=not field.clear_of_edge)
    distance, nearest = scipy.ndimage.distance_transform_edt(passable, return_indices=True)
    ridge = passable & ~scipy.ndimage.binary_opening(passable, np.ones((2, 2)))  # one cell wide
    for axis in (0, 1):
        one, other = (tuple(slice(k, n - 1 + k) if each == axis else slice(None)
                            for each, n in enumerate(passable.shape)) for k in (0, 1))
        between = np.hypot(*(each[one] - each[other] for each in nearest))
        far = between > OPPOSITE * np.maximum(distance[one], distance[other])
        ridge[one] |= far & (distance[one] >= distance[other])
        ridge[other] |= far & (distance[one] < distance[other])
    cells = np.argwhere(ridge[1:-1, 1:-1])
    uv, side = block * _centres(risk_map, cells), block * risk_map.resolution
    margin = (distance[1:-1, 1:-1][tuple(cells.T)] - 0.5) * side - clearance
    narrow = (margin > 0.0) & (margin < MAX_NODE_DISTANCE * wanted(uv))
    order = np.flatnonzero(narrow)[np.argsort(-margin[narrow], kind='stable')]
    uv, chosen = uv[order], np.ones(len(order), dtype=bool)
    for k, near in enumerate(cKDTree(uv).query_ball_point(uv, NODE_DISTANCE * margin[order])):
        chosen[k] = not any(other < k and chosen[other] for other in near)
    return uv[chosen]


def _free_cells(risk_map: RiskMap, field: ObstacleField, clearance: float) -> BoolArray:
    """Cells (H, W) whose centres keep the clearance."""
    free = ~risk_map.obstacles
    cells = np.argwhere(free)
    free[tuple(cells.T)] = field.clear_points(_centres(risk_map, cells), clearance)
    return free


def _centres(risk_map: RiskMap, cells: IndexArray) -> FloatArray:
    return np.asarray((cells[:, ::-1] + 0.5) * risk_map.resolution, dtype=np.float64)


def _cheapest_cell_path(free: BoolArray, margin: FloatArray, ends: IndexArray) -> IndexArray:
    """Cells (K, 2) of the cheapest path between two cells across the sides of free ones."""
    number = np.where(free, np.cumsum(free).reshape(free.shape) - 1, -1)
    sides = np.concatenate([np.stack((a[(a >= 0) & (b >= 0)], b[(a >= 0) & (b >= 0)]), axis=1)
                            for a, b in ((number[:, 1:], number[:, :-1]), (number[1:], number[:-1]))
                            ])
    scale = max(float(margin.max()), np.finfo(float).tiny)
    cost = 1.0 + NARROW_COST * (1.0 - np.clip(margin[free] / scale, 0.0, 1.0)) ** 2
    edges = np.concatenate((sides, sides[:, ::-1]))
    return np.argwhere(free)[shortest_path(edges, cost[edges].sum(axis=1), len(cost),
                                           *number[tuple(ends.T)].tolist())]
