# SPDX-License-Identifier: Apache-2.0
"""Passages too narrow for a network's mesh, found on the cells of the map itself."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy  # loads ndimage when it is used
from scipy.spatial import cKDTree

from ..arrays import BoolArray, FloatArray, IndexArray, pooled
from ..maps.obstacles import CHUNK, ObstacleField
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
    """The widest path over cells: places (K, 2) in map axes and their margins (K,) [m].

    Consecutive cells share a side, and their centres keep the clearance; the margin is the distance
    to obstacles in excess of it. On large maps, blocks of cells without an obstacle
    (``obstacle_blocks``) are crossed in one step, and margins may be less than the true ones. Empty
    if no path joins the two ``uv_ends`` (2, 2).
    """
    ends = np.stack(risk_map.cells(uv_ends), axis=1)
    free = ~risk_map.obstacles
    free[tuple(ends.T)] = True
    regions = scipy.ndimage.label(free)[0]
    one, other = regions[tuple(ends.T)].tolist()
    if one != other:
        return np.empty((0, 2)), np.empty(0)
    free = regions == one
    del regions  # four bytes a cell
    blocks, block = risk_map.obstacle_blocks
    whole = pooled(np.logical_and, free, block)
    # All cells of a block have to keep the clearance.
    around = math.sqrt(0.5) * (block - 1) * risk_map.resolution if clearance else 0.0
    clear = _clear(whole, block * risk_map.resolution, field, clearance + around)
    at_ends = tuple((ends // block).T)
    clear[at_ends] = whole[at_ends]
    rest = free & ~_enlarged(clear, block, free.shape)
    at_ends = tuple(ends.T)
    in_rest = rest[at_ends]
    rest = _clear(rest, risk_map.resolution, field, clearance)
    rest[at_ends] = in_rest
    parts = np.concatenate([_centres(np.argwhere(each), side * risk_map.resolution)
                            for each, side in ((clear, block), (rest, 1))])
    # In few cells: the exact distance of each takes much memory.
    distance = [_distances(scipy.ndimage.distance_transform_edt, ~blocks, clear, field) * block,
                _distances(scipy.ndimage.distance_transform_cdt, ~risk_map.obstacles, rest, field)]
    margin = np.concatenate(distance) * risk_map.resolution - clearance
    path = _cheapest_path(clear, rest, block, margin, ends)
    return parts[path], margin[path]


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
    side = block * risk_map.resolution
    uv = _centres(cells, side)
    margin = (distance[1:-1, 1:-1][tuple(cells.T)] - 0.5) * side - clearance
    narrow = (margin > 0.0) & (margin < MAX_NODE_DISTANCE * wanted(uv))
    order = np.flatnonzero(narrow)[np.argsort(-margin[narrow], kind='stable')]
    uv, chosen = uv[order], np.ones(len(order), dtype=bool)
    for k, near in enumerate(cKDTree(uv).query_ball_point(uv, NODE_DISTANCE * margin[order])):
        chosen[k] = not any(other < k and chosen[other] for other in near)
    return uv[chosen]


def _clear(some: BoolArray, side: float, field: ObstacleField, clearance: float) -> BoolArray:
    """Those of ``some`` squares (H, W) of a ``side`` [m] whose centres keep the clearance."""
    clear = np.zeros_like(some)
    for squares in np.array_split(np.argwhere(some), some.size // CHUNK + 1):
        clear[tuple(squares.T)] = field.clear_points(_centres(squares, side), clearance)
    return clear


def _centres(squares: IndexArray, side: float) -> FloatArray:
    """Centres (K, 2) in map axes of squares (K, 2) = (row, column) of a ``side`` [m]."""
    return np.asarray((squares[:, ::-1] + 0.5) * side, dtype=np.float64)


def _enlarged(blocks: npt.NDArray[Any], block: int, shape: tuple[int, ...]) -> npt.NDArray[Any]:
    """The value of its block at each cell of a map of some shape."""
    return np.repeat(np.repeat(blocks, block, axis=0), block, axis=1)[:shape[0], :shape[1]]


def _distances(transform: Callable[[BoolArray], npt.NDArray[Any]], passable: BoolArray,
               some: BoolArray, field: ObstacleField) -> FloatArray:
    """Free distance around the centres of ``some`` squares [squares]."""
    if not some.any():
        return np.empty(0)
    padded = np.pad(passable, 1, constant_values=not field.clear_of_edge)
    return np.asarray(transform(padded)[1:-1, 1:-1][some] - 0.5)


def _cheapest_path(clear: BoolArray, rest: BoolArray, block: int, margin: FloatArray,
                   ends: IndexArray) -> IndexArray:
    """The cheapest path (K,) between two cells, across sides of ``clear`` blocks and other cells.

    The blocks have the first numbers, the cells of the ``rest`` the next ones, row by row.
    """
    count = int(clear.sum())
    number = np.full(clear.shape, -1, np.int32)
    number[clear] = np.arange(count)
    numbers = np.array(_enlarged(number, block, rest.shape))
    numbers[rest] = np.arange(count, len(margin))
    sides = np.concatenate((_sides(number, 0), _sides(numbers, count)))
    scale = max(float(margin.max()), np.finfo(float).tiny)
    cost = 1.0 + NARROW_COST * (1.0 - np.clip(margin / scale, 0.0, 1.0)) ** 2
    cost[:count] *= block
    edges = np.concatenate((sides, sides[:, ::-1]))
    return shortest_path(edges, cost[edges].sum(axis=1), len(cost),
                         *numbers[tuple(ends.T)].tolist())


def _sides(number: npt.NDArray[Any], first: int) -> npt.NDArray[Any]:
    """The pairs (K, 2) of numbered squares that share a side, one of them from ``first`` on."""
    found = []
    for a, b in ((number[:, 1:], number[:, :-1]), (number[1:], number[:-1])):
        some = (a >= 0) & (b >= 0) & ((a >= first) | (b >= first))
        found.append(np.stack((a[some], b[some]), axis=1))
    return np.concatenate(found)
