# SPDX-License-Identifier: Apache-2.0
"""Passages too narrow for a network's mesh, found on the cells of the map."""

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

# Maximum distance from any point to the nearest lattice node [spacings]. Along a line with that
# much free space around it, the nodes next to it are joined.
MAX_NODE_DISTANCE = 1.1
# Additional cost of the narrowest cells, relative to that of the widest.
NARROW_COST = 10.0
# Least distance between the obstacles on both sides of a pass, in margins. It is 2 in a straight
# corridor, and less in the corner of a room, which is no pass.
OPPOSITE = 1.6
# Distance of nodes along a passage, as a share of its margin.
NODE_DISTANCE = 0.7


def widest_cell_path(risk_map: RiskMap, field: ObstacleField, uv_ends: FloatArray,
                     clearance: float) -> tuple[FloatArray, FloatArray]:
    """Widest path over cells: its places (K, 2) in map axes and their margins (K,) [m].

    Consecutive cells share a side, and their centres keep the clearance; the margin is the distance
    to obstacles beyond it. On large maps, blocks of cells without an obstacle (``obstacle_blocks``)
    are crossed in one step, and margins may be underestimated. Both are empty if no path joins the
    two ``uv_ends`` (2, 2).
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
    to_corner = math.sqrt(0.5) * (block - 1) * risk_map.resolution if clearance else 0.0
    clear = _clear(whole, block * risk_map.resolution, field, clearance + to_corner)
    at_ends = tuple((ends // block).T)
    clear[at_ends] = whole[at_ends]
    rest = free & ~_enlarged(clear, block, free.shape)
    at_ends = tuple(ends.T)
    in_rest = rest[at_ends]
    rest = _clear(rest, risk_map.resolution, field, clearance)
    rest[at_ends] = in_rest
    parts = np.concatenate([_centres(np.argwhere(each), side * risk_map.resolution)
                            for each, side in ((clear, block), (rest, 1))])
    # Exact distances take much memory, so cells outside blocks get the chessboard distance.
    distance = [_distances(scipy.ndimage.distance_transform_edt, ~blocks, clear, field) * block,
                _distances(scipy.ndimage.distance_transform_cdt, ~risk_map.obstacles, rest, field)]
    margin = np.concatenate(distance) * risk_map.resolution - clearance
    path = _cheapest_path(clear, rest, block, margin, ends)
    return parts[path], margin[path]


def passage_nodes(path: FloatArray, margin: FloatArray, spacing: float) -> FloatArray:
    """Nodes (K, 2) along the narrow parts of a path over cells, denser where it is narrower.

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
               spacing_at: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """Nodes (K, 2) in map axes along the middle of all passes that the lattice may miss.

    Their margin is below ``MAX_NODE_DISTANCE`` times the spacing there, and they are wider than a
    block of cells (``obstacle_blocks``).
    """
    obstacles, block = risk_map.obstacle_blocks
    passable = np.pad(~obstacles, 1, constant_values=not field.clear_of_edge)
    distance, nearest = scipy.ndimage.distance_transform_edt(passable, return_indices=True)
    ridge = passable & ~scipy.ndimage.binary_opening(passable, np.ones((2, 2)))  # one cell wide
    for axis in (0, 1):
        one, other = (tuple(slice(k, n - 1 + k) if each == axis else slice(None)
                            for each, n in enumerate(passable.shape)) for k in (0, 1))
        width = np.hypot(*(each[one] - each[other] for each in nearest))
        opposite = width > OPPOSITE * np.maximum(distance[one], distance[other])
        ridge[one] |= opposite & (distance[one] >= distance[other])
        ridge[other] |= opposite & (distance[one] < distance[other])
    cells = np.argwhere(ridge[1:-1, 1:-1])
    side = block * risk_map.resolution
    uv = _centres(cells, side)
    margin = (distance[1:-1, 1:-1][tuple(cells.T)] - 0.5) * side - clearance
    narrow = (margin > 0.0) & (margin < MAX_NODE_DISTANCE * spacing_at(uv))
    order = np.flatnonzero(narrow)[np.argsort(-margin[narrow], kind='stable')]
    uv, chosen = uv[order], np.ones(len(order), dtype=bool)
    for k, near in enumerate(cKDTree(uv).query_ball_point(uv, NODE_DISTANCE * margin[order])):
        chosen[k] = not any(other < k and chosen[other] for other in near)
    return uv[chosen]


def _clear(given: BoolArray, side: float, field: ObstacleField, clearance: float) -> BoolArray:
    """Mark those of the ``given`` squares (H, W) of a ``side`` [m] whose centres keep clear."""
    clear = np.zeros_like(given)
    for squares in np.array_split(np.argwhere(given), given.size // CHUNK + 1):
        clear[tuple(squares.T)] = field.clear_points(_centres(squares, side), clearance)
    return clear


def _centres(squares: IndexArray, side: float) -> FloatArray:
    """Centres (K, 2) in map axes of squares (K, 2) = (row, column) of a ``side`` [m]."""
    return np.asarray((squares[:, ::-1] + 0.5) * side, dtype=np.float64)


def _enlarged(blocks: npt.NDArray[Any], block: int, shape: tuple[int, ...]) -> npt.NDArray[Any]:
    """Give each cell of a map of some ``shape`` the value of its block."""
    return np.repeat(np.repeat(blocks, block, axis=0), block, axis=1)[:shape[0], :shape[1]]


def _distances(transform: Callable[[BoolArray], npt.NDArray[Any]], passable: BoolArray,
               selected: BoolArray, field: ObstacleField) -> FloatArray:
    """Free distance (K,) around the centres of the ``selected`` squares [squares]."""
    if not selected.any():
        return np.empty(0)
    padded = np.pad(passable, 1, constant_values=not field.clear_of_edge)
    return np.asarray(transform(padded)[1:-1, 1:-1][selected] - 0.5)


def _cheapest_path(clear: BoolArray, rest: BoolArray, block: int, margin: FloatArray,
                   ends: IndexArray) -> IndexArray:
    """Cheapest path (K,) between two cells over ``clear`` blocks and the cells of the ``rest``.

    Both are numbered row by row, blocks first.
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
    """Pairs (K, 2) of numbered squares that share a side, one of them from ``first`` on."""
    pairs = []
    for a, b in ((number[:, 1:], number[:, :-1]), (number[1:], number[:-1])):
        valid = (a >= 0) & (b >= 0) & ((a >= first) | (b >= first))
        pairs.append(np.stack((a[valid], b[valid]), axis=1))
    return np.concatenate(pairs)
