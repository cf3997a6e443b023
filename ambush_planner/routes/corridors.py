# SPDX-License-Identifier: Apache-2.0
"""Corridors: the space around a drawn route that the driven path may use.

Along each edge lie two *strips*, rectangles of its length and of the ``widths`` left and right. At
a turn of the route, its strips separate on the outer side; *quarters* of discs around the node fill
the wedge between the end of a strip and the extension of the edge. Strips and quarters keep the
clearance from obstacles, and either

* contain no other node (without a tube): a path within a route's corridor passes no node but the
  route's own, so the game on the network is the game that is driven. A path may skip nodes of its
  route, also by *shortcuts*, which are not edges of the network; or
* contain no point further than ``tube`` from the edge or node: an ambush with reach r that hits the
  driven path would hit the drawn route with reach r + tube. Routes whose corners are cut
  (``cut_corners``) also have strips and quarters along the chords.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..arrays import BoolArray, FloatArray, IndexArray, found_in_sorted, members
from ..errors import InvalidOption
from ..game.discs import SecuredArea
from ..maps.obstacles import ObstacleField
from ..maps.risk_map import RiskMap, to_map_axes
from ..network.network import Network
from .corridor_geometry import (
    CorridorWidths,
    largest_widths,
    limit_to_map,
    open_ground,
    widths_between_nodes,
)

# Cosine of the least turn that a shortcut may skip.
SHORTCUT_COSINE = 0.5
# Minimum distance of a shortcut from other nodes [shortcut lengths].
SHORTCUT_MARGIN = 0.01

NOTHING_SECURED = SecuredArea(np.empty((0, 2)), np.empty(0))


@dataclass(frozen=True, eq=False)
class Corridors:
    """Strips and quarters along the links of a network, in map axes.

    Parameters
    ----------
    network
        The network of the routes.
    origin
        (x, y, yaw) of the map axes [m, m, rad].
    uv : (N, 2) float
        The network's nodes in map axes [m].
    links : (L, 2) int
        Tails and heads of the edges and, without a tube, of shortcuts; in both directions, sorted.
    widths : (L, 2) float
        Widths of each link's left and right strips [m].
    radii : (L, 2, 2) float
        Radii of the left and right quarters beyond tail and head [m], at most the strip's width.
    shortcut : (L,) bool
        Links on which a path may skip nodes of its route; without a tube, initially all.
    tube
        Largest distance from the drawn route with its corners cut [m]; inf: no tube, only the
        widths limit it. Widths are larger if chords at corners may need it.
    reach
        Distance within which ambushes hit drawn routes [m]; 0: no corners are cut.
    secured
        Discs in map axes; parts of drawn routes in them are not hit.
    open_ground : (N,) float
        Lower bound of the radius around each node that is free of obstacles [m]; 0 if no corners
        are cut.
    """

    network: Network
    origin: tuple[float, float, float]
    uv: FloatArray
    links: IndexArray
    widths: FloatArray
    radii: FloatArray
    shortcut: BoolArray
    tube: float
    reach: float
    secured: SecuredArea
    open_ground: FloatArray

    @cached_property
    def _keys(self) -> IndexArray:
        return link_keys(self.links, len(self.uv))

    def links_along(self, tails: IndexArray, heads: IndexArray) -> IndexArray:
        """Return the indices (K,) of the links from ``tails`` (K,) to ``heads`` (K,); -1: none."""
        return found_in_sorted(self._keys, tails * len(self.uv) + heads)

    def shorten(self, route: IndexArray) -> IndexArray:
        """Skip nodes of a route (K,): return the shortest way along links between its nodes.

        It adds no nodes, so no ambush at a node hits it more often. With a tube the route is
        returned unchanged.
        """
        if not self.shortcut.any():
            return route
        first, end = np.searchsorted(self._keys, np.stack((route, route + 1)) * len(self.uv))
        step, link = members(end - first)
        link += first[step]
        place = np.full(len(self.uv), -1)
        place[route] = np.arange(len(route))
        heads = place[self.links[link, 1]]
        forward = (heads == step + 1) | ((heads > step) & self.shortcut[link])
        step, heads = step[forward], heads[forward]
        steps = np.hypot(*(self.uv[route[heads]] - self.uv[route[step]]).T)
        length, predecessor = [np.inf] * len(route), [0] * len(route)
        length[0] = 0.0
        for tail, head, added in zip(step.tolist(), heads.tolist(), steps.tolist(), strict=True):
            if length[tail] + added < length[head]:
                length[head], predecessor[head] = length[tail] + added, tail
        nodes = [len(route) - 1]
        while nodes[-1]:
            nodes.append(predecessor[nodes[-1]])
        return route[nodes[::-1]]


def make_corridors(network: Network, risk_map: RiskMap, clearance: float = 0.0,
                   tube: float | None = None, clear_of_edge: bool = True,
                   max_width: float = np.inf, reach: float = 0.0,
                   secured: SecuredArea = NOTHING_SECURED,
                   nodes: IndexArray | None = None) -> Corridors:
    """Measure the strips and quarters of a network on its map.

    Parameters
    ----------
    clearance, clear_of_edge
        As for ``NetworkOptions``.
    tube
        Largest distance from the drawn route [m]; None: up to the nearest other nodes.
    max_width
        Largest distance from the drawn route if there is no tube [m]; inf: paths take shortcuts.
    reach, secured
        With a tube: the distance within which ambushes hit drawn routes [m], tube included, and the
        discs in which they do not. Corners are cut if no ambush gains by it.
    nodes
        Measure only between these nodes (K,), for routes that use no others; None: all.

    Raises InvalidOption if the tube is negative or not finite.
    """
    if tube is None:
        tube = np.inf
    elif not 0.0 <= tube < np.inf:
        raise InvalidOption(f'tube must be finite and >= 0 [m], got {tube}')
    uv = risk_map.to_map_axes(network.points)
    edges = np.unique(np.sort(network.edges, axis=1), axis=0)
    secured = secured_in_map_axes(secured, risk_map.origin)
    nodes = np.arange(len(uv)) if nodes is None else np.unique(nodes)
    included = np.zeros(len(uv), dtype=bool)
    included[nodes] = True
    shortcuts = tube == max_width == np.inf
    if shortcuts:
        field = ObstacleField(risk_map, clear_of_edge)
        pairs, measured = _with_shortcuts(uv, edges, included, field, clearance)
    else:
        edges = edges[included[edges].all(axis=1)]
        pairs, measured = edges, largest_widths(uv, edges, tube, reach)
        if tube == np.inf:
            measured = CorridorWidths(np.minimum(measured.widths, max_width),
                                      np.minimum(measured.radii, max_width))
    measured = limit_to_map(measured, uv, pairs, risk_map, clearance, clear_of_edge)
    links = np.concatenate((pairs, pairs[:, ::-1]))
    order = np.lexsort((links[:, 1], links[:, 0]))
    # In the opposite direction, left and right are swapped.
    widths = np.concatenate((measured.widths, measured.widths[:, ::-1]))[order]
    radii = np.concatenate((measured.radii, measured.radii[:, ::-1, ::-1]))[order]
    links = links[order]
    free = np.zeros(len(uv))
    if reach > 0.0:
        free[nodes] = open_ground(uv[nodes], risk_map, clearance, clear_of_edge,
                                  reach + 2.0 * tube)
    return Corridors(network, risk_map.origin, uv, links, widths, radii,
                     np.full(len(links), shortcuts), tube, reach, secured, free)


def secured_in_map_axes(secured: SecuredArea, origin: tuple[float, float, float]) -> SecuredArea:
    """Return the secured area in map axes."""
    return secured._replace(centres=to_map_axes(origin, secured.centres))


def link_keys(links: IndexArray, count: int) -> IndexArray:
    """Return numbers (L,) that order links (L, 2) by tail and head."""
    keys: IndexArray = links[:, 0] * count + links[:, 1]
    return keys


def _with_shortcuts(uv: FloatArray, edges: IndexArray, included: BoolArray, field: ObstacleField,
                    clearance: float) -> tuple[IndexArray, CorridorWidths]:
    """Edges between ``included`` nodes (N,), and shortcuts clear of obstacles and other nodes."""
    shortcuts = _shortcuts(uv, edges)
    edges, shortcuts = (each[included[each].all(axis=1)] for each in (edges, shortcuts))
    tails, heads = uv[shortcuts.T]
    shortcuts = shortcuts[field.clear_segments(tails, heads, clearance)]
    pairs = np.concatenate((edges, shortcuts))
    measured = widths_between_nodes(uv, pairs)
    length = np.hypot(*(uv[pairs[:, 1]] - uv[pairs[:, 0]]).T)
    wide = measured.widths.min(axis=1) > SHORTCUT_MARGIN * length
    wide[: len(edges)] = True
    return pairs[wide], CorridorWidths(measured.widths[wide], measured.radii[wide])


def _shortcuts(uv: FloatArray, edges: IndexArray) -> IndexArray:
    """Pairs (S, 2) of nodes joined by two edges with a sharp turn, but not by an edge."""
    joined = np.sort(link_keys(np.concatenate((edges, edges[:, ::-1])), len(uv)))
    middle, other = np.divmod(joined, len(uv))
    found = [joined[:0]]
    for k in range(1, int(np.bincount(middle).max(initial=0))):
        same = np.flatnonzero(middle[k:] == middle[:-k])
        ends, centre = np.stack((other[same], other[same + k]), axis=1), uv[middle[same]]
        a, b = uv[ends[:, 0]] - centre, uv[ends[:, 1]] - centre
        sharp = (a * b).sum(axis=1) > -SHORTCUT_COSINE * np.hypot(*a.T) * np.hypot(*b.T)
        found.append(link_keys(ends[sharp], len(uv)))
    new = np.setdiff1d(np.concatenate(found), joined)
    return np.stack(np.divmod(new, len(uv)), axis=1)
