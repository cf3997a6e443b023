# SPDX-License-Identifier: Apache-2.0
"""Free space along edges and beyond their ends, in map axes: geometry for ``corridors``.

Other nodes, obstacles and the map's edge limit it. See ``corridors`` for strips and quarters.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ..arrays import FloatArray, IndexArray, members
from ..maps.risk_map import RiskMap

# Share of the distance to the nearest node that strips and quarters may use.
NODE_SHARE = 0.95
# Distance kept from obstacles in addition to the clearance [cells]; must exceed risk_map.TOUCH.
OBSTACLE_MARGIN = 1e-5
# Number of nodes examined around an edge; space beyond the furthest of them is not used.
NEAREST = 12
# Largest distance of chords from the edges of their corner [reaches]; 0.29 for a right angle.
STRIP_SHARE = 0.3
# Side of the squares in which obstacle cells are searched [cells].
_SQUARE = 64
# Corners of a unit cell around 0, in order.
CORNERS = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])


@dataclass(frozen=True, eq=False)
class CorridorWidths:
    """Sizes of the corridors along P pairs of nodes [m].

    ``widths`` (P, 2) are those of the left and right strips, ``radii`` (P, 2, 2) those of the left
    and right quarters beyond start and end.
    """

    widths: FloatArray
    radii: FloatArray


def largest_widths(uv: FloatArray, pairs: IndexArray, tube: float,
                   reach: float) -> CorridorWidths:
    """Widths for paths within the ``tube`` [m] of routes with cut corners, chords included.

    If the tube is inf, they extend to the nearest other nodes.
    """
    if tube == np.inf:
        return widths_between_nodes(uv, pairs)
    # A chord of two edges is at most a quarter of each away from them.
    lateral = np.minimum(0.5 * _frame(uv, pairs)[2], STRIP_SHARE * reach)
    return CorridorWidths(np.repeat(tube + lateral[:, None], 2, axis=1),
                          np.full((len(pairs), 2, 2), tube))


def widths_between_nodes(uv: FloatArray, pairs: IndexArray) -> CorridorWidths:
    """Widths at which strips and quarters contain no other node, at most the edge's length."""
    start, direction, length = _frame(uv, pairs)
    count = min(NEAREST, len(uv))
    distance, nearest = cKDTree(uv).query(uv[pairs].mean(axis=1), k=count)
    # There may be other nodes beyond the furthest one examined.
    known = distance[:, -1] if count < len(uv) else np.full(len(pairs), np.inf)
    progress, lateral = _local_coordinates(uv[nearest] - start[:, None], direction[:, None])
    tiny = 1e-9 * length[:, None]
    other = (nearest != pairs[:, :1]) & (nearest != pairs[:, 1:])
    alongside = other & (progress > -tiny) & (progress < length[:, None] + tiny)
    widths, radii = np.empty((len(pairs), 2)), np.empty((len(pairs), 2, 2))
    for side, offset in ((0, lateral), (1, -lateral)):
        widths[:, side] = np.where(alongside & (offset > -tiny), offset, np.inf).min(axis=1)
        for end, overshoot in ((0, -progress), (1, progress - length[:, None])):
            inside = other & (overshoot > -tiny) & (offset > -tiny)
            radii[:, end, side] = np.where(inside, np.hypot(overshoot, offset), np.inf).min(axis=1)
    reach = np.sqrt(np.maximum(known**2 - length**2 / 4, 0.0))
    widths = np.minimum(widths, np.minimum(reach, length)[:, None])
    radii = np.minimum(radii, np.maximum(known - length / 2, 0.0)[:, None, None])
    return CorridorWidths(NODE_SHARE * widths, NODE_SHARE * radii)


def limit_to_map(corridors: CorridorWidths, uv: FloatArray, pairs: IndexArray, risk_map: RiskMap,
                 clearance: float, clear_of_edge: bool) -> CorridorWidths:
    """Narrow corridors to keep the clearance [m] from obstacles and, if asked, the map's edge."""
    resolution = risk_map.resolution
    margin = (clearance if clear_of_edge else 0.0) + OBSTACLE_MARGIN * resolution
    strips, quarters = _map_edge_limits(uv, pairs, np.array(risk_map.size), margin)
    inside = CorridorWidths(np.minimum(corridors.widths, strips),
                            np.minimum(corridors.radii, quarters))
    reach = _frame(uv, pairs)[2] + inside.widths.max(axis=1) + clearance + 2.0 * resolution
    cells = rim_cells(risk_map, uv[np.unique(pairs)], float(reach.max(initial=0.0)))
    return limit_to_cells(inside, uv, pairs, cells, clearance, resolution)


def limit_to_cells(corridors: CorridorWidths, uv: FloatArray, pairs: IndexArray,
                   centres: FloatArray, clearance: float, resolution: float) -> CorridorWidths:
    """Narrow corridors to keep the clearance [m] from cells with ``centres`` (C, 2).

    Quarters become no wider than their strips.
    """
    margin, cells = clearance + OBSTACLE_MARGIN * resolution, _CellIndex(centres, resolution)
    widths = corridors.widths
    widths = np.minimum(widths, _strip_limits(uv, pairs, cells, widths, margin))
    radii = np.minimum(corridors.radii, widths[:, None])
    radii = np.minimum(radii, _quarter_limits(uv, pairs, cells, radii, margin))
    return CorridorWidths(np.maximum(widths, 0.0), np.maximum(radii, 0.0))


def open_ground(uv: FloatArray, risk_map: RiskMap, clearance: float, clear_of_edge: bool,
                limit: float) -> FloatArray:
    """Radii (N,) around places, up to ``limit`` [m], that keep the clearance from obstacles.

    With ``clear_of_edge``, also from the map's edge.
    """
    to_edge = np.minimum(uv, np.array(risk_map.size) - uv).min(axis=1)
    cells = rim_cells(risk_map, uv, limit + clearance + risk_map.resolution)
    free = np.minimum(clear_of_cells(uv, cells, clearance, risk_map.resolution), limit)
    return np.minimum(free, to_edge - (clearance if clear_of_edge else 0.0))


def clear_of_cells(uv: FloatArray, centres: FloatArray, clearance: float,
                   resolution: float) -> FloatArray:
    """Radii (N,) around places that keep the clearance from cells with ``centres`` (C, 2)."""
    if not len(centres):
        return np.full(len(uv), np.inf)
    return np.asarray(cKDTree(centres).query(uv)[0] - clearance - 0.75 * resolution)


def _frame(uv: FloatArray, pairs: IndexArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Start (P, 2), unit direction (P, 2) and length (P,) of each pair."""
    start = uv[pairs[:, 0]]
    step = uv[pairs[:, 1]] - start
    length = np.hypot(*step.T)
    return start, step / np.maximum(length, np.finfo(float).tiny)[:, None], length


def _local_coordinates(vector: FloatArray, direction: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Components of vectors along unit directions, and to their left."""
    progress = (vector * direction).sum(axis=-1)
    lateral = direction[..., 0] * vector[..., 1] - direction[..., 1] * vector[..., 0]
    return progress, lateral


def rim_cells(risk_map: RiskMap, uv: FloatArray, reach: float) -> FloatArray:
    """Centres (C, 2) in map axes of obstacle cells that touch free ground.

    They are all those within ``reach`` [m] of a place (K, 2), and some others.
    """
    obstacles, step = risk_map.obstacles, risk_map.resolution
    rows, columns = obstacles.shape
    low, left = (np.arange(0, size, _SQUARE) for size in (rows, columns))
    squares = (np.stack(np.meshgrid(left, low), axis=-1) + 0.5 * _SQUARE) * step
    near = cKDTree(uv).query(squares)[0] <= reach + _SQUARE * step
    found = [np.empty((0, 2), dtype=np.int64)]
    for row, selected in zip(low.tolist(), near, strict=True):
        if selected.any():
            # Beyond the map's edge nothing is free.
            band = obstacles[np.clip(np.arange(row - 1, row + _SQUARE + 1), 0, rows - 1)]
            band, inner = band[1:-1][:rows - row], (band[:-2] & band[2:])[:rows - row]
            inner[:, 1:] &= band[:, :-1]
            inner[:, :-1] &= band[:, 1:]
            rim = band & ~inner & np.repeat(selected, _SQUARE)[:columns]
            found.append(np.argwhere(rim) + (row, 0))
    return np.asarray((np.concatenate(found)[:, ::-1] + 0.5) * step, dtype=np.float64)


class _CellIndex:
    """Spatial index of obstacle cells in map axes, by their centres (C, 2)."""

    def __init__(self, centres: FloatArray, resolution: float) -> None:
        self.resolution = resolution
        self._centres = centres
        self._tree = cKDTree(centres) if len(centres) else None
        self._corners = CORNERS * resolution

    def near(self, places: FloatArray, radius: FloatArray,
             owner: IndexArray) -> tuple[IndexArray, FloatArray]:
        """Find the cells within a radius (K,) of places (K, 2), for each place ``owner`` (P,).

        Returns indices (C,) into ``owner``, and the offsets (C, 4, 2) of the cells' corners from
        the place.
        """
        if self._tree is None:
            return np.empty(0, dtype=np.int64), np.empty((0, 4, 2))
        found = self._tree.query_ball_point(places, radius, return_sorted=False)
        count = np.array(list(map(len, found)), dtype=np.int64)
        index = np.concatenate([*found, []]).astype(np.int64)
        pair, k = members(count[owner])
        cell = index[(np.cumsum(count) - count)[owner][pair] + k]
        corners = self._centres[cell][:, None] + self._corners
        return pair, corners - places[owner][pair][:, None]


def _strip_limits(uv: FloatArray, pairs: IndexArray, cells: _CellIndex, widths: FloatArray,
                  margin: float) -> FloatArray:
    """Widths (P, 2) at which the strips come within ``margin`` of an obstacle cell."""
    limits = np.full(widths.shape, np.inf)
    _, direction, length = _frame(uv, pairs)
    radius = np.hypot(length / 2, widths.max(axis=1)) + margin + cells.resolution
    pair, to = cells.near(uv[pairs].mean(axis=1), radius, np.arange(len(pairs)))
    progress, lateral = _local_coordinates(to, direction[pair, None])
    half = length[pair, None] / 2 + margin
    for side, offset in ((0, lateral), (1, -lateral)):
        first, last = _share_inside([half + progress, half - progress, offset])
        change = np.roll(offset, -1, axis=1) - offset
        nearest = offset + np.minimum(first * change, last * change)
        nearest = np.where(first <= last, nearest, np.inf).min(axis=1)
        np.minimum.at(limits[:, side], pair, nearest - margin)
    return limits


def _quarter_limits(uv: FloatArray, pairs: IndexArray, cells: _CellIndex, radii: FloatArray,
                    margin: float) -> FloatArray:
    """Radii (P, 2, 2) at which the quarters come within ``margin`` of an obstacle cell."""
    limits = np.full(radii.shape, np.inf)
    radius = np.zeros(len(uv))
    np.maximum.at(radius, pairs, radii.max(axis=2))
    direction = _frame(uv, pairs)[1]
    for end, heading in enumerate((-direction, direction)):  # out of the strip
        pair, to = cells.near(uv, radius + margin + cells.resolution, pairs[:, end])
        progress, lateral = _local_coordinates(to, heading[pair, None])
        for side in (0, 1):
            # Looking back from a pair's start, its left is on the right.
            nearest = _quadrant_distance(progress, lateral if side != end else -lateral, margin)
            np.minimum.at(limits[:, end, side], pair, nearest - margin)
    return limits


def _quadrant_distance(progress: FloatArray, lateral: FloatArray, margin: float) -> FloatArray:
    """Distance (C,) from 0 to the parts of squares that have both offsets at least ``-margin``.

    The squares have corners (C, 4) and do not contain 0. Returns inf without such a part.
    """
    first, last = _share_inside([progress + margin, lateral + margin])
    forward, sideward = (np.roll(offset, -1, axis=1) - offset for offset in (progress, lateral))
    foot = -(progress * forward + lateral * sideward) / (forward**2 + sideward**2)
    share = np.clip(foot, first, np.maximum(first, last))
    distance = np.hypot(progress + share * forward, lateral + share * sideward)
    nearest: FloatArray = np.where(first <= last, distance, np.inf).min(axis=1)
    return nearest


def _share_inside(offsets: list[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Range of shares (C, 4) along the sides of squares in which all offsets are at least 0.

    Offsets are given at the corners (C, 4). The range is empty if the first share is larger.
    """
    first, last = np.zeros(offsets[0].shape), np.ones(offsets[0].shape)
    for offset in offsets:
        change = np.roll(offset, -1, axis=1) - offset
        with np.errstate(divide='ignore', invalid='ignore'):
            share = -offset / change
        first = np.where(change > 0.0, np.fmax(first, share), first)
        last = np.where(change < 0.0, np.fmin(last, share), last)
        last = np.where((change == 0.0) & (offset < 0.0), -1.0, last)
    return first, last


def _map_edge_limits(uv: FloatArray, pairs: IndexArray, size: FloatArray,
                     margin: float) -> tuple[FloatArray, FloatArray]:
    """Widths (P, 2) and radii (P, 2, 2) at which corridors come within ``margin`` of the edge."""
    direction = _frame(uv, pairs)[1]
    leftward = np.stack((-direction[:, 1], direction[:, 0]), axis=1)
    strips, quarters = np.full((len(pairs), 2), np.inf), np.full((len(pairs), 2, 2), np.inf)
    gaps = [(uv[pairs] - margin, -1.0), (size - margin - uv[pairs], 1.0)]
    for side, normal in ((0, leftward), (1, -leftward)):
        for gap, sign in gaps:
            width = _distance_until_used(gap.min(axis=1), sign * normal)
            strips[:, side] = np.minimum(strips[:, side], width)
            for end, heading in enumerate((-direction, direction)):
                out = sign * np.stack((heading, normal))
                # A quarter contains the outward normal if both of its sides lead outward.
                speed = np.where((out > 0.0).all(axis=0), 1.0, out.max(axis=0))
                radius = _distance_until_used(gap[:, end], speed)
                quarters[:, end, side] = np.minimum(quarters[:, end, side], radius)
    return strips, quarters


def _distance_until_used(gap: FloatArray, speed: FloatArray) -> FloatArray:
    """Distance (P,) at which a gap (P, 2) is used up at a rate (P, 2) along its axis."""
    with np.errstate(divide='ignore', invalid='ignore'):
        distance: FloatArray = np.where(speed > 0.0, gap / speed, np.inf).min(axis=1)
    return distance
