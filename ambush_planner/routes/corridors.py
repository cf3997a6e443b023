"""Room beside each edge: how far the path that is driven may leave the drawn route.

Beside an edge from a to b lie two *strips*, the rectangles of its length and of the widths ``left``
and ``right``. Where a route turns, its strips part on the outer side, so beyond each end of a strip
lies a *quarter* of a disc round the node, between the strip's end and the edge's own line. No strip
and no quarter comes nearer to an obstacle than the clearance, and either

* none of them holds another node (``tube`` None): what stays in a route's strips and quarters
  meets no node but the route's own, so the game on the network is the game that is driven. A path
  may even leave nodes of its route out, also by *shortcuts*, which are no edges of the network; or
* no point of them is further than ``tube`` from the edge or node: an ambush with reach r that hits
  what is driven would hit the drawn route with reach r + tube.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import BoolArray, FloatArray, IndexArray, frozen_array
from ..errors import InvalidOption
from ..maps.obstacles import ObstacleField
from ..maps.risk_map import RiskMap
from ..network.network import Network
from .corridor_geometry import Clearances, among_nodes, on_the_map, whole_room

# Cosine of the least turn that a shortcut may leave out; and how far at least it stays from other
# nodes [lengths].
SHARP = 0.5
PAST = 0.01


@dataclass(frozen=True, eq=False)
class Corridors:
    """Strips and quarters of a network in map axes.

    Where a trip has several legs, their layers lie on the same places, which stand here once:
    routes are those of one leg, as places.

    Parameters
    ----------
    network
        What they were made for.
    origin
        (x, y, yaw) of the map's axes [m, rad].
    uv : (N, 2) float
        The network's places in map axes [m].
    links : (L, 2) int
        Tails and heads of the edges, and of shortcuts if there is no tube; both ways, sorted.
    left, right : (L,) float
        Widths of the strips beside each link, seen along it [m].
    beyond : (L, 2, 2) float
        Radii of the quarters beyond tail and head, to the left and to the right [m]; none is wider
        than its strip.
    shortcut : (L,) bool
        Links by which a path may leave out nodes of its route: all of them without a tube.
    """

    network: Network
    origin: tuple[float, float, float]
    uv: FloatArray
    links: IndexArray
    left: FloatArray
    right: FloatArray
    beyond: FloatArray
    shortcut: BoolArray
    _keys: IndexArray

    def links_along(self, tails: IndexArray, heads: IndexArray) -> IndexArray:
        """Indices (L,) of the links that join nodes."""
        return np.searchsorted(self._keys, tails * len(self.uv) + heads)

    def shortened(self, route: IndexArray) -> IndexArray:
        """The shortest route along links that lead forward from node to node of a route (K,).

        It leaves nodes out and takes in none, so no ambush at a node hits it more often. Where a
        tube is to be kept, the route comes back as it is.
        """
        if not self.shortcut.any():
            return route
        first, end = np.searchsorted(self._keys, np.stack((route, route + 1)) * len(self.uv))
        count = end - first
        step = np.repeat(np.arange(len(route)), count)
        link = np.arange(len(step)) - (np.cumsum(count) - count - first)[step]
        place = np.full(len(self.uv), -1)
        place[route] = np.arange(len(route))
        ahead = place[self.links[link, 1]]
        forward = (ahead == step + 1) | ((ahead > step) & self.shortcut[link])
        step, ahead = step[forward], ahead[forward]
        gaps = np.hypot(*(self.uv[route[ahead]] - self.uv[route[step]]).T)
        length, before = [np.inf] * len(route), [0] * len(route)
        length[0] = 0.0
        for tail, head, gone in zip(step.tolist(), ahead.tolist(), gaps.tolist(), strict=True):
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
    """Measure the strips and quarters of a network on its map.

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
        raise InvalidOption(f'tube must be finite and >= 0 [m], got {tube}')
    uv = risk_map.to_map_axes(network.points[: network.place_count])
    edges = np.unique(np.sort(network.places[network.edges], axis=1), axis=0)
    if tube is None:
        field = ObstacleField(risk_map, clear_of_edge)
        pairs, room = _with_shortcuts(uv, edges, field, clearance)
    else:
        pairs, room = edges, whole_room(uv, edges, tube)
    room = on_the_map(room, uv, pairs, risk_map, clearance, clear_of_edge)
    links = np.concatenate((pairs, pairs[:, ::-1]))
    order = np.lexsort((links[:, 1], links[:, 0]))
    # Seen from its end, the left of a pair is on the right.
    widths = np.concatenate((room.widths, room.widths[:, ::-1]))[order]
    beyond = np.concatenate((room.beyond, room.beyond[:, ::-1, ::-1]))[order]
    links = links[order]
    return Corridors(
        network,
        risk_map.origin,
        frozen_array(uv, np.float64),
        frozen_array(links, np.int64),
        frozen_array(widths[:, 0], np.float64),
        frozen_array(widths[:, 1], np.float64),
        frozen_array(beyond, np.float64),
        frozen_array(np.full(len(links), tube is None), np.bool_),
        frozen_array(_keys(links, len(uv)), np.int64),
    )


def _keys(links: IndexArray, count: int) -> IndexArray:
    keys: IndexArray = links[:, 0] * count + links[:, 1]
    return keys


def _with_shortcuts(
    uv: FloatArray, edges: IndexArray, field: ObstacleField, clearance: float
) -> tuple[IndexArray, Clearances]:
    """The edges, and the shortcuts that are on free ground and pass all other nodes."""
    more = _shortcuts(uv, edges)
    more = more[field.clear_segments(uv[more[:, 0]], uv[more[:, 1]], clearance)]
    pairs = np.concatenate((edges, more))
    room = among_nodes(uv, pairs)
    good = room.widths.min(axis=1) > PAST * np.hypot(*(uv[pairs[:, 1]] - uv[pairs[:, 0]]).T)
    good[: len(edges)] = True
    return pairs[good], Clearances(room.widths[good], room.beyond[good])


def _shortcuts(uv: FloatArray, edges: IndexArray) -> IndexArray:
    """Pairs (S, 2) of nodes that no edge joins, but two edges that turn by more than ``SHARP``."""
    joined = np.sort(_keys(np.concatenate((edges, edges[:, ::-1])), len(uv)))
    middle, other = np.divmod(joined, len(uv))
    found = [joined[:0]]
    for k in range(1, int(np.bincount(middle).max(initial=0))):
        same = np.flatnonzero(middle[k:] == middle[:-k])
        ends, between = np.stack((other[same], other[same + k]), axis=1), uv[middle[same]]
        a, b = uv[ends[:, 0]] - between, uv[ends[:, 1]] - between
        sharp = (a * b).sum(axis=1) > -SHARP * np.hypot(*a.T) * np.hypot(*b.T)
        found.append(_keys(ends[sharp], len(uv)))
    new = np.setdiff1d(np.concatenate(found), joined)
    return np.stack(np.divmod(new, len(uv)), axis=1)
