"""Room beside each edge: how far the path that is driven may leave the drawn route.

Beside an edge from a to b lie two *strips*, the rectangles of its length and of the widths ``left``
and ``right``, and round each node lies a *disc*. No strip and no disc comes nearer to an obstacle
than the clearance, and either

* none of them holds another node (``tube`` None): what stays in the strips and discs of a route
  meets no node but the route's own, so the game on the network is the game that is driven, and a
  path may even leave nodes of its route out; or
* no point of them is further than ``tube`` from the edge or node: an ambush with reach r that hits
  what is driven would hit the drawn route with reach r + tube.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_erosion
from scipy.spatial import cKDTree

from .arrays import FloatArray, IndexArray, frozen_array
from .errors import InvalidOption
from .network import Network
from .risk_map import RiskMap

# Of the distance to the next node, so that strips and discs stay away from it.
SHARE = 0.95
# Of a cell: what is kept from obstacles beyond the clearance, or a path would touch their corners.
KEPT = 1e-3
# Nodes looked at around an edge, and obstacle cells around a node; nothing is taken for granted
# beyond the furthest of them.
NEAREST = 12


@dataclass(frozen=True, eq=False)
class Corridors:
    """Strips and discs of a network in map axes.

    Parameters
    ----------
    network
        What they were made for.
    origin
        (x, y, yaw) of the map's axes [m, rad].
    uv : (N, 2) float
        The network's nodes in map axes [m].
    left, right : (M,) float
        Widths of the strips beside each edge, seen along it [m].
    disc : (N,) float
        Radius of the disc round each node [m].
    shortcuts
        Whether a path may leave out nodes of its route: without a tube.
    """

    network: Network
    origin: tuple[float, float, float]
    uv: FloatArray
    left: FloatArray
    right: FloatArray
    disc: FloatArray
    shortcuts: bool
    _keys: IndexArray
    _order: IndexArray

    def edges_along(self, route: IndexArray) -> IndexArray:
        """Indices (K - 1,) of the edges that join the nodes of a route (K,)."""
        at = np.searchsorted(self._keys, route[:-1] * len(self.uv) + route[1:])
        edges: IndexArray = self._order[at]
        return edges

    def shortened(self, route: IndexArray) -> IndexArray:
        """The shortest route along edges that lead forward from node to node of a route (K,).

        It leaves nodes out and takes in none, so no ambush at a node hits it more often. Where a
        tube is to be kept, the route comes back as it is.
        """
        if not self.shortcuts:
            return route
        first = np.searchsorted(self._keys, route * len(self.uv))
        count = np.searchsorted(self._keys, (route + 1) * len(self.uv)) - first
        step = np.repeat(np.arange(len(route)), count)
        edge = self._order[np.arange(len(step)) - (np.cumsum(count) - count - first)[step]]
        place = np.full(len(self.uv), -1)
        place[route] = np.arange(len(route))
        ahead = place[self.network.heads[edge]]
        forward = ahead > step
        length, before = [np.inf] * len(route), [0] * len(route)
        length[0] = 0.0
        for tail, head, gone in zip(
            step[forward].tolist(), ahead[forward].tolist(),
            self.network.lengths[edge[forward]].tolist(), strict=True,
        ):
            if length[tail] + gone < length[head]:
                length[head], before[head] = length[tail] + gone, tail
        kept = [len(route) - 1]
        while kept[-1]:
            kept.append(before[kept[-1]])
        return route[kept[::-1]]


def make_corridors(
    network: Network,
    risk_map: RiskMap,
    clearance: float = 0.0,
    tube: float | None = None,
    clear_of_edge: bool = True,
) -> Corridors:
    """Measure the strips and discs of a network on its map.

    Parameters
    ----------
    clearance, clear_of_edge
        As the network was built with.
    tube
        Largest distance from the drawn route [m]; None: as far as no other node is met.

    Raises
    ------
    InvalidOption
        The tube is negative or not finite.
    """
    if tube is not None and not 0.0 <= tube < np.inf:
        raise InvalidOption(f"tube must be finite and >= 0 [m], got {tube}")
    uv = risk_map.to_map_axes(network.points)
    keys = network.tails * len(uv) + network.heads
    order = np.argsort(keys, kind="stable")
    # Layers of a trip's legs lie on the same places, which are measured once.
    places = network.places
    tail, head = places[network.edges].T
    here = uv[: network.place_count]
    low, high = np.minimum(tail, head), np.maximum(tail, head)
    pair_keys, pair_of = np.unique(low * len(here) + high, return_inverse=True)
    pairs = np.stack(np.divmod(pair_keys, len(here)), axis=1)
    widths, disc = _widths(here, pairs, tube)
    kept = clearance + KEPT * risk_map.resolution
    cells = _rim_cells(risk_map)
    room = _to_obstacles(here, pairs, cells, widths, kept, risk_map.resolution)
    widths = np.minimum(widths, room)
    disc = np.minimum(disc, _disc_to_obstacles(here, cells, risk_map.resolution) - kept)
    margin = kept if clear_of_edge else KEPT * risk_map.resolution
    widths = np.minimum(widths, _to_map_edge(here, pairs, np.array(risk_map.size), margin))
    disc = np.minimum(disc, np.minimum(here, risk_map.size - here).min(axis=1) - margin)
    widths, disc = np.maximum(widths, 0.0), np.maximum(disc, 0.0)
    along = (tail < head).astype(np.int64)  # else the pair is seen from its end
    left, right = widths[pair_of, 1 - along], widths[pair_of, along]
    return Corridors(
        network,
        risk_map.origin,
        frozen_array(uv, np.float64),
        frozen_array(left, np.float64),
        frozen_array(right, np.float64),
        frozen_array(disc[places], np.float64),
        tube is None,
        frozen_array(keys[order], np.int64),
        frozen_array(order, np.int64),
    )


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


def _widths(
    uv: FloatArray, pairs: IndexArray, tube: float | None
) -> tuple[FloatArray, FloatArray]:
    """Widths (P, 2) to the left and right, and radii (N,), by tube or by the other nodes."""
    if tube is not None:
        return np.full((len(pairs), 2), tube), np.full(len(uv), tube)
    start, direction, length = _frame(uv, pairs)
    tree, count = cKDTree(uv), min(NEAREST, len(uv))
    far, near = tree.query(uv[pairs].mean(axis=1), k=count)
    # Beyond the furthest node that was looked at there may be others; nor is there any use in more
    # than the edge's own length.
    reach = np.sqrt(np.maximum(far[:, -1] ** 2 - length**2 / 4, 0.0)) if count < len(uv) else length
    along, aside = _turned(uv[near] - start[:, None], direction[:, None])
    tiny = 1e-9 * length[:, None]
    beside = (along > -tiny) & (along < length[:, None] + tiny)
    beside &= (near != pairs[:, :1]) & (near != pairs[:, 1:])
    most = np.minimum(reach, length)
    widths = np.stack(
        [np.where(beside & (side > -tiny), side, np.inf).min(axis=1) for side in (aside, -aside)],
        axis=1,
    )
    disc = tree.query(uv, k=2)[0][:, 1]
    return SHARE * np.minimum(widths, most[:, None]), SHARE * disc


def _rim_cells(risk_map: RiskMap) -> FloatArray:
    """Centres (C, 2) in map axes of the obstacle cells that touch free ground."""
    inner = binary_erosion(risk_map.obstacles, border_value=1)
    cells = np.argwhere(risk_map.obstacles & ~inner)
    return np.asarray((cells[:, ::-1] + 0.5) * risk_map.resolution, dtype=np.float64)


def _to_obstacles(
    uv: FloatArray,
    pairs: IndexArray,
    cells: FloatArray,
    widths: FloatArray,
    kept: float,
    resolution: float,
) -> FloatArray:
    """Widths (P, 2) at which the strips come within ``kept`` of an obstacle cell."""
    room = np.full((len(pairs), 2), np.inf)
    if len(cells) == 0 or len(pairs) == 0:
        return room
    start, direction, length = _frame(uv, pairs)
    radius = np.hypot(length / 2, widths.max(axis=1)) + kept + resolution
    near = cKDTree(cells).query_ball_point(uv[pairs].mean(axis=1), radius, return_sorted=False)
    counts = np.array([len(found) for found in near])
    pair = np.repeat(np.arange(len(pairs)), counts)
    if len(pair) == 0:
        return room
    cell = cells[np.concatenate([found for found in near if found]).astype(np.int64)]
    corner = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]) * resolution
    to = cell[:, None] + corner - start[pair, None]
    along, aside = _turned(to, direction[pair, None])
    low, high = _aside_within(along, aside, -kept, length[pair] + kept)
    for side, nearest in ((0, np.maximum(low, 0.0)), (1, np.maximum(-high, 0.0))):
        here = (high >= 0.0) if side == 0 else (low <= 0.0)
        np.minimum.at(room[:, side], pair[here], nearest[here] - kept)
    return room


def _aside_within(
    along: FloatArray, aside: FloatArray, low: float, high: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Least and largest offset (C,) of squares with corners (C, 4), where low <= along <= high.

    (inf, -inf) where a square does not reach there.
    """
    inside = (along >= low) & (along <= high[:, None])
    offsets = [np.where(inside, aside, np.nan)]
    after_along, after = np.roll(along, -1, axis=1), np.roll(aside, -1, axis=1)
    for cut in (np.full(len(high), low), high):
        cuts = (along < cut[:, None]) != (after_along < cut[:, None])
        with np.errstate(divide="ignore", invalid="ignore"):
            share = (cut[:, None] - along) / (after_along - along)
            offsets.append(np.where(cuts, aside + share * (after - aside), np.nan))
    every = np.concatenate(offsets, axis=1)
    none = np.isnan(every)
    return np.where(none, np.inf, every).min(axis=1), np.where(none, -np.inf, every).max(axis=1)


def _disc_to_obstacles(uv: FloatArray, cells: FloatArray, resolution: float) -> FloatArray:
    """A lower bound (N,) of each node's distance to the nearest obstacle cell [m]."""
    if len(cells) == 0:
        return np.full(len(uv), np.inf)
    count = min(NEAREST, len(cells))
    far, near = cKDTree(cells).query(uv, k=count)
    far, near = far.reshape(len(uv), count), near.reshape(len(uv), count)
    gap = np.maximum(np.abs(cells[near] - uv[:, None]) - resolution / 2, 0.0)
    nearest = np.hypot(gap[..., 0], gap[..., 1]).min(axis=1)
    if count < len(cells):
        nearest = np.minimum(nearest, far[:, -1] - np.sqrt(0.5) * resolution)
    bound: FloatArray = nearest
    return bound


def _to_map_edge(
    uv: FloatArray, pairs: IndexArray, size: FloatArray, margin: float
) -> FloatArray:
    """Widths (P, 2) at which the strips come within ``margin`` of the map's outer edge."""
    _, direction, _ = _frame(uv, pairs)
    leftward = np.stack((-direction[:, 1], direction[:, 0]), axis=1)
    ends = uv[pairs]
    room = np.full((len(pairs), 2), np.inf)
    for side, outward in ((0, leftward), (1, -leftward)):
        for gap, speed in (
            (ends.min(axis=1) - margin, -outward),
            (size - ends.max(axis=1) - margin, outward),
        ):
            with np.errstate(divide="ignore", invalid="ignore"):
                width = np.where(speed > 0.0, gap / speed, np.inf).min(axis=1)
            room[:, side] = np.minimum(room[:, side], width)
    return room
