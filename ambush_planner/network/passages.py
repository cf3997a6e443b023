"""Passages that lie between the nodes of a network: found on the cells of the map itself."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import distance_transform_edt, label
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from ..arrays import BoolArray, FloatArray, IndexArray
from ..maps.obstacles import ObstacleField
from ..maps.risk_map import RiskMap

# No point is further from the nearest node of a lattice than this [spacings]: where there is as
# much room round a line, the nodes next to it are joined along it.
COVERED = 1.1
# How much a way by narrow places costs: it is taken where there is no other.
NARROW = 10.0


def way_by_cells(
    risk_map: RiskMap, field: ObstacleField, uv_ends: FloatArray, clearance: float
) -> tuple[FloatArray, FloatArray]:
    """The widest way from cell to cell: centres (K, 2) in map axes and the room there (K,) [m].

    Cells follow one another across a side, and their centres keep the clearance; the room is what
    is left beyond it. Empty where no way leads from the first of ``uv_ends`` (2, 2) to the other.
    """
    free = _free_cells(risk_map, field, clearance)
    ends = np.stack(risk_map.cells(uv_ends), axis=1)
    free[tuple(ends.T)] = True
    regions = label(free)[0]
    if regions[tuple(ends[0])] != regions[tuple(ends[1])]:
        return np.empty((0, 2)), np.empty(0)
    ground = np.pad(~risk_map.obstacles, 1, constant_values=not field.clear_of_edge)
    room = distance_transform_edt(ground)[1:-1, 1:-1] - 0.5
    room = np.asarray(room * risk_map.resolution - clearance, dtype=np.float64)
    cells = _cheapest(regions == regions[tuple(ends[0])], room, ends)
    return _centres(risk_map, cells), room[tuple(cells.T)]


def passage_nodes(way: FloatArray, room: FloatArray, spacing: float) -> FloatArray:
    """Nodes (K, 2) along the narrow parts of a way by cells, the closer the narrower.

    Together with the lattice's nodes they lead along it.
    """
    kept: list[int] = []
    before = -2
    for k in np.flatnonzero(room < COVERED * spacing).tolist():
        near = k == before + 1 and np.hypot(*(way[k] - way[kept[-1]])) < 0.7 * room[k]
        if not near:
            kept.append(k)
        before = k
    return way[kept]


def _free_cells(risk_map: RiskMap, field: ObstacleField, clearance: float) -> BoolArray:
    """Cells (H, W) whose centres keep the clearance."""
    free = ~risk_map.obstacles
    cells = np.argwhere(free)
    free[tuple(cells.T)] = field.clear_points(_centres(risk_map, cells), clearance)
    return free


def _centres(risk_map: RiskMap, cells: IndexArray) -> FloatArray:
    return np.asarray((cells[:, ::-1] + 0.5) * risk_map.resolution, dtype=np.float64)


def _cheapest(free: BoolArray, room: FloatArray, ends: IndexArray) -> IndexArray:
    """Cells (K, 2) of the cheapest way between two cells across the sides of free ones."""
    number = np.where(free, np.cumsum(free).reshape(free.shape) - 1, -1)
    pairs = np.concatenate([
        np.stack((a[(a >= 0) & (b >= 0)], b[(a >= 0) & (b >= 0)]))
        for a, b in ((number[:, 1:], number[:, :-1]), (number[1:], number[:-1]))
    ], axis=1)
    scale = max(float(room.max()), np.finfo(float).tiny)
    cost = 1.0 + NARROW * (1.0 - np.clip(room[free] / scale, 0.0, 1.0)) ** 2
    graph = csr_matrix((cost[pairs[0]] + cost[pairs[1]], tuple(pairs)), (len(cost),) * 2)
    source, target = number[tuple(ends.T)]
    before = dijkstra(graph, directed=False, indices=source, return_predecessors=True)[1]
    way = [int(target)]
    while way[-1] != source:
        way.append(int(before[way[-1]]))
    return np.argwhere(free)[way[::-1]]
