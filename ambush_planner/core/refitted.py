"""Corridors refitted: to obstacles that are new, and to a start or goal beside the network's.

The strips and quarters that have changed are measured again, so what ``corridors`` says of them and
of the paths in them holds on.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from .arrays import BoolArray, FloatArray, IndexArray, frozen_array
from .corridors import Corridors
from .risk_map import RiskMap, to_map_axes
from .room import Room, clear_of_cells, on_the_map, whole_room

# Nodes looked at around an end that has moved, in lengths of its longest edge.
AROUND = 3.0


def among_new_obstacles(
    corridors: Corridors, cells: FloatArray, lost: BoolArray, clearance: float, resolution: float
) -> Corridors:
    """The corridors where obstacles have come that were not there when they were measured.

    Parameters
    ----------
    cells : (C, 2) float
        Centres of the new obstacle cells in map axes [m].
    lost : (M,) bool
        Edges that can no longer be driven; no path takes one as a shortcut.
    clearance, resolution
        What is kept from obstacles, and the size of a cell [m].
    """
    edges, wide = corridors.network.edges, np.maximum(corridors.left, corridors.right)
    reach = np.hypot(corridors.network.lengths / 2 + wide, wide) + clearance + 2.0 * resolution
    middles = corridors.uv[edges].mean(axis=1)
    gaps, _ = cKDTree(cells).query(middles, distance_upper_bound=float(reach.max()))
    near = np.flatnonzero(gaps <= reach)
    room = Room(_widths(corridors, near), corridors.beyond[near])
    room = clear_of_cells(room, corridors.uv, edges[near], cells, clearance, resolution)
    return _with_room(
        replace(corridors, shortcut=frozen_array(corridors.shortcut & ~lost, np.bool_)), near, room
    )


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
        far beyond the node's edges as these are long, or as the tube.
    clearance, tube, clear_of_edge
        As the corridors were made with.
    """
    network, uv = corridors.network, corridors.uv.copy()
    uv[node] = to_map_axes(corridors.origin, place)
    at = np.flatnonzero((network.tails == node) | (network.heads == node))
    distance = np.hypot(*(uv - uv[node]).T)
    longest = distance[network.edges[at]].max()
    nodes = np.flatnonzero(distance <= AROUND * longest)
    here, pairs = uv[nodes] - corner, np.searchsorted(nodes, network.edges[at])
    room = whole_room(here, pairs, tube)
    room = on_the_map(room, here, pairs, around, clearance, clear_of_edge)
    shortcut = corridors.shortcut.copy()
    shortcut[at] &= room.widths.min(axis=1) > 0.0  # else it may meet something
    moved = replace(
        corridors, uv=frozen_array(uv, np.float64), shortcut=frozen_array(shortcut, np.bool_)
    )
    return _with_room(moved, at, room)


def _widths(corridors: Corridors, edges: IndexArray) -> FloatArray:
    return np.stack((corridors.left[edges], corridors.right[edges]), axis=1)


def _with_room(corridors: Corridors, edges: IndexArray, room: Room) -> Corridors:
    """The corridors with other strips and quarters at some edges (K,)."""
    left, right, beyond = (
        each.copy() for each in (corridors.left, corridors.right, corridors.beyond)
    )
    left[edges], right[edges] = room.widths.T
    beyond[edges] = room.beyond
    return replace(
        corridors,
        left=frozen_array(left, np.float64),
        right=frozen_array(right, np.float64),
        beyond=frozen_array(beyond, np.float64),
    )
