# SPDX-License-Identifier: Apache-2.0
"""The least value on planar two-way networks within their length budgets: an LP in face potentials.

Every flow of size 1 on a leg is the flow of one reference route plus the differences of a potential
of the faces. Its level lines, driven as routes, meet disc j at most as often as the potential
varies on the rim of the disc. So the least value is the least z for which some potentials vary on
the rims of disc j by at most z / alpha_j, added up over the legs, and keep the budgets
(docs/theory.md, section 7). For a fixed z, and weights of the legs that add up to 1, the least
weighted length is a linear program. Its dual is a circulation between faces for each leg: through
links, at most their weighted shares of the budget, and through discs, where no leg's flow exceeds
what all share. The discs' flows are an ambusher, and Newton's method on z gives the bound that
this ambusher proves. Mixtures of the potentials that were found on the way keep all budgets: the
least value of these is the value, and its prices of the budgets are the next weights. New sites,
and faces at which a disc exceeds its share, are new columns of the same model.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix, vstack
from scipy.sparse.csgraph import dijkstra

from ...arrays import ROUNDING, BoolArray, FloatArray, IndexArray
from ...errors import SolverFailed
from ..ambusher import Ambush
from ..budget import BUDGET_TOLERANCE, Budget
from ..distribution.acyclic import without_cycles
from ..distribution.chain import conserved_strategy
from ..faces import Circulation, Faces
from ..legs import Legs
from ..route_sampler import route_edges, shortest_route, shortest_route_strategy
from ..tolerance import within
from . import highs
from .face_flows import FaceFlows


class PotentialSearch(NamedTuple):
    """The constants of the search for z."""

    precision: float = 5e-3  # largest, relative: of z, and of the share at which faces join
    step: float = 0.9  # factor by which z falls at most at once, until a budget is exceeded
    # While the budgets are kept, z stays if more than this share of the discs' columns is new: at a
    # lower z, most of the columns that join would not be needed in the end.
    many: float = 0.03
    endless: float = 1.0 / BUDGET_TOLERANCE  # flow through a disc: z is infeasible
    points: int = 24  # most potentials of which mixtures are made
    near: float = 0.2  # share of the value below which a site's largest loss is left out of these
    follow: float = 0.8  # how far the legs' weights go towards the prices of a mixture at once
    stalls: int = 8  # rounds without a better value or bound after which a search ends


POTENTIAL = PotentialSearch()


class _Point(NamedTuple):
    """Potentials (F,) of all faces, how often they hit (legs, S), and shares (legs,) of budgets."""

    potential: FloatArray
    hits: FloatArray
    used: FloatArray


class Potential:
    """The LP of all legs, at first with the game's sites; ``solve`` goes on from where it is.

    Attributes
    ----------
    bound : float
        No strategy has a smaller value, as the ambusher proves who waits at the sites by ``q``
        (S,) and has the ``prices`` (legs,) of the budgets.
    value : float
        What the ``flow`` costs at the sites so far.
    """

    apart = 0.0  # of sites that join at once [reaches]

    def __init__(self, legs: Legs, faces: Sequence[Faces], gap: float,
                 first: float = np.inf) -> None:
        """The search for z begins at ``first``, or at half the largest loss a leg if less."""
        self.legs, count = legs, len(faces)
        self.tighten(gap)
        self._z, self.bound, self.value = first, 0.0, np.inf
        self.q, self.prices = np.zeros(0), np.zeros(count)
        self._circulations: tuple[Circulation, ...] = ()
        self._weights = np.full(count, 1.0 / count)
        self._loss, self._unavoidable = np.zeros(0), np.zeros((count, 0), dtype=bool)
        self._entering = csr_matrix((0, legs.edge_count))
        # Pairs of a face and a part of a rim, part by part; the leg, site and row of each part.
        self._face, self._offset, self._part, self._first = (
            np.zeros(0, dtype=np.int64) for _ in range(4))
        self._part_leg, self._part_site, self._part_row = (
            np.zeros(0, dtype=np.int64) for _ in range(3))
        # Columns: the pairs that joined, up out of a face or down into one; those of sites, and
        # the rows of legs at sites, if there is more than one leg.
        self._joined, self._columns = (np.zeros(0, dtype=np.int64) for _ in range(2))
        self._up, self._site_column = np.zeros(0, dtype=bool), np.zeros(0, dtype=np.int64)
        self._share_row = np.zeros((count, 0), dtype=np.int64)
        self._blend = np.zeros((0, 0))  # (legs, points)
        self._flows = FaceFlows()
        self._face_first = np.cumsum([0, *(each.count for each in faces)])
        self._rows = self._flows.add_nodes(int(self._face_first[-1]))
        self._legs = [_LegLinks(each, budget, first)
                      for each, budget, first in zip(faces, legs.budgets, self._face_first,
                                                     strict=False)]
        self._start_with_links()
        self._potential = np.zeros(len(self._rows))
        # The first point: the shortest routes, which are within all budgets.
        used = np.array([leg.used_budget(self._potential) for leg in self._legs])
        self._points = [_Point(self._potential, np.zeros((count, 0)), used)]
        self.add_sites(legs.entering, legs.loss)

    def add_sites(self, entering: csr_matrix, loss: FloatArray) -> None:
        """Add sites with the edges that enter their discs, (K, M), and their losses (K,)."""
        known, count = len(self._loss), len(loss)
        unavoidable = []
        for number, (leg, rows) in enumerate(zip(self._legs, self.legs.rows_by_leg(entering),
                                                 strict=True)):
            discs = leg.faces.discs(rows)
            order = np.argsort(discs.part, kind='stable')
            first = np.unique(discs.part[order], return_index=True)[1]
            parts = len(self._part_leg)
            self._first = np.append(self._first, len(self._face) + first)
            self._face = np.append(self._face, leg.first_face + discs.face[order])
            self._offset = np.append(self._offset, discs.offset[order])
            self._part = np.append(self._part, parts + discs.part[order])
            self._part_leg = np.append(self._part_leg, np.full(len(first), number))
            self._part_site = np.append(self._part_site, known + discs.disc[order][first])
            self._part_row = np.append(self._part_row, self._flows.add_nodes(len(first)))
            unavoidable.append(discs.unavoidable)
        self._loss, self.q = np.append(self._loss, loss), np.append(self.q, np.zeros(count))
        self._unavoidable = np.hstack((self._unavoidable, unavoidable))
        self._entering = csr_matrix(vstack((self._entering, entering)))
        self._site_column = np.append(self._site_column, np.full(count, -1))
        self._share_row = np.hstack((self._share_row, np.full((len(self._legs), count), -1)))
        self._points = [point._replace(hits=np.hstack((point.hits, self._hits(
            point.potential, known)))) for point in self._points]
        certain = self._loss * self._unavoidable.sum(axis=0)  # every route of a leg meets the site
        if certain.max(initial=0.0) > self.bound:
            self.bound, self.prices = float(certain.max()), np.zeros(len(self._legs))
            self._circulations = ()
            self.q = np.zeros(len(certain))
            self.q[certain.argmax()] = 1.0
        self._mix(math.inf)

    def tighten(self, gap: float) -> None:
        """Let the next ``solve`` find z to another relative gap."""
        least = 2.0 / POTENTIAL.endless  # an endless flow proves no more
        self._precision = min(max(gap, least), POTENTIAL.precision)

    def solve(self, deadline: float) -> None:
        """Find z: from above in steps, from below by the bounds that ambushers prove.

        Raises TimeLimit at the ``deadline`` (``time.monotonic``), or SolverFailed; what was found
        until then counts.
        """
        if not len(self._loss) or not any(len(leg.real) for leg in self._legs):
            self.value = self.bound  # or there is but one route
            return
        z = max(min(self._z, self._loss.max() * len(self._legs) / 2.0), self.bound)
        if self.bound == 0.0 and self.legs.avoiding(self._entering):
            z = 0.0  # unless the routes that avoid all sites exceed a budget
        self._join(z)
        stalled = 0
        while stalled < POTENTIAL.stalls:
            keeps_budgets, before = self._solve_at(z, deadline), (self.value, self.bound)
            new = self._join(z)
            if keeps_budgets and new > POTENTIAL.many * len(self._joined):
                continue
            if keeps_budgets and len(self._legs) == 1:
                self._use_last()  # a mixture with others costs more
            else:
                self._mix(deadline)
            self._z = z
            if within(self.value, self.bound, self._precision):
                return
            gained = self.value < before[0] * (1.0 - ROUNDING) or (
                self.bound > before[1] * (1.0 + ROUNDING))
            stalled = 0 if gained or new else stalled + 1
            z = (max(self.bound, POTENTIAL.step * min(z, self.value)) if keeps_budgets
                 else self.bound * (1.0 + self._precision / 2.0))
            self._join(z)

    @property
    def flow(self) -> FloatArray:
        """The strategies (M,) of the legs, without cycles and within the budgets."""
        found = []
        for number, leg in enumerate(self._legs):
            game, budget = leg.faces.game, leg.budget
            shortest = shortest_route_strategy(game, budget.cost)
            p = None
            if (potential := self._best_potential(number)) is not None:
                p = conserved_strategy(game, leg.faces.flow(potential), ROUNDING)
            if p is None:
                found.append(shortest)
                continue
            used = float(p[p > 0.0] @ budget.reduced_cost[p > 0.0])
            share = min(budget.margin / used, 1.0) if used > 0.0 else 1.0
            found.append(without_cycles(game.network, share * p + (1.0 - share) * shortest))
        return np.concatenate(found)

    @property
    def ambush(self) -> Ambush:
        """The ambusher who proves the bound."""
        return Ambush(self.q, self.prices, self._circulations)

    def level_lines(self, count: int) -> list[list[IndexArray]]:
        """Routes of each leg, as its edges, along ``count`` level lines: about the flow."""
        found = []
        for number, leg in enumerate(self._legs):
            network, potential = leg.faces.game.network, self._best_potential(number)
            edges: list[IndexArray] = []
            if potential is not None:
                edges = [np.flatnonzero(leg.faces.flow(np.floor(potential - level)))
                         for level in (np.arange(count) + 0.5) / count]
            found.append([route_edges(network, shortest_route(network, edge, leg.budget.cost))
                          for edge in edges])
        return found

    def _best_potential(self, number: int) -> FloatArray | None:
        """The mixture of potentials of a leg's faces; None before there is any."""
        if not self._blend.size:
            return None
        own = slice(self._face_first[number], self._face_first[number + 1])
        known = self._points[: self._blend.shape[1]]
        return np.asarray(sum(share * point.potential[own] for share, point in zip(
            self._blend[number], known, strict=True)))

    def _start_with_links(self) -> None:
        """The model without discs at its optimum: links of the shortest-path tree are full."""
        start = []
        for leg, weight in zip(self._legs, self._weights, strict=True):
            faces, real = leg.faces, leg.real
            rows = self._rows[leg.first_face + np.column_stack((faces.left, faces.right))[real]]
            high = weight * leg.capacity[real]
            leg.columns = self._flows.add_columns(
                rows, np.tile([1.0, -1.0], (len(real), 1)), -faces.crossed[real].astype(np.float64),
                -high, high)
            self._flows.release(int(self._rows[leg.first_face]))
            start.append(leg.full_links())
        self._flows.start_at(np.concatenate(start))

    def _heights(self, potential: FloatArray, first: int = 0) -> FloatArray:
        """The potential at each pair of a face and a part, from pair ``first`` on."""
        return np.asarray(potential[self._face[first:]] + self._offset[first:])

    def _spreads(self, height: FloatArray, begins: IndexArray) -> FloatArray:
        """Return the potential's range on each part of a rim; parts begin at pairs ``begins``."""
        if not len(begins):
            return np.zeros(0)
        return np.asarray(np.maximum.reduceat(height, begins) - np.minimum.reduceat(height, begins))

    def _hits(self, potential: FloatArray, first_site: int = 0) -> FloatArray:
        """Return the hits of the level lines by each site (legs, K), from ``first_site`` on."""
        hits = np.zeros((len(self._legs), len(self._loss) - first_site))
        parts = np.flatnonzero(self._part_site >= first_site)
        if len(parts):
            at = int(self._first[parts[0]])  # later sites have later parts
            spread = self._spreads(self._heights(potential, at), self._first[parts] - at)
            np.maximum.at(hits, (self._part_leg[parts], self._part_site[parts] - first_site),
                          spread)
        return np.where(self._unavoidable[:, first_site:], 1.0, hits)

    def _join(self, z: float) -> int:
        """Add the extreme faces of the discs that exceed z, and those just too far apart.

        Where several legs meet a disc, each counts in proportion to how much it varies. Returns the
        number of pairs that are new.
        """
        height = self._heights(self._potential)
        spread = self._spreads(height, self._first)
        hits = self._hits(self._potential)
        site, fixed = self._part_site, self._unavoidable.sum(axis=0)
        most = z * (1.0 + self._precision / 2.0) / self._loss
        over = (hits.sum(axis=0) > most + ROUNDING)[site] & (spread > ROUNDING)
        over &= ~self._unavoidable[self._part_leg, site]
        left = np.maximum(most - fixed, 0.0) / np.maximum(hits.sum(axis=0) - fixed, ROUNDING)
        last, pairs = np.append(self._first[1:], len(self._face)), []
        for part in np.flatnonzero(over).tolist():
            order = self._first[part] + height[self._first[part] : last[part]].argsort()
            ordered, limit = height[order], spread[part] * left[site[part]]
            above = order[min(ordered.searchsorted(ordered[0] + limit, 'right'), len(order) - 1)]
            below = order[max(ordered.searchsorted(ordered[-1] - limit) - 1, 0)]
            pairs += [2 * order[-1] + 1, 2 * above + 1, 2 * order[0], 2 * below]
        known = 2 * self._joined + self._up
        new, up = np.divmod(np.setdiff1d(np.array(pairs, dtype=np.int64), known), 2)
        if len(new):
            self._add_pairs(new, up == 1)
        return len(new)

    def _add_pairs(self, pair: IndexArray, up: BoolArray) -> None:
        """Add the columns of pairs (K,): out of the face into the disc if ``up``, or back."""
        part, face = self._part[pair], self._rows[self._face[pair]]
        disc, leg, site = self._part_row[part], self._part_leg[part], self._part_site[part]
        if len(self._legs) > 1:
            self._share_sites(leg, site)
        rows = np.column_stack((np.where(up, face, disc), np.where(up, disc, face),
                                self._share_row[leg, site]))
        none, high = np.zeros(len(pair)), np.full(len(pair), POTENTIAL.endless)
        columns = self._flows.add_columns(rows, np.tile([1.0, -1.0, 0.5], (len(pair), 1)),
                                          none, none, high)
        self._joined, self._up = np.append(self._joined, pair), np.append(self._up, up)
        self._columns = np.append(self._columns, columns)
        if len(self._legs) > 1:  # otherwise costs depend on z
            self._flows.change_costs(columns, self._turned(pair, up))

    def _share_sites(self, leg: IndexArray, site: IndexArray) -> None:
        """Give sites (K,) columns, and legs (K,) rows at them, where they have none."""
        new = np.unique(site[self._site_column[site] < 0])
        none, count = np.zeros(len(new)), len(new)
        self._site_column[new] = self._flows.add_columns(
            np.full((count, 1), -1), np.zeros((count, 1)), none, none,
            np.full(count, POTENTIAL.endless))
        pairs = np.unique(np.column_stack((leg, site))[self._share_row[leg, site] < 0], axis=0)
        rows = self._flows.add_shares(len(pairs))
        self._share_row[tuple(pairs.T)] = rows
        self._flows.set_entries(rows, self._site_column[pairs[:, 1]], -1.0)

    def _turned(self, pair: IndexArray, up: BoolArray) -> FloatArray:
        return np.where(up, -1.0, 1.0) * self._offset[pair]

    def _solve_at(self, z: float, deadline: float) -> bool:
        """Solve for a fixed z and keep what it proves; True if the potentials keep all budgets.

        What flows through a disc enters and leaves it by columns of their own, so each counts half.
        """
        site = self._part_site[self._part[self._joined]]
        if len(self._legs) == 1:
            self._flows.change_costs(self._columns, z / self._loss[site] / 2.0
                                     + self._turned(self._joined, self._up))
        else:
            shared = np.flatnonzero(self._site_column >= 0)
            self._flows.change_costs(self._site_column[shared], z / self._loss[shared]
                                     - self._unavoidable[:, shared].sum(axis=0))
        found = self._flows.solve(deadline)
        if len(self._legs) == 1:
            flow = np.maximum(found.x[self._columns], 0.0) / 2.0
            through = np.bincount(site, flow, len(self._loss))
        else:
            flow = through = np.where(self._site_column >= 0,
                                      np.maximum(found.x[self._site_column], 0.0), 0.0)
        ambush = through / self._loss
        bridges = [leg.bridges for leg in self._legs]
        total, gain = float(ambush.sum()), float(self._weights @ bridges) - found.cost
        potential = found.potential[self._rows]
        self._potential = potential - np.repeat(potential[self._face_first[:-1]],
                                                np.diff(self._face_first))
        used = np.array([leg.used_budget(self._potential) for leg in self._legs])
        self._points.append(_Point(self._potential, self._hits(self._potential), used))
        limited = float(self.legs.budgets[0].is_limited)
        proved = z + (gain - limited) / total if total > 0.0 else 0.0
        if proved > self.bound:
            self.bound, self.q = proved, ambush / total
            limits = np.array([budget.limit for budget in self.legs.budgets])
            self.prices = self._weights / (total * limits)
            self._circulations = self._scaled_circulations(found.x, total)
        endless = bool((flow > POTENTIAL.endless * (0.5 - ROUNDING)).any())
        return gain <= limited + self._precision and not endless

    def _scaled_circulations(self, x: FloatArray, total: float) -> tuple[Circulation, ...]:
        """The flows of a solution, divided by what adds up to 1 at the sites."""
        flow = np.maximum(x[self._columns], 0.0) * np.where(self._up, 1.0, -1.0) / total
        part = self._part[self._joined]
        used = np.flatnonzero(flow * self.q[self._part_site[part]])  # elsewhere it is rounding
        found = []
        for number, (leg, weight) in enumerate(zip(self._legs, self._weights, strict=True)):
            own = used[self._part_leg[part[used]] == number]
            through = weight * leg.capacity * leg.faces.crossed
            through[leg.real] = x[leg.columns]
            found.append(Circulation(
                through / total, self._part_site[part[own]],
                self._face[self._joined[own]] - leg.first_face, flow[own]))
        return tuple(found)

    def _use_last(self) -> None:
        """Take the last potential, which keeps the budget."""
        self._points = self._points[-POTENTIAL.points :]
        self._blend = np.eye(1, len(self._points), len(self._points) - 1)
        self.value = float((self._loss * self._points[-1].hits[0]).max(initial=0.0))

    def _mix(self, deadline: float) -> None:
        """Find the mixture of potentials of least value within the budgets, and the next weights.

        A linear program with a row for each site and each budget.
        """
        count, points = len(self._legs), self._points
        losses = self._loss * np.stack([point.hits for point in points], axis=1)  # legs, points, S
        near, value = losses.max(axis=1).sum(axis=0), losses.sum(axis=0).max(axis=1, initial=0.0)
        # At others, no mixture costs as much.
        rows = np.flatnonzero(near >= max(self.bound * (1.0 - ROUNDING),
                                          POTENTIAL.near * value.min()))
        used = np.stack([point.used for point in points], axis=1)
        size = used.size
        unit = float(near.max(initial=0.0)) or 1.0
        sites = np.column_stack((losses[..., rows].reshape(size, -1).T / unit,
                                 np.full(len(rows), -1.0)))
        legs = np.repeat(np.eye(count), len(points), axis=1)  # which columns are of which leg
        budgets = np.column_stack((legs * used.ravel(), np.zeros(count)))
        one = csr_matrix(np.column_stack((legs, np.zeros(count))))
        lp = highs.LP(np.append(np.zeros(size), 1.0), csr_matrix(np.vstack((sites, budgets))),
                      np.append(np.zeros(len(rows)), np.ones(count)), one, np.ones(count))
        try:
            result = highs.run(lp, 'simplex', deadline)
        except SolverFailed:
            return
        shares = np.maximum(result.x[:-1], 0.0).reshape(count, -1)
        shares /= shares.sum(axis=1, keepdims=True)
        prices = np.maximum(-np.asarray(result.ineqlin.marginals[len(rows) :]), 0.0)
        self.value = float((shares[..., None] * losses).sum(axis=(0, 1)).max(initial=0.0))
        kept = np.arange(len(points)) >= len(points) - POTENTIAL.points // 2
        kept |= shares.max(axis=0) > ROUNDING
        self._points = [point for point, keep in zip(points, kept, strict=True) if keep]
        self._blend = shares[:, kept]
        if count > 1 and prices.any():
            self._weights += POTENTIAL.follow * (prices / prices.sum() - self._weights)
            for leg, weight in zip(self._legs, self._weights, strict=True):
                self._flows.change_limits(leg.columns, weight * leg.capacity[leg.real])


class _LegLinks:
    """The links of a leg's faces, with the shares of its budget that they take.

    ``first_face`` is the number of its first face among all legs' faces. ``real`` links have two
    faces; the others are bridges, and what all routes take for these is ``bridges``.
    """

    columns: IndexArray

    def __init__(self, faces: Faces, budget: Budget, first_face: int) -> None:
        self.faces, self.budget, self.first_face = faces, budget, int(first_face)
        game = faces.game
        edge = np.flatnonzero(game.playable)
        self._cost = np.zeros(len(faces.left))
        self._cost[faces.link[edge]] = budget.cost[edge]
        self.capacity = self._cost / budget.limit
        self.real = np.flatnonzero(faces.left != faces.right)
        bridges = self.capacity * np.abs(faces.crossed)
        self.bridges = float(bridges[faces.left == faces.right].sum())

    def full_links(self) -> IndexArray:
        """Return the real links (K,) to begin with: 1 or -1 on shortest paths, else 0."""
        game, faces = self.faces.game, self.faces
        edge, ends = np.flatnonzero(game.playable), np.zeros((2, len(faces.left)), dtype=np.int64)
        ends[:, faces.link[edge]] = np.sort(game.network.edges[edge], axis=1).T
        both = np.concatenate((ends, ends[::-1]), axis=1)
        graph = csr_matrix((np.tile(self._cost, 2), both), (game.node_count,) * 2)
        before = dijkstra(graph, indices=game.network.source, return_predecessors=True)[1]
        low, high = ends[:, self.real]
        return np.where(before[high] == low, 1, np.where(before[low] == high, -1, 0))

    def used_budget(self, potential: FloatArray) -> float:
        """Share of the budget that the flow of a potential of all faces takes."""
        own = potential[self.first_face : self.first_face + self.faces.count]
        through = self.faces.crossed + own[self.faces.left] - own[self.faces.right]
        return float(self.capacity @ np.abs(through))
