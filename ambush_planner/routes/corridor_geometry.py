"""How much room there is beside edges and beyond their ends.

It ends at other nodes, obstacles, the map's edge. Geometry for ``corridors``, in map axes, whole
arrays at a time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_erosion
from scipy.spatial import cKDTree

from ..arrays import FloatArray, IndexArray
from ..maps.risk_map import RiskMap

# Of the distance to the next node, so that strips and quarters stay away from it.
SHARE = 0.95
# Of a cell: what is kept from obstacles beyond the clearance. More than what counts as touching
# them; what lies nearer than this to an obstacle has no room at all.
KEPT = 1e-5
# Nodes looked at around an edge; nothing is taken for granted beyond the furthest of them.
NEAREST = 12
# Of a cell of side 1, one after the other.
CORNERS = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])


@dataclass(frozen=True, eq=False)
class Clearances:
    """The room beside P pairs of nodes [m].

    ``widths`` (P, 2) are those of the strips on the left and right, ``beyond`` (P, 2, 2) the radii
    of the quarters beyond start and end, on the left and right.
    """

    widths: FloatArray
    beyond: FloatArray


def whole_room(uv: FloatArray, pairs: IndexArray, tube: float | None) -> Clearances:
    """As far as the ``tube`` reaches [m]; None: as far as no other node is met."""
    if tube is None:
        return among_nodes(uv, pairs)
    return Clearances(np.full((len(pairs), 2), tube), np.full((len(pairs), 2, 2), tube))


def among_nodes(uv: FloatArray, pairs: IndexArray) -> Clearances:
    """As far as strips and quarters hold no other node; never wider than the edge is long."""
    start, direction, length = _frame(uv, pairs)
    count = min(NEAREST, len(uv))
    far, near = cKDTree(uv).query(uv[pairs].mean(axis=1), k=count)
    # Beyond the furthest node that was looked at there may be others.
    known = far[:, -1] if count < len(uv) else np.full(len(pairs), np.inf)
    along, aside = _turned(uv[near] - start[:, None], direction[:, None])
    tiny = 1e-9 * length[:, None]
    other = (near != pairs[:, :1]) & (near != pairs[:, 1:])
    beside = other & (along > -tiny) & (along < length[:, None] + tiny)
    widths, beyond = np.empty((len(pairs), 2)), np.empty((len(pairs), 2, 2))
    for side, offset in ((0, aside), (1, -aside)):
        widths[:, side] = np.where(beside & (offset > -tiny), offset, np.inf).min(axis=1)
        for end, ahead in ((0, -along), (1, along - length[:, None])):
            there = other & (ahead > -tiny) & (offset > -tiny)
            beyond[:, end, side] = np.where(there, np.hypot(ahead, offset), np.inf).min(axis=1)
    reach = np.sqrt(np.maximum(known**2 - length**2 / 4, 0.0))
    widths = np.minimum(widths, np.minimum(reach, length)[:, None])
    beyond = np.minimum(beyond, np.maximum(known - length / 2, 0.0)[:, None, None])
    return Clearances(SHARE * widths, SHARE * beyond)


def on_the_map(
    room: Clearances,
    uv: FloatArray,
    pairs: IndexArray,
    risk_map: RiskMap,
    clearance: float,
    clear_of_edge: bool,
) -> Clearances:
    """Of a room, what keeps the clearance [m]; quarters are no wider than the strips."""
    margin = (clearance if clear_of_edge else 0.0) + KEPT * risk_map.resolution
    strips, quarters = _to_map_edge(uv, pairs, np.array(risk_map.size), margin)
    room = Clearances(np.minimum(room.widths, strips), np.minimum(room.beyond, quarters))
    return clear_of_cells(
        room, uv, pairs, rim_cells(risk_map), clearance, risk_map.resolution
    )


def clear_of_cells(
    room: Clearances,
    uv: FloatArray,
    pairs: IndexArray,
    cells: FloatArray,
    clearance: float,
    resolution: float,
) -> Clearances:
    """Of a room, what keeps the clearance [m] from cells with these centres (C, 2)."""
    kept, around = clearance + KEPT * resolution, _Cells(cells, resolution)
    widths = np.minimum(
        room.widths, _strips(uv, pairs, around, room.widths, kept, resolution)
    )
    beyond = np.minimum(room.beyond, widths[:, None])
    beyond = np.minimum(beyond, _quarters(uv, pairs, around, beyond, kept, resolution))
    return Clearances(np.maximum(widths, 0.0), np.maximum(beyond, 0.0))


def _frame(uv: FloatArray, pairs: IndexArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Start (P, 2), unit direction (P, 2) and length (P,) of each pair."""
    start = uv[pairs[:, 0]]
    step = uv[pairs[:, 1]] - start
    length = np.hypot(*step.T)
    return start, step / np.maximum(length, np.finfo(float).tiny)[:, None], length


def _turned(vector: FloatArray, direction: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How far vectors lead along unit directions, and to their left."""
    along = (vector * direction).sum(axis=-1)
    aside = direction[..., 0] * vector[..., 1] - direction[..., 1] * vector[..., 0]
    return along, aside


def _ahead(direction: FloatArray) -> list[tuple[int, FloatArray]]:
    """For both ends of pairs, where the way out of the strip leads."""
    return [(0, -direction), (1, direction)]


def rim_cells(risk_map: RiskMap) -> FloatArray:
    """Centres (C, 2) in map axes of the obstacle cells that touch free ground."""
    inner = binary_erosion(risk_map.obstacles, border_value=1)
    cells = np.argwhere(risk_map.obstacles & ~inner)
    return np.asarray((cells[:, ::-1] + 0.5) * risk_map.resolution, dtype=np.float64)


class _Cells:
    """Obstacle cells in map axes, by their centres (C, 2)."""

    def __init__(self, centres: FloatArray, resolution: float) -> None:
        self._centres = centres
        self._tree = cKDTree(centres) if len(centres) else None
        self._corners = CORNERS * resolution

    def around(
        self, places: FloatArray, radius: FloatArray, of: IndexArray
    ) -> tuple[IndexArray, FloatArray]:
        """The cells within a radius (K,) of places (K, 2), for the place ``of`` (P,) each.

        Returned are indices (C,) into ``of``, and the offsets (C, 4, 2) of the cells' corners from
        the place.
        """
        if self._tree is None:
            return np.empty(0, dtype=np.int64), np.empty((0, 4, 2))
        found = self._tree.query_ball_point(places, radius, return_sorted=False)
        count = np.array([len(some) for some in found])
        index = np.concatenate([*found, []]).astype(np.int64)
        first, many = (np.cumsum(count) - count)[of], count[of]
        whose = np.repeat(np.arange(len(of)), many)
        cell = index[np.arange(len(whose)) + np.repeat(first - np.cumsum(many) + many, many)]
        corners = self._centres[cell][:, None] + self._corners
        return whose, corners - places[of][whose][:, None]


def _strips(
    uv: FloatArray,
    pairs: IndexArray,
    cells: _Cells,
    widths: FloatArray,
    kept: float,
    resolution: float,
) -> FloatArray:
    """Widths (P, 2) at which the strips come within ``kept`` of an obstacle cell."""
    room = np.full(widths.shape, np.inf)
    _, direction, length = _frame(uv, pairs)
    radius = np.hypot(length / 2, widths.max(axis=1)) + kept + resolution
    pair, to = cells.around(uv[pairs].mean(axis=1), radius, np.arange(len(pairs)))
    along, aside = _turned(to, direction[pair, None])
    half = length[pair, None] / 2 + kept
    for side, offset in ((0, aside), (1, -aside)):
        first, last = _within([half + along, half - along, offset])
        change = np.roll(offset, -1, axis=1) - offset
        nearest = offset + np.minimum(first * change, last * change)
        nearest = np.where(first <= last, nearest, np.inf).min(axis=1)
        np.minimum.at(room[:, side], pair, nearest - kept)
    return room


def _quarters(
    uv: FloatArray,
    pairs: IndexArray,
    cells: _Cells,
    beyond: FloatArray,
    kept: float,
    resolution: float,
) -> FloatArray:
    """Radii (P, 2, 2) at which the quarters come within ``kept`` of an obstacle cell."""
    room = np.full(beyond.shape, np.inf)
    radius = np.zeros(len(uv))
    np.maximum.at(radius, pairs, beyond.max(axis=2))
    for end, ahead in _ahead(_frame(uv, pairs)[1]):
        pair, to = cells.around(uv, radius + kept + resolution, pairs[:, end])
        along, aside = _turned(to, ahead[pair, None])
        for side in (0, 1):
            # Who looks back from a pair's start has its left on the right.
            nearest = _from_corner(along, aside if side != end else -aside, kept)
            np.minimum.at(room[:, end, side], pair, nearest - kept)
    return room


def _from_corner(along: FloatArray, aside: FloatArray, kept: float) -> FloatArray:
    """Distance (C,) from 0 of those parts of squares that have both offsets at least ``-kept``.

    The squares have corners (C, 4), and 0 lies in none of them; inf where there is no such part.
    """
    first, last = _within([along + kept, aside + kept])
    forward, sideward = (np.roll(offset, -1, axis=1) - offset for offset in (along, aside))
    foot = -(along * forward + aside * sideward) / (forward**2 + sideward**2)
    share = np.clip(foot, first, np.maximum(first, last))
    far = np.hypot(along + share * forward, aside + share * sideward)
    nearest: FloatArray = np.where(first <= last, far, np.inf).min(axis=1)
    return nearest


def _within(offsets: list[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """From which to which share (C, 4) of the sides of squares all offsets are at least 0.

    Offsets are given at the corners (C, 4). Nowhere if the first share is the larger one.
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


def _to_map_edge(
    uv: FloatArray, pairs: IndexArray, size: FloatArray, margin: float
) -> tuple[FloatArray, FloatArray]:
    """Widths (P, 2) and radii (P, 2, 2) at which the room comes within ``margin`` of the edge.

    The edge is the map's outer one.
    """
    direction = _frame(uv, pairs)[1]
    leftward = np.stack((-direction[:, 1], direction[:, 0]), axis=1)
    strips, quarters = np.full((len(pairs), 2), np.inf), np.full((len(pairs), 2, 2), np.inf)
    gaps = [(uv[pairs] - margin, -1.0), (size - margin - uv[pairs], 1.0)]
    for side, aside in ((0, leftward), (1, -leftward)):
        for gap, sign in gaps:
            strips[:, side] = np.minimum(strips[:, side], _first(gap.min(axis=1), sign * aside))
            for end, ahead in _ahead(direction):
                out = sign * np.stack((ahead, aside))
                # Between its two sides a quarter leads straight outward if both lead outward.
                speed = np.where((out > 0.0).all(axis=0), 1.0, out.max(axis=0))
                radius = _first(gap[:, end], speed)
                quarters[:, end, side] = np.minimum(quarters[:, end, side], radius)
    return strips, quarters


def _first(gap: FloatArray, speed: FloatArray) -> FloatArray:
    """How far (P,) one gets until a gap (P, 2) is used up at a speed (P, 2) along its axis."""
    with np.errstate(divide='ignore', invalid='ignore'):
        far: FloatArray = np.where(speed > 0.0, gap / speed, np.inf).min(axis=1)
    return far
