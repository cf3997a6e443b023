# SPDX-License-Identifier: Apache-2.0
"""The least value on a planar two-way network within its length budget: an LP in face potentials.

Every flow of size 1 is the flow of a reference route plus the differences of a potential of the
faces. Its level lines, driven as routes, meet disc j at most as often as the potential varies on
the disc's rim. So the least value is the least z for which some potential varies by at most
z / alpha_j on the rim of disc j and keeps the budget (docs/theory.md, section 7).

For a fixed z, the least length is an LP, whose dual is solved here: a circulation between faces,
through links, up to their shares of the budget, and through discs. The flows through the discs are
an ambusher's strategy, and Newton's method on z gives the bound that it certifies. The value is
that of the best mixture, within the budget, of the potentials found on the way. New sites, and
faces at which a disc exceeds its cap, are new columns of the same model.
"""

from __future__ import annotations

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
from ..route_sampler import shortest_route_strategy
from ..tolerance import within
from . import highs
from .face_flows import FaceFlows
from .mixtures import mixture_lp


class PotentialSearch(NamedTuple):
    """Constants of the search for z."""

    precision: float = 5e-3  # largest relative precision, of z and of separation
    step: float = 0.9  # factor by which z falls at most at once, until a budget is exceeded
    # While the budgets are kept, z stays if more than this share of the discs' columns is new: at a
    # lower z, most of the columns added would not be needed in the end.
    many: float = 0.03
    endless: float = 1.0 / BUDGET_TOLERANCE  # flow through a disc from which on z is infeasible
    points: int = 24  # number of potentials of which mixtures are made
    near: float = 0.2  # share of the value below which a site is left out of these mixtures' LP
    stalls: int = 8  # rounds without a better value or bound after which the search ends


POTENTIAL = PotentialSearch()


class _Point(NamedTuple):
    """A potential (F,) of faces, its hits (S,) at the sites, and its share of the budget."""

    potential: FloatArray
    hits: FloatArray
    used: float


class Potential:
    """LP in the face potentials of a leg; ``solve`` resumes, and sites can be added in between.

    Attributes
    ----------
    bound : float
        Lower bound of the value, certified by the ambusher's strategy ``q`` (S,) with the ``price``
        of the budget.
    value : float
        Value of the ``flow`` at the known sites.
    """

    def __init__(self, legs: Legs, faces: Faces, gap: float, first: float = np.inf) -> None:
        """The search for z begins at ``first``, or at half the largest loss if that is less.

        ``legs`` has one leg, whose ``faces`` these are.
        """
        self.legs, self.faces, (self._budget,) = legs, faces, legs.budgets
        self.tighten(gap)
        self._z, self.bound, self.value = first, 0.0, np.inf
        self.q, self.price = np.zeros(0), 0.0
        self._circulations: tuple[Circulation, ...] = ()
        self._loss, self._unavoidable = np.zeros(0), np.zeros(0, dtype=bool)
        self._entering = csr_matrix((0, legs.edge_count))
        # Pairs of a face and a part of a rim, part by part; the site and row of each part.
        self._face, self._offset, self._part, self._first = (
            np.zeros(0, dtype=np.int64) for _ in range(4))
        self._part_site, self._part_row = (np.zeros(0, dtype=np.int64) for _ in range(2))
        # Columns: the pairs added, up out of a face or down into one.
        self._joined, self._columns = (np.zeros(0, dtype=np.int64) for _ in range(2))
        self._up = np.zeros(0, dtype=bool)
        self._blend = np.ones(1)  # (points,), of the first points
        self._flows = FaceFlows()
        self._rows = self._flows.add_nodes(faces.count)
        self._links = self._add_links()
        self._potential = np.zeros(faces.count)
        # The first point: the shortest route, which is within the budget.
        self._points = [_Point(self._potential, np.zeros(0),
                               self._links.used_budget(self._potential))]
        self.add_sites(legs.entering, legs.loss)

    def add_sites(self, entering: csr_matrix, loss: FloatArray) -> None:
        """Add sites with the edges that enter their discs, (K, M), and their losses (K,)."""
        known, parts, discs = len(self._loss), len(self._part_site), self.faces.discs(entering)
        order = np.argsort(discs.part, kind='stable')
        first = np.unique(discs.part[order], return_index=True)[1]
        self._first = np.append(self._first, len(self._face) + first)
        self._face = np.append(self._face, discs.face[order])
        self._offset = np.append(self._offset, discs.offset[order])
        self._part = np.append(self._part, parts + discs.part[order])
        self._part_site = np.append(self._part_site, known + discs.disc[order][first])
        self._part_row = np.append(self._part_row, self._flows.add_nodes(len(first)))
        self._loss, self.q = np.append(self._loss, loss), np.append(self.q, np.zeros(len(loss)))
        self._unavoidable = np.append(self._unavoidable, discs.unavoidable)
        self._entering = csr_matrix(vstack((self._entering, entering)))
        self._points = [point._replace(hits=np.append(point.hits, self._hits(
            point.potential, known))) for point in self._points]
        certain = self._loss * self._unavoidable  # every route meets the site
        if certain.max(initial=0.0) > self.bound:
            self.bound, self.price, self._circulations = float(certain.max()), 0.0, ()
            self.q = np.zeros(len(certain))
            self.q[certain.argmax()] = 1.0
        hits = np.stack([point.hits for point in self._points[: len(self._blend)]])
        self.value = float((self._blend @ (self._loss * hits)).max(initial=0.0))

    def tighten(self, gap: float) -> None:
        """Set the relative gap of the next ``solve``."""
        least = 2.0 / POTENTIAL.endless  # an endless flow proves no more
        self._precision = min(max(gap, least), POTENTIAL.precision)

    def solve(self, deadline: float) -> None:
        """Find z, from above in steps and from below by certified bounds.

        Raises TimeLimit at the ``deadline`` (``time.monotonic``), or SolverFailed; what was found
        before is kept.
        """
        if not len(self._loss) or not len(self._links.real):
            self.value = self.bound  # no sites, or a single route
            return
        z = max(min(self._z, self._loss.max() / 2.0), self.bound)
        if self.bound == 0.0 and self.legs.avoiding(self._entering):
            z = 0.0  # unless the routes that avoid all sites exceed the budget
        self._add_violated(z)
        stalled = 0
        while stalled < POTENTIAL.stalls:
            keeps_budget, before = self._solve_at(z, deadline), (self.value, self.bound)
            new = self._add_violated(z)
            if keeps_budget and new > POTENTIAL.many * len(self._joined):
                continue
            if keeps_budget:
                # The last potential alone: a mixture with others costs more.
                self._points = self._points[-POTENTIAL.points :]
                self._blend = np.eye(1, len(self._points), len(self._points) - 1)[0]
                self.value = float((self._loss * self._points[-1].hits).max(initial=0.0))
            else:
                self._mix(deadline)
            self._z = z
            if within(self.value, self.bound, self._precision):
                return
            gained = self.value < before[0] * (1.0 - ROUNDING) or (
                self.bound > before[1] * (1.0 + ROUNDING))
            stalled = 0 if gained or new else stalled + 1
            z = (max(self.bound, POTENTIAL.step * min(z, self.value)) if keeps_budget
                 else self.bound * (1.0 + self._precision / 2.0))
            self._add_violated(z)

    @property
    def flow(self) -> FloatArray:
        """Acyclic strategy (M,) within the budget."""
        budget, (game,) = self._budget, self.legs.games
        shortest = shortest_route_strategy(game, budget.cost)
        p = conserved_strategy(game, self.faces.flow(self._mixed_potential()), ROUNDING)
        if p is None:
            return shortest
        used = float(p[p > 0.0] @ budget.reduced_cost[p > 0.0])
        share = min(budget.margin / used, 1.0) if used > 0.0 else 1.0
        return without_cycles(game.network, share * p + (1.0 - share) * shortest)

    @property
    def ambush(self) -> Ambush:
        """The ambusher's strategy that certifies the bound."""
        return Ambush(self.q, np.array([self.price]), self._circulations)

    def _mixed_potential(self) -> FloatArray:
        known = self._points[: len(self._blend)]
        return np.asarray(sum(share * point.potential
                              for share, point in zip(self._blend, known, strict=True)))

    def _add_links(self) -> _Links:
        """Add the links at the optimum without discs: those of the shortest-path tree are full."""
        links, faces = _Links(self.faces, self._budget), self.faces
        real, high = links.real, links.capacity[links.real]
        links.columns = self._flows.add_arcs(
            self._rows[np.column_stack((faces.left, faces.right))[real]],
            np.tile([1.0, -1.0], (len(real), 1)), -faces.crossed[real].astype(np.float64),
            -high, high)
        self._flows.release(int(self._rows[0]))
        self._flows.start_at_limits(links.full_links())
        return links

    def _heights(self, potential: FloatArray, first: int = 0) -> FloatArray:
        """Potential at each pair of a face and a part, from pair ``first`` on."""
        return np.asarray(potential[self._face[first:]] + self._offset[first:])

    def _spreads(self, height: FloatArray, begins: IndexArray) -> FloatArray:
        """Range of the potential on each part of a rim; parts begin at the pairs ``begins``."""
        if not len(begins):
            return np.zeros(0)
        return np.asarray(np.maximum.reduceat(height, begins) - np.minimum.reduceat(height, begins))

    def _hits(self, potential: FloatArray, first_site: int = 0) -> FloatArray:
        """Hits (K,) of the level lines at the sites from ``first_site`` on."""
        hits = np.zeros(len(self._loss) - first_site)
        parts = np.flatnonzero(self._part_site >= first_site)
        if len(parts):
            begin = int(self._first[parts[0]])  # later sites have later parts
            spread = self._spreads(self._heights(potential, begin), self._first[parts] - begin)
            np.maximum.at(hits, self._part_site[parts] - first_site, spread)
        return np.where(self._unavoidable[first_site:], 1.0, hits)

    def _add_violated(self, z: float) -> int:
        """Separation: add columns at the faces whose potentials differ too much for z.

        On each part of a rim that exceeds z, these are the two extreme faces, and the face on
        either side that is just too far from the opposite extreme. Returns the number of new pairs.
        """
        height = self._heights(self._potential)
        spread = self._spreads(height, self._first)
        hits, site = self._hits(self._potential), self._part_site
        max_hits = z * (1.0 + self._precision / 2.0) / self._loss
        violated = ((hits > max_hits + ROUNDING) & ~self._unavoidable)[site] & (spread > ROUNDING)
        share = max_hits / np.maximum(hits, ROUNDING)
        end, pairs = np.append(self._first[1:], len(self._face)), []
        for part in np.flatnonzero(violated).tolist():
            order = self._first[part] + height[self._first[part] : end[part]].argsort()
            ordered, limit = height[order], spread[part] * share[site[part]]
            above = order[min(ordered.searchsorted(ordered[0] + limit, 'right'), len(order) - 1)]
            below = order[max(ordered.searchsorted(ordered[-1] - limit) - 1, 0)]
            pairs += [2 * order[-1] + 1, 2 * above + 1, 2 * order[0], 2 * below]
        known = 2 * self._joined + self._up
        new, up = np.divmod(np.setdiff1d(np.array(pairs, dtype=np.int64), known), 2)
        if len(new):
            self._add_pairs(new, up == 1)
        return len(new)

    def _add_pairs(self, pair: IndexArray, up: BoolArray) -> None:
        """Add the columns of pairs (K,): from the face into the disc if ``up``, else back."""
        face, disc = self._rows[self._face[pair]], self._part_row[self._part[pair]]
        rows = np.column_stack((np.where(up, face, disc), np.where(up, disc, face)))
        none, high = np.zeros(len(pair)), np.full(len(pair), POTENTIAL.endless)
        columns = self._flows.add_arcs(rows, np.tile([1.0, -1.0], (len(pair), 1)),
                                          none, none, high)
        self._joined, self._up = np.append(self._joined, pair), np.append(self._up, up)
        self._columns = np.append(self._columns, columns)

    def _solve_at(self, z: float, deadline: float) -> bool:
        """Solve for a fixed z and keep its bound; return whether the potential keeps the budget.

        Flow through a disc enters and leaves it by separate columns, so each counts half.
        """
        site = self._part_site[self._part[self._joined]]
        turned = np.where(self._up, -1.0, 1.0) * self._offset[self._joined]
        self._flows.change_costs(self._columns, z / self._loss[site] / 2.0 + turned)
        found = self._flows.solve(deadline)
        flow = np.maximum(found.x[self._columns], 0.0) / 2.0
        ambush = np.bincount(site, flow, len(self._loss)) / self._loss
        total, gain = float(ambush.sum()), self._links.bridges - found.cost
        potential = found.duals[self._rows]
        self._potential = potential - potential[0]
        self._points.append(_Point(self._potential, self._hits(self._potential),
                                   self._links.used_budget(self._potential)))
        limited = float(self._budget.is_limited)
        proved = z + (gain - limited) / total if total > 0.0 else 0.0
        if proved > self.bound:
            self.bound, self.q = proved, ambush / total
            self.price = 1.0 / (total * self._budget.limit)
            self._circulations = (self._scaled_circulation(found.x, total),)
        endless = bool((flow > POTENTIAL.endless * (0.5 - ROUNDING)).any())
        return gain <= limited + self._precision * self._links.margin and not endless

    def _scaled_circulation(self, x: FloatArray, total: float) -> Circulation:
        """Flow of a solution, divided by the ``total`` of the ambusher's weights."""
        flow = np.maximum(x[self._columns], 0.0) * np.where(self._up, 1.0, -1.0) / total
        site = self._part_site[self._part[self._joined]]
        used = np.flatnonzero(flow * self.q[site])  # elsewhere it is rounding
        through = self._links.capacity * self.faces.crossed
        through[self._links.real] = x[self._links.columns]
        return Circulation(through / total, site[used], self._face[self._joined[used]], flow[used])

    def _mix(self, deadline: float) -> None:
        """Find the mixture of potentials of least value within the budget.

        A linear program with a row for each site.
        """
        points, count = self._points, len(self._points)
        losses = self._loss * np.stack([point.hits for point in points])  # points, S
        largest, value = losses.max(axis=0), losses.max(axis=1, initial=0.0)
        # At other sites, no mixture costs as much.
        rows = np.flatnonzero(largest >= max(self.bound * (1.0 - ROUNDING),
                                             POTENTIAL.near * value.min()))
        unit = float(largest.max(initial=0.0)) or 1.0
        lp = mixture_lp(csr_matrix(losses[:, rows].T / unit), np.zeros(count, dtype=np.int64),
                        np.array([point.used for point in points]))
        try:
            result = highs.run(lp, 'simplex', deadline)
        except SolverFailed:
            return
        if result.x is None:  # HiGHS called it infeasible, by rounding
            return
        shares = np.maximum(result.x[:-1], 0.0)
        shares /= shares.sum()
        self.value = float((shares @ losses).max(initial=0.0))
        kept = np.arange(count) >= count - POTENTIAL.points // 2
        kept |= shares > ROUNDING
        self._points = [point for point, keep in zip(points, kept, strict=True) if keep]
        self._blend = shares[kept]


class _Links:
    """Links between faces; their capacities are their costs as shares of the budget.

    ``real`` links have two different faces; the others are bridges, which all routes use at the
    cost ``bridges``. ``margin`` is the budget's, as a share of it; 1 if there is no budget.
    """

    columns: IndexArray

    def __init__(self, faces: Faces, budget: Budget) -> None:
        self.faces = faces
        edge = np.flatnonzero(faces.game.playable)
        self._cost = np.zeros(len(faces.left))
        self._cost[faces.link[edge]] = budget.cost[edge]
        self.capacity = self._cost / budget.limit
        self.real = np.flatnonzero(faces.left != faces.right)
        bridges = self.capacity * np.abs(faces.crossed)
        self.bridges = float(bridges[faces.left == faces.right].sum())
        self.margin = budget.margin / budget.limit if budget.is_limited else 1.0

    def full_links(self) -> IndexArray:
        """First flow on the real links (K,): 1 or -1 on shortest paths from the source, else 0."""
        game, faces = self.faces.game, self.faces
        edge, ends = np.flatnonzero(game.playable), np.zeros((2, len(faces.left)), dtype=np.int64)
        ends[:, faces.link[edge]] = np.sort(game.network.edges[edge], axis=1).T
        both = np.concatenate((ends, ends[::-1]), axis=1)
        graph = csr_matrix((np.tile(self._cost, 2), both), (game.node_count,) * 2)
        predecessor = dijkstra(graph, indices=game.network.source, return_predecessors=True)[1]
        low, high = ends[:, self.real]
        return np.where(predecessor[high] == low, 1, np.where(predecessor[low] == high, -1, 0))

    def used_budget(self, potential: FloatArray) -> float:
        """Return the share of the budget that the flow of a potential (F,) uses."""
        faces = self.faces
        through = faces.crossed + potential[faces.left] - potential[faces.right]
        return float(self.capacity @ np.abs(through))
