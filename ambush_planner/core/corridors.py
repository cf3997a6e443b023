"""Room beside each edge: how far the path that is driven may leave the drawn route.

Beside an edge from a to b lie two *strips*, the rectangles of its length and of the widths ``left``
and ``right``. Where a route turns, its strips part on the outer side, so beyond each end of a strip
lies a *quarter* of a disc round the node, between the strip's end and the edge's own line. No strip
and no quarter comes nearer to an obstacle than the clearance, and either

* none of them holds another node (``tube`` None): what stays in a route's strips and quarters
  meets no node but the route's own, so the game on the network is the game that is driven, and a
  path may even leave nodes of its route out; or
* no point of them is further than ``tube`` from the edge or node: an ambush with reach r that hits
  what is driven would hit the drawn route with reach r + tube.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .arrays import BoolArray, FloatArray, IndexArray, frozen_array
from .errors import InvalidOption
from .network import Network
from .risk_map import RiskMap
from .room import on_the_map, whole_room


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
    left, right : (M,) float
        Widths of the strips beside each edge, seen along it [m].
    beyond : (M, 2, 2) float
        Radii of the quarters beyond tail and head, to the left and to the right [m]; none is wider
        than its strip.
    shortcut : (M,) bool
        Edges by which a path may leave out nodes of its route: all of them without a tube.
    """

    network: Network
    origin: tuple[float, float, float]
    uv: FloatArray
    left: FloatArray
    right: FloatArray
    beyond: FloatArray
    shortcut: BoolArray
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
        if not self.shortcut.any():
            return route
        first = np.searchsorted(self._keys, route * len(self.uv))
        count = np.searchsorted(self._keys, (route + 1) * len(self.uv)) - first
        step = np.repeat(np.arange(len(route)), count)
        edge = self._order[np.arange(len(step)) - (np.cumsum(count) - count - first)[step]]
        place = np.full(len(self.uv), -1)
        place[route] = np.arange(len(route))
        ahead = place[self.network.heads[edge]]
        forward = (ahead == step + 1) | ((ahead > step) & self.shortcut[edge])
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
    keys = network.tails * len(uv) + network.heads
    order = np.argsort(keys, kind="stable")
    low, high = np.minimum(*network.edges.T), np.maximum(*network.edges.T)
    pair_keys, pair_of = np.unique(low * len(uv) + high, return_inverse=True)
    pairs = np.stack(np.divmod(pair_keys, len(uv)), axis=1)
    room = whole_room(uv, pairs, tube)
    room = on_the_map(room, uv, pairs, risk_map, clearance, clear_of_edge)
    along = network.tails < network.heads  # else the pair is seen from its end
    widths, beyond = room.widths[pair_of], room.beyond[pair_of]
    widths[~along], beyond[~along] = widths[~along, ::-1], beyond[~along, ::-1, ::-1]
    return Corridors(
        network,
        risk_map.origin,
        frozen_array(uv, np.float64),
        frozen_array(widths[:, 0], np.float64),
        frozen_array(widths[:, 1], np.float64),
        frozen_array(beyond, np.float64),
        frozen_array(np.full(len(network.edges), tube is None), np.bool_),
        frozen_array(keys[order], np.int64),
        frozen_array(order, np.int64),
    )
