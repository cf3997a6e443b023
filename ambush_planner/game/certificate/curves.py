# SPDX-License-Identifier: Apache-2.0
"""Lower bound from a circulation between the faces of a planar two-way network.

A closed curve through faces and discs winds around an end if its signed crossings of a reference
route do not sum to 0. Every route then meets the curve: it drives one of the links that the curve
crosses, or one of the curve's sites hits it. Let curves c have weights w_c that sum to at most
``price`` times the cost of each link, and to at most the site price q_j alpha_j of each disc j.
Then every route satisfies

    price * cost(route) + sum of q_j alpha_j over the sites that hit it  >=  sum of all w_c,

because a route that site j hits pays for all curves through disc j at once. The mean over a
strategy within the budget bounds its value (docs/theory.md, Proposition 7.3). The circulation is
decomposed into simple cycles, which are such curves. A curve that winds n times counts as often as
every route meets it, at most n times.
"""

from __future__ import annotations

import heapq
import math
import time
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from ...arrays import NEGLIGIBLE, FloatArray, IndexArray, sums
from ...errors import SolverFailed
from ..budget import Budget
from ..distribution.acyclic import simple_cycles
from ..faces import Circulation, Faces

# Maximum number of labels of a search for the route that meets a curve least often.
MAX_LABELS = 10_000


def curve_bound(faces: Faces, circulation: Circulation, site_prices: FloatArray, budget: Budget,
                price: float, deadline: float = math.inf, target: float = math.inf) -> float:
    """Return the lower bound that a circulation proves within the budget, at ``site_prices`` (N,).

    Flow beyond a site price, or beyond the price of a link, is left out. Curves that wind several
    times count once, until it is computed how often each counts; this ends when ``target`` is
    proved, or at ``deadline`` (``time.monotonic``). Raises SolverFailed if the circulation belongs
    to another network.
    """
    game, flow, site = faces.game, circulation.flow, circulation.site
    if len(circulation.through) != len(faces.left) or site.max(initial=-1) >= len(site_prices):
        raise SolverFailed('the circulation is that of another network')
    edge, capacity = np.flatnonzero(game.playable), np.full(len(faces.left), np.inf)
    edge_price = price * budget.cost if price > 0.0 else np.zeros(len(faces.link))
    np.minimum.at(capacity, faces.link[edge], edge_price[edge])
    inflow = sums(site, np.maximum(flow, 0.0), len(site_prices))
    shares = np.minimum(site_prices, inflow) / np.where(inflow > 0.0, inflow, 1.0)
    row_of = np.zeros(len(site_prices), dtype=np.int64)
    row_of[game.sites] = np.arange(len(game.sites))
    arcs, unavoidable = _arcs(faces, np.clip(circulation.through, -capacity, capacity),
                              np.where(flow > 0.0, flow * shares[site], flow), row_of[site],
                              circulation.face)
    bound = float(site_prices[game.sites[unavoidable]].sum()) - (
        price * budget.limit if price > 0.0 else 0.0)
    winding = []
    for cycle, weight in simple_cycles(arcs.tail, arcs.head, arcs.size):
        winds = abs(int(arcs.gain[cycle].sum()))
        bound += weight * min(winds, 1)
        if winds > 1:
            winding.append((weight, winds, cycle))
    if not winding:
        return bound
    routes = _Crossings(faces)
    for weight, winds, cycle in sorted(winding, key=lambda curve: -curve[0] * (curve[1] - 1)):
        if bound >= target or time.monotonic() > deadline:
            break
        link, row = arcs.link[cycle], np.unique(arcs.row[cycle])
        bound += weight * (routes.least_met(link[link >= 0], row[row >= 0], winds) - 1)
    return bound


class _Arcs(NamedTuple):
    """Arcs (K,) of a circulation with flow ``size``, from ``tail`` to ``head``.

    Nodes are the faces, then the parts of the discs' rims. An arc either crosses a ``link`` or
    leads into or out of the disc in a ``row`` of the game; the other number is -1. ``gain`` is what
    the arc adds to the winding number.
    """

    tail: IndexArray
    head: IndexArray
    gain: IndexArray
    size: FloatArray
    link: IndexArray
    row: IndexArray


def _arcs(faces: Faces, through: FloatArray, disc_flow: FloatArray, row: IndexArray,
          face: IndexArray) -> tuple[_Arcs, IndexArray]:
    """Arcs of flows ``through`` links (L,), and from ``face`` (T,) into the discs of ``row`` (T,).

    A curve passes a disc only within one part of its rim, so it does not cross the secured area.
    Every route meets an unavoidable disc, around which winding is not defined: flow into such discs
    is left out, and their rows (K,) are returned as well.
    """
    pair, link = np.flatnonzero(disc_flow), np.flatnonzero(through)
    rows, disc = np.unique(row, return_inverse=True)
    discs = faces.discs(csr_matrix(faces.game.entering[rows]))
    tail, head = faces.left[link], faces.right[link]
    gain, flow, arc_row = faces.crossed[link], through[link], np.full(len(link), -1)
    if len(pair) and len(discs.face):
        key = discs.disc * faces.count + discs.face
        wanted = disc.ravel()[pair] * faces.count + face[pair]
        place = np.minimum(np.searchsorted(key, wanted), len(key) - 1)
        found = (key[place] == wanted) & ~discs.unavoidable[disc.ravel()[pair]]
        place, pair = place[found], pair[found]
        tail = np.concatenate((tail, face[pair]))
        head = np.concatenate((head, faces.count + discs.part[place]))
        gain = np.concatenate((gain, discs.offset[place]))
        flow = np.concatenate((flow, disc_flow[pair]))
        arc_row = np.concatenate((arc_row, row[pair]))
    forward, size = flow > 0.0, np.abs(flow)
    kept = size > NEGLIGIBLE * size.max(initial=0.0)
    arcs = _Arcs(*(each[kept] for each in (
        np.where(forward, tail, head), np.where(forward, head, tail),
        np.where(forward, gain, -gain), size,
        np.append(link, np.full(len(arc_row) - len(link), -1)), arc_row)))
    return arcs, rows[discs.unavoidable]


class _Crossings:
    """Counts how often every route of a leg meets a curve."""

    def __init__(self, faces: Faces) -> None:
        network = faces.game.network
        self._edge = np.flatnonzero(faces.game.playable)
        self._tail, self._head = network.edges[self._edge].T
        self._count, self._ends = faces.game.node_count, (network.source, network.target)
        self._link, self._entering = faces.link[self._edge], faces.game.entering

    def least_met(self, links: IndexArray, rows: IndexArray, winds: int) -> int:
        """Least number of a curve's links and sites that a route meets, at most ``winds``.

        A site counts once, a link each time. The search sets labels, each with the sites met, on
        the regions into which links and sites divide the network. After ``MAX_LABELS`` it returns
        the number that no route is below.
        """
        entering = csr_matrix(self._entering[rows][:, self._edge]).tocoo()
        sites = np.zeros(len(self._edge), dtype=object)
        np.bitwise_or.at(sites, entering.col, np.array([1 << row for row in entering.row.tolist()],
                                                dtype=object))
        crossing = np.isin(self._link, links)
        free = ~crossing & (sites == 0)
        joined = csr_matrix((np.ones(free.sum()), (self._tail[free], self._head[free])),
                            (self._count, self._count))
        region = connected_components(joined, connection='strong')[1]
        source, target = region[list(self._ends)].tolist()
        steps: dict[int, set[tuple[int, int, bool]]] = {}
        tails, heads = region[self._tail], region[self._head]
        for k in np.flatnonzero(tails != heads).tolist():
            steps.setdefault(int(tails[k]), set()).add(
                (int(heads[k]), sites[k], bool(crossing[k])))
        queue, labels = [(0, 0, 0, source)], set[tuple[int, int, int]]()
        while queue:
            met, crossed, known, place = heapq.heappop(queue)
            if place == target or len(labels) == MAX_LABELS:
                return met
            if (crossed, known, place) in labels:
                continue
            labels.add((crossed, known, place))
            for head, entered, is_crossed in steps.get(place, ()):
                number = crossed + is_crossed + (known | entered).bit_count()
                if number < winds:
                    heapq.heappush(queue, (number, crossed + is_crossed, known | entered, head))
        return winds
