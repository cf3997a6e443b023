"""Corridors refitted: to obstacles that are new, and to a start or goal beside the network's.

The strips and quarters that have changed are measured again, so what ``corridors`` says of them and
of the paths in them holds on.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from ..arrays import FloatArray, IndexArray, frozen_array
from ..maps.risk_map import RiskMap, to_map_axes
from .corridor_geometry import Clearances, clear_of_cells, on_the_map, whole_room
from .corridors import Corridors

# Nodes looked at around an end that has moved, in lengths of its longest link.
AROUND = 3.0


def among_new_obstacles(
    corridors: Corridors, cells: FloatArray, clearance: float, resolution: float
) -> Corridors:
    """The corridors where obstacles have come that were not there when they were measured.

    Parameters
    ----------
    cells : (C, 2) float
        Centres of the new obstacle cells in map axes [m].
    clearance, resolution
        What is kept from obstacles, and the size of a cell [m].
    """
    ends = corridors.uv[corridors.links]
    wide = np.maximum(corridors.left, corridors.right)
    length = np.hypot(*(ends[:, 1] - ends[:, 0]).T)
    reach = np.hypot(length / 2 + wide, wide) + clearance + 2.0 * resolution
    middles = ends.mean(axis=1)
    gaps, _ = cKDTree(cells).query(middles, distance_upper_bound=float(reach.max()))
    near = np.flatnonzero(gaps <= reach)
    widths = np.stack((corridors.left[near], corridors.right[near]), axis=1)
    room = Clearances(widths, corridors.beyond[near])
    room = clear_of_cells(
        room, corridors.uv, corridors.links[near], cells, clearance, resolution
    )
    return _with_room(corridors, near, room)


def with_end_at(
    corridors: Corridors,
    node: int,
    place: tuple[float, float],
    around: RiskMap,
    corner: FloatArray,
    clearance: float = 0.0,
    tube: float | None = None,
    clear_of_edge: bool = True,
) -> Corridors:
    """The corridors where routes begin or end somewhat beside the source or the target ``node``.

    Parameters
    ----------
    place
        Where they begin or end instead, in the world [m].
    around, corner
        Part of the map, in map axes, and where its lower left corner lies (2,) [m]; it reaches as
        far beyond the node's links as these are long, or as the tube.
    clearance, tube, clear_of_edge
        As the corridors were made with.
    """
    links, uv = corridors.links, corridors.uv.copy()
    uv[node] = to_map_axes(corridors.origin, place)
    at = np.flatnonzero((links == node).any(axis=1))
    distance = np.hypot(*(uv - uv[node]).T)
    nodes = np.flatnonzero(distance <= AROUND * distance[links[at]].max())
    here, pairs = uv[nodes] - corner, np.searchsorted(nodes, links[at])
    room = whole_room(here, pairs, tube)
    room = on_the_map(room, here, pairs, around, clearance, clear_of_edge)
    return _with_room(replace(corridors, uv=frozen_array(uv, np.float64)), at, room)


def _with_room(corridors: Corridors, links: IndexArray, room: Clearances) -> Corridors:
    """The corridors with other strips and quarters at some links (K,)."""
    left, right, beyond, shortcut = (
        each.copy()
        for each in (corridors.left, corridors.right, corridors.beyond, corridors.shortcut)
    )
    left[links], right[links] = room.widths.T
    beyond[links] = room.beyond
    shortcut[links] &= room.widths.min(axis=1) > 0.0  # else it may meet something
    return replace(
        corridors,
        shortcut=frozen_array(shortcut, np.bool_),
        left=frozen_array(left, np.float64),
        right=frozen_array(right, np.float64),
        beyond=frozen_array(beyond, np.float64),
    )
