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

from .arrays import FloatArray, IndexArray, frozen_array
from .errors import InvalidOption
from .network import Network
from .obstacles import ObstacleField
from .risk_map import RiskMap
from .room import Room, among_nodes, on_the_map

# Cosine of the least turn that a shortcut may leave out; and how far at least it stays from other
# nodes [lengths].
SHARP = 0.5
PAST = 0.01


@dataclass(frozen=True, eq=False)
class Corridors:
    """Strips and quarters of a network in map axes.

    Parameters
    ----------
    network
        What they were made for.
    origin
        (x, y, yaw) of the map's axes [m, rad].
    uv : (N, 2) float
        The network's nodes in map axes [m].
    links : (L, 2) int
        Tails and heads of the edges, and of shortcuts if there is no tube; sorted.
    left, right : (L,) float
        Widths of the strips beside each link, seen along it [m].
    beyond : (L, 2, 2) float
        Radii of the quarters beyond tail and head, to the left and to the right [m]; none is wider
        than its strip.
    shortcuts
        Whether a path may leave out nodes of its route: without a tube.
    """

    network: Network
    origin: tuple[float, float, float]
    uv: FloatArray
    links: IndexArray
    left: FloatArray
    right: FloatArray
    beyond: FloatArray
    shortcuts: bool
    _keys: IndexArray

    def links_along(self, route: IndexArray) -> IndexArray:
        """Indices (K - 1,) of the links that join the nodes of a route (K,)."""
        return np.searchsorted(self._keys, _keys(route[:-1], route[1:], len(self.uv)))

    def shortened(self, route: IndexArray) -> IndexArray:
        """The shortest route along links that lead forward from node to node of a route (K,).

        It leaves nodes out and takes in none, so no ambush at a node hits it more often. Where a
        tube is to be kept, the route comes back as it is.
        """
        if not self.shortcuts:
            return route
        first, end = np.searchsorted(self._keys, np.stack((route, route + 1)) * len(self.uv))
        count = end - first
        step = np.repeat(np.arange(len(route)), count)
        link = np.arange(len(step)) - (np.cumsum(count) - count - first)[step]
        place = np.full(len(self.uv), -1)
        place[route] = np.arange(len(route))
        ahead = place[self.links[link, 1]]
        forward = ahead > step
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
        raise InvalidOption(f"tube must be finite and >= 0 [m], got {tube}")
    uv = risk_map.to_map_axes(network.points)
    # The layers of a trip's legs lie on the same places, which are measured once.
    here, places, links = uv[: network.place_count], network.places, network.edges
    if tube is None:
        field = ObstacleField(risk_map, clear_of_edge)
        more = _shortcuts(here, places[links], field, clearance)
        more = np.concatenate((more, more[:, ::-1]))
        links = np.concatenate((links, *_in_layers(network, more)))
    links = links[np.lexsort(links.T[::-1])]
    at = places[links]
    low, high = np.sort(at, axis=1).T
    pair_keys, pair_of = np.unique(_keys(low, high, len(here)), return_inverse=True)
    pairs = np.stack(np.divmod(pair_keys, len(here)), axis=1)
    if tube is None:
        room = among_nodes(here, pairs)
    else:
        room = Room(np.full((len(pairs), 2), tube), np.full((len(pairs), 2, 2), tube))
    room = on_the_map(room, here, pairs, risk_map, clearance, clear_of_edge)
    along = at[:, 0] < at[:, 1]  # else the pair is seen from its end
    widths, beyond = room.widths[pair_of], room.beyond[pair_of]
    widths[~along], beyond[~along] = widths[~along, ::-1], beyond[~along, ::-1, ::-1]
    return Corridors(
        network,
        risk_map.origin,
        frozen_array(uv, np.float64),
        frozen_array(links, np.int64),
        frozen_array(widths[:, 0], np.float64),
        frozen_array(widths[:, 1], np.float64),
        frozen_array(beyond, np.float64),
        tube is None,
        frozen_array(_keys(links[:, 0], links[:, 1], len(uv)), np.int64),
    )


def _keys(tails: IndexArray, heads: IndexArray, count: int) -> IndexArray:
    keys: IndexArray = tails * count + heads
    return keys


def _in_layers(network: Network, pairs: IndexArray) -> list[IndexArray]:
    """Pairs (S, 2) of places as links of each leg's layer; a leg ends in the next one's layer."""
    layers = [pairs + leg * network.place_count for leg in range(network.legs)]
    for links, stop in zip(layers, network.stops, strict=False):
        links[pairs == stop % network.place_count] = stop
    return layers


def _shortcuts(
    uv: FloatArray, edges: IndexArray, field: ObstacleField, clearance: float
) -> IndexArray:
    """Pairs (S, 2), lower number first, whose ends are joined by two edges that turn by more than
    ``SHARP``, by none, and on free ground by a straight line past all other nodes."""
    both = np.concatenate((edges, edges[:, ::-1]))
    joined = np.unique(_keys(both[:, 0], both[:, 1], len(uv)))
    middle, other = np.divmod(joined, len(uv))
    found = []
    for k in range(1, int(np.bincount(middle).max(initial=0))):
        same = np.flatnonzero(middle[k:] == middle[:-k])
        a, b, c = other[same], middle[same], other[same + k]
        to_a, to_c = uv[a] - uv[b], uv[c] - uv[b]
        sharp = (to_a * to_c).sum(axis=1) > -SHARP * np.hypot(*to_a.T) * np.hypot(*to_c.T)
        found.append(_keys(a[sharp], c[sharp], len(uv)))
    new = np.setdiff1d(np.concatenate([*found, joined[:0]]), joined)
    pairs = np.stack(np.divmod(new, len(uv)), axis=1)
    pairs = pairs[field.clear_segments(uv[pairs[:, 0]], uv[pairs[:, 1]], clearance)]
    length = np.hypot(*(uv[pairs[:, 1]] - uv[pairs[:, 0]]).T)
    return pairs[among_nodes(uv, pairs).widths.min(axis=1) > PAST * length]
