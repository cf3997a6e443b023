# SPDX-License-Identifier: Apache-2.0
"""The bound that a circulation between faces proves on a planar two-way network.

A closed curve through faces and discs whose signed crossings of one route do not add up to 0
separates the source from the target, so every route meets it: the route drives one of the curve's
links, or the curve's sites hit it. Let curves c of weights w_c go through each link with at most
``price`` times its cost, and through disc j with at most q_j alpha_j in all. Then for every route

    price * cost(route) + sum of q_j alpha_j over the sites that hit it  >=  sum of all w_c,

since what the curves through one disc add up to is paid once if the route is hit there. The mean
over a strategy within the budget is a bound on its value (docs/theory.md, Proposition 7.3). A
circulation is such curves, added up: it is decomposed into simple cycles, and those whose
crossings add up to 1 count. A curve that winds around an end more than once counts as often unless
some route spirals through it: a search over labels finds the least that any route pays of what the
other curves leave.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.sparse import csr_matrix

from ...arrays import FloatArray, IndexArray, sums
from ...errors import SolverFailed
from ..faces import Circulation, Faces
from .best_response import NEGLIGIBLE, SEARCHES, TripNetworks


def curve_bound(faces: Faces, cost: FloatArray, limit: float, dual_weights: FloatArray,
                price: float, given: Circulation, deadline: float = math.inf,
                enough: float = math.inf) -> float:
    """What a circulation proves about strategies with a mean ``cost`` (M,) of at most ``limit``.

    ``dual_weights`` (N,) are q_j alpha_j at each node. Flow beyond a dual weight, or beyond a
    link's share of the price, counts for nothing. Curves that wind more than once count once if
    that proves ``enough``; else the rest of the dual weights may prove more, which takes seconds,
    but no longer than to ``deadline`` (``time.monotonic``). Raises SolverFailed if the circulation
    is that of another network.
    """
    game, given = faces.game, given.at(dual_weights > 0.0)
    if len(given.through) != len(faces.left):
        raise SolverFailed('the circulation is that of another network')
    edge, most = np.flatnonzero(game.playable), np.full(len(faces.left), np.inf)
    np.minimum.at(most, faces.link[edge], price * cost[edge])
    through = np.clip(given.through, -most, most)
    passed = sums(given.site, np.maximum(given.flow, 0.0), len(dual_weights))
    fits = np.minimum(dual_weights, passed) / np.where(passed > 0.0, passed, 1.0)
    inside = np.where(given.flow > 0.0, given.flow * fits[given.site], given.flow)
    arcs = np.flatnonzero(through), np.flatnonzero(inside)
    site, row = np.unique(given.site, return_inverse=True)
    entering = game.hits[np.searchsorted(game.sites, site)]
    pair, offset, part = _winding_offsets(faces, csr_matrix(entering), row.ravel(), given.face)
    tail = np.concatenate((faces.left[arcs[0]], given.face[arcs[1]]))
    head = np.concatenate((faces.right[arcs[0]], faces.count + part[arcs[1]]))
    gain = np.concatenate((faces.crossed[arcs[0]], offset[arcs[1]]))
    flow = np.concatenate((through[arcs[0]], (inside * pair)[arcs[1]]))
    tail, head = np.where(flow > 0.0, tail, head), np.where(flow > 0.0, head, tail)
    gain, size = np.where(flow > 0.0, gain, -gain), np.abs(flow)
    kept = np.flatnonzero(size > NEGLIGIBLE * size.max(initial=0.0))
    total, winding, once = _curves(tail[kept], head[kept], gain[kept], size[kept])
    if winding > 0.0 and total + winding - price * limit >= enough:
        total += winding
    elif winding > 0.0:
        used = np.zeros(len(size))
        used[kept] = once
        across, into = np.split(used, [len(arcs[0])])
        left = np.append(np.where(np.isfinite(most), most, 0.0), 0.0)  # 0 for unplayable edges
        left[arcs[0]] -= across
        site, leg = given.site[arcs[1]], faces.leg(given.face[arcs[1]])
        enters = (inside[arcs[1]] > 0.0).astype(np.float64)
        others = np.maximum(dual_weights - sums(site, into * enters, len(dual_weights)), 0.0)
        winds = (size[len(arcs[0]) :] - into) * enters
        shares = others * _shares_of_legs(leg, site, winds, faces, len(others))
        cost, wanted = np.maximum(left, 0.0)[faces.link], enough - total + price * limit
        proved = sum(each.network.least_cost(cost, shares[each.number, game.sites], SEARCHES,
                                             deadline, wanted)[0]
                     for each in TripNetworks(game, game.hits).legs)
        total += max(winding, proved)
    return max(total - price * limit, 0.0) if price > 0.0 else total


def _shares_of_legs(leg: IndexArray, site: IndexArray, winds: FloatArray, faces: Faces,
                    count: int) -> FloatArray:
    """Shares (legs, count) of the sites, in proportion to the flows ``winds`` (T,) into them."""
    legs = len(faces.first)
    flow = sums(leg * count + site, winds, legs * count).reshape(legs, count)
    through = flow.sum(axis=0)
    return np.where(through > 0.0, flow / np.where(through > 0.0, through, 1.0), 1.0 / legs)


def _winding_offsets(faces: Faces, entering: csr_matrix, row: IndexArray,
                     face: IndexArray) -> tuple[FloatArray, IndexArray, IndexArray]:
    """Whether each pair (T,) of a disc and a face exists, as 0 or 1, its winding offset, its part.

    A curve passes a disc only within one part of its rim: it does not cross the secured area.
    Pairs of a disc around an end count as missing: its winding offsets depend on the way.
    """
    discs = faces.discs(entering)
    if not len(discs.face):
        return np.zeros(len(row)), row * 0, row * 0
    key, wanted = discs.disc * faces.count + discs.face, row * faces.count + face
    at = np.minimum(np.searchsorted(key, wanted), len(key) - 1)
    found = (key[at] == wanted) & ~discs.around[row]
    offset = np.where(found, discs.offset[at], 0)
    return found.astype(np.float64), offset, discs.part[at]


def _curves(tail: IndexArray, head: IndexArray, gain: IndexArray,
            size: FloatArray) -> tuple[float, float, FloatArray]:
    """Take a circulation on arcs (K,) apart into simple cycles.

    Returns the weight of those of gain 1 or -1, that of those of a larger gain, and the flow (K,)
    of the former. What rounding leaves unbalanced ends a walk and is lost.
    """
    order = np.argsort(tail, kind='stable')
    tail, heads = tail[order], head[order].tolist()
    gains, left = gain[order].tolist(), size[order].tolist()
    nodes = int(max(tail.max(initial=0), head.max(initial=0))) + 1
    arcs = np.searchsorted(tail, np.arange(nodes + 1)).tolist()
    free, ends, once, winding = arcs[:-1], arcs[1:], 0.0, 0.0
    used = [0.0] * len(left)
    for start in np.unique(tail).tolist():
        walk: list[int] = []
        node, place = start, {start: 0}
        while True:
            while free[node] < ends[node] and left[free[node]] <= 0.0:
                free[node] += 1
            if free[node] == ends[node]:  # nothing leads on
                if not walk:
                    break
                left[walk.pop()] = 0.0
                del place[node]
                node = start if not walk else heads[walk[-1]]
                continue
            walk.append(free[node])
            node = heads[walk[-1]]
            if node in place:
                cycle = walk[place[node] :]
                least = min(left[arc] for arc in cycle)
                winds = abs(sum(gains[arc] for arc in cycle))
                once += least * (winds == 1)
                winding += least * (winds > 1)
                for arc in cycle:
                    left[arc] -= least
                    used[arc] += least * (winds == 1)
                    del place[heads[arc]]
                del walk[len(walk) - len(cycle) :]
                place[node] = len(walk)
            else:
                place[node] = len(walk)
    flow = np.empty(len(used))
    flow[order] = used
    return once, winding, flow
