# SPDX-License-Identifier: Apache-2.0
"""Update corridors after new obstacles have appeared, or the start or goal has moved slightly.

The affected strips and quarters are measured again, so the guarantees of ``corridors`` still hold.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from ..arrays import FloatArray, IndexArray
from ..maps.risk_map import RiskMap, to_map_axes
from .corridor_geometry import (
    CorridorWidths,
    clear_of_cells,
    largest_widths,
    limit_to_cells,
    limit_to_map,
)
from .corridors import Corridors

# Radius around a moved end in which nodes are examined [lengths of its longest link].
SEARCH_RADIUS = 3.0


def add_obstacles(corridors: Corridors, cells: FloatArray, clearance: float,
                  resolution: float) -> Corridors:
    """Narrow the corridors to keep clear of new obstacles.

    Parameters
    ----------
    cells : (C, 2) float
        Centres of the new obstacle cells in map axes [m].
    clearance, resolution
        Distance to keep from obstacles, and cell size [m].
    """
    ends = corridors.uv[corridors.links]
    width = corridors.widths.max(axis=1)
    length = np.hypot(*(ends[:, 1] - ends[:, 0]).T)
    reach = np.hypot(length / 2 + width, width) + clearance + 2.0 * resolution
    middles = ends.mean(axis=1)
    distance, _ = cKDTree(cells).query(middles, distance_upper_bound=float(reach.max()))
    near = np.flatnonzero(distance <= reach)
    narrowed = limit_to_cells(CorridorWidths(corridors.widths[near], corridors.radii[near]),
                              corridors.uv, corridors.links[near], cells, clearance, resolution)
    open_ground = np.minimum(corridors.open_ground,
                             clear_of_cells(corridors.uv, cells, clearance, resolution))
    return _set_widths(replace(corridors, open_ground=open_ground), near, narrowed)


def move_end(corridors: Corridors, node: int, place: tuple[float, float], risk_map: RiskMap,
             corner: FloatArray, clearance: float = 0.0, clear_of_edge: bool = True,
             neighbours: IndexArray | None = None) -> Corridors:
    """Update the corridors after the source or target ``node`` has moved.

    Parameters
    ----------
    place
        New world position of the node [m].
    risk_map, corner
        Part of the map, in map axes, and its lower left corner (2,) [m]; it extends beyond the
        node's links by their length, or by the largest width.
    clearance, clear_of_edge
        As for ``make_corridors``.
    neighbours : (K,) int
        Nodes to link with it instead of its present neighbours; None: these stay.
    """
    if neighbours is not None:
        corridors = _relink(corridors, node, neighbours)
    links, uv = corridors.links, corridors.uv.copy()
    uv[node] = to_map_axes(corridors.origin, place)
    open_ground = corridors.open_ground.copy()
    open_ground[node] = 0.0
    moved = np.flatnonzero((links == node).any(axis=1))
    distance = np.hypot(*(uv - uv[node]).T)
    nodes = np.flatnonzero(distance <= SEARCH_RADIUS * distance[links[moved]].max())
    local_uv, pairs = uv[nodes] - corner, np.searchsorted(nodes, links[moved])
    measured = largest_widths(local_uv, pairs, corridors.tube, corridors.reach)
    measured = limit_to_map(measured, local_uv, pairs, risk_map, clearance, clear_of_edge)
    return _set_widths(replace(corridors, uv=uv, open_ground=open_ground), moved, measured)


def _relink(corridors: Corridors, node: int, neighbours: IndexArray) -> Corridors:
    """Replace all links of a node; the new ones have no width yet."""
    unmoved = ~(corridors.links == node).any(axis=1)
    new = np.stack((np.full(len(neighbours), node), neighbours), axis=1)
    links = np.concatenate((corridors.links[unmoved], new, new[:, ::-1]))
    order = np.lexsort((links[:, 1], links[:, 0]))

    def extend(values: npt.NDArray[Any], fill: float) -> npt.NDArray[Any]:
        added = np.full((2 * len(new), *values.shape[1:]), fill, values.dtype)
        return np.concatenate((values[unmoved], added))[order]

    return replace(corridors, links=links[order], widths=extend(corridors.widths, 0.0),
                   radii=extend(corridors.radii, 0.0),
                   shortcut=extend(corridors.shortcut, corridors.tube == np.inf))


def _set_widths(corridors: Corridors, links: IndexArray, measured: CorridorWidths) -> Corridors:
    """Return the corridors with other widths along some links (K,)."""
    widths, radii = corridors.widths.copy(), corridors.radii.copy()
    widths[links], radii[links] = measured.widths, measured.radii
    shortcut = corridors.shortcut.copy()
    shortcut[links] &= measured.widths.min(axis=1) > 0.0  # without width it may touch an obstacle
    return replace(corridors, shortcut=shortcut, widths=widths, radii=radii)
