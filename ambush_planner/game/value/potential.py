# SPDX-License-Identifier: Apache-2.0
"""The least value on a planar two-way network within one budget: an LP in face potentials.

Every flow of size 1 is the flow of one reference route plus the differences of a potential of the
faces. Its level lines, driven as routes, meet disc j at most as often as the potential varies on
the rim of the disc. So the least value is the least z for which some potential varies by at most
z / alpha_j on each rim and keeps the budget (docs/theory.md, section 7). For a fixed z this is a
linear program whose dual is a circulation between faces: through links, at most their share of the
budget, and through discs. Its discs and their flows are an ambusher, and it proves a bound by
itself (``certificate.curves``). Newton's method finds z. New sites, and faces at which a disc
exceeds its share, are new columns of the same model.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix, vstack
from scipy.sparse.csgraph import dijkstra

from ...arrays import ROUNDING, BoolArray, FloatArray, IndexArray, sums
from ..ambusher import Ambusher, at_nodes, on_nodes, padded
from ..budget import BUDGET_TOLERANCE, Budget
from ..distribution.acyclic import without_cycles
from ..distribution.chain import conserved_strategy
from ..faces import Circulation, Faces
from ..game import Game
from ..route_sampler import route_edges, shortest_route, shortest_route_strategy
from .face_flows import LegFlows


class PotentialSearch(NamedTuple):
    """The constants of the search for z."""

    precision: float = 1e-3  # largest, relative: of z, and of the share at which faces join
    step: float = 0.92  # factor by which z falls at most at once, until a budget is exceeded
    # While the budget is kept, z stays if more than this share of the discs' columns is new: at a
    # lower z, most of the columns that join would not be needed in the end.
    many: float = 0.03
    endless: float = 1.0 / BUDGET_TOLERANCE  # flow through a disc: z is infeasible


POTENTIAL = PotentialSearch()


class Potential:
    """The LP, at first with the game's sites; ``solve`` goes on from where it is.

    ``bound`` is proved by ``circulation``, ``q`` (S,) is its ambusher and ``price`` that
    of the budget [loss per unit]. ``cap`` is what each site may cause. The search begins at
    ``first``, or at half the largest loss if that is less.
    """

    apart = 0.0

    def __init__(self, faces: Faces, budget: Budget, gap: float, deadline: float,
                 first: float = np.inf) -> None:
        self.game, self.faces, self.budget, self.deadline = faces.game, faces, budget, deadline
        least = 2.0 / POTENTIAL.endless  # an endless flow proves no more
        self._precision = min(max(gap, least), POTENTIAL.precision)
        # Pairs of a face and a part of a rim, part by part, and the first pair of each part.
        self._face, self._site, self._offset, self._part, self._first = (
            np.zeros(0, dtype=np.int64) for _ in range(5))
        self._parts, self._loss = 0, np.zeros(0)
        self._around = np.zeros(0, dtype=bool)
        self._entering = csr_matrix((0, len(faces.link)))
        self._joined, self._up = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=bool)
        self._z, self.bound = first, 0.0
        self._potential: FloatArray | None = None
        self._kept: FloatArray | None = None  # the latest potential within the budget
        self.circulation: Circulation | None = None  # its sites are rows, not nodes
        self.q, self.price = np.zeros(0), 0.0
        self._start_with_links()
        self.add_sites(self.game.entering, self.game.loss[self.game.sites])

    def add_sites(self, entering: csr_matrix, loss: FloatArray) -> None:
        """Add sites with the edges that enter their discs, (K, M), and their losses (K,)."""
        discs = self.faces.discs(entering)
        order = np.argsort(discs.part, kind='stable')
        first = np.unique(discs.part[order], return_index=True)[1]
        self._flows.add_nodes(self.faces.leg(discs.face[order][first]))
        self._first = np.append(self._first, len(self._face) + first)
        self._face = np.append(self._face, discs.face[order])
        self._offset = np.append(self._offset, discs.offset[order])
        self._site = np.append(self._site, discs.disc[order] + len(self._loss))
        self._part = np.append(self._part, discs.part[order] + self._parts)
        self._parts += len(first)
        self._loss = np.append(self._loss, loss)
        self._around = np.append(self._around, discs.around)
        self.q = np.append(self.q, np.zeros(len(loss)))
        self._entering = csr_matrix(vstack((self._entering, entering)))
        certain = np.where(self._around, self._loss, 0.0)  # every route meets these
        if certain.max(initial=0.0) > self.bound:
            self.bound, self.circulation, self.price = float(certain.max()), None, 0.0
            self.q = np.zeros(len(certain))
            self.q[certain.argmax()] = 1.0

    def solve(self) -> None:
        """Find z: from above in steps, from below by the bounds that circulations prove."""
        if not len(self._loss) or not len(self._real):  # or there is but one route
            self._z = self.bound
            return
        z, height = max(min(self._z, self._loss.max() / 2.0), self.bound), self._heights()
        if self.bound == 0.0 and self.game.avoiding(self._entering):
            z = 0.0  # unless the routes that avoid all sites exceed the budget
        self._join(z, height)
        while True:
            endless = self._solve(z)
            height = self._heights()
            new = self._join(z, height) if self._kept is self._potential else 0
            if new > POTENTIAL.many * len(self._joined):
                continue
            newer = (self.bound * (1.0 + self._precision) if endless
                     else max(self.bound, POTENTIAL.step * z))
            found = abs(newer - z) <= self._precision * z and not endless
            z = z if found else newer
            new += self._join(z, height)
            if found and not new:
                self._z = z
                return

    @property
    def sites(self) -> tuple[csr_matrix, FloatArray]:
        """The edges (S, M) that enter its sites' discs, and their losses (S,)."""
        return self._entering, self._loss

    @property
    def provers(self) -> list[Potential]:
        """Itself."""
        return [self]

    def ambusher(self, game: Game, kept: BoolArray) -> Ambusher:
        """He who proves the bound, in a game with the ``kept`` ones of the sites (S,)."""
        q, curves = padded(self.q, len(kept))[kept], self.circulation
        if curves and not game.entries_are_hits:
            node = np.full(len(kept), -1)
            node[kept] = game.sites
            curves = replace(curves, site=node[curves.site])
        return Ambusher(at_nodes(game, q), self.price, self._by_leg(game, kept),
                        None if game.entries_are_hits else curves)

    def _by_leg(self, game: Game, kept: BoolArray) -> FloatArray | None:
        """For which leg he waits at each node (legs, N), in a game with the ``kept`` sites (S,)."""
        legs, curves = len(self.faces.first), self.circulation
        if legs == 1 or curves is None:
            return None
        leg = self.faces.leg(curves.face)
        through = sums(leg * len(kept) + curves.site, np.abs(curves.flow) / 2.0, legs * len(kept))
        waits = through.reshape(legs, -1)[:, : len(self._loss)] / self._loss
        return on_nodes(game, padded(waits, len(kept))[:, kept])

    @property
    def cap(self) -> float:
        """Mean loss that each site may cause."""
        return self.bound

    @property
    def flow(self) -> FloatArray:
        """The level lines' flow (M,), without cycles and within the budget."""
        shortest = shortest_route_strategy(self.game, self.budget.cost)
        if self._kept is None:
            return shortest
        p = conserved_strategy(self.game, self.faces.flow(self._kept), ROUNDING)
        if p is None:
            return shortest
        used = float(p[p > 0.0] @ self.budget.reduced_cost[p > 0.0])
        share = min(self.budget.slack / used, 1.0) if used > 0.0 else 1.0
        return without_cycles(self.game.network, share * p + (1.0 - share) * shortest)

    def level_lines(self, count: int) -> list[IndexArray]:
        """Routes, as edges, along ``count`` level lines; drawn alike, they are the flow."""
        network, routes = self.game.network, []
        if self._kept is None:
            return []
        for level in (np.arange(count) + 0.5) / count:
            edge = np.flatnonzero(self.faces.flow(np.floor(self._kept - level)))
            routes.append(route_edges(network, shortest_route(network, edge, self.budget.cost)))
        return routes

    def _start_with_links(self) -> None:
        """The model without discs at its optimum: links of the shortest-path tree are full."""
        faces, game = self.faces, self.game
        edge = np.flatnonzero(game.playable)
        most, ends = np.zeros(len(faces.left)), np.zeros((2, len(faces.left)), dtype=np.int64)
        most[faces.link[edge]] = self.budget.cost[edge]
        ends[:, faces.link[edge]] = np.sort(game.network.edges[edge], axis=1).T
        both = np.concatenate((ends, ends[::-1]), axis=1)
        graph = csr_matrix((np.tile(most, 2), both), (game.node_count,) * 2)
        before = dijkstra(graph, indices=game.network.source, return_predecessors=True)[1]
        most /= self.budget.limit
        self._real = real = np.flatnonzero(faces.left != faces.right)
        # The others are bridges, each between a face and itself.
        self._bridges = np.where(faces.left == faces.right, most * faces.crossed, 0.0)
        low, high = ends[:, real]
        self._flows = LegFlows(len(faces.first))
        self._flows.add_nodes(faces.leg(np.arange(faces.count)))
        self._flows.add_columns(faces.left[real], faces.right[real],
                                -faces.crossed[real].astype(np.float64), -most[real], most[real])
        self._flows.start_at(np.where(before[high] == low, 1, np.where(before[low] == high, -1, 0)))

    def _heights(self) -> FloatArray:
        """The potential at each pair of a disc and a face, along the rim."""
        offset = self._offset.astype(np.float64)
        return offset if self._potential is None else self._potential[self._face] + offset

    def _exceeding(self, z: float, height: FloatArray) -> IndexArray:
        """Parts of avoidable sites' rims on which the potential varies by more than their share."""
        if not len(self._first):
            return self._first
        site = self._site[self._first]
        spread = (np.maximum.reduceat(height, self._first)
                  - np.minimum.reduceat(height, self._first))
        over = spread > z * (1.0 + self._precision / 2.0) / self._loss[site] + ROUNDING
        return np.flatnonzero(over & ~self._around[site])

    def _join(self, z: float, height: FloatArray) -> int:
        """Add the extreme faces of the discs that exceed, and those just too far apart.

        Returns the number of pairs that are new.
        """
        pairs: list[int] = []
        last = np.append(self._first[1:], len(self._face))
        for part in self._exceeding(z, height):
            order = self._first[part] + height[self._first[part] : last[part]].argsort()
            loss = self._loss[self._site[order[0]]]
            ordered, most = height[order], z * (1.0 + self._precision / 2.0) / loss
            above = order[ordered.searchsorted(ordered[0] + most, 'right')]
            below = order[ordered.searchsorted(ordered[-1] - most) - 1]
            pairs += [2 * order[-1] + 1, 2 * above + 1, 2 * order[0], 2 * below]
        known = 2 * self._joined + self._up
        new, up = np.divmod(np.setdiff1d(np.array(pairs, dtype=np.int64), known), 2)
        face, disc, none = self._face[new], self.faces.count + self._part[new], np.zeros(len(new))
        self._flows.add_columns(np.where(up, face, disc), np.where(up, disc, face), none, none,
                                np.full(len(new), POTENTIAL.endless))
        self._joined, self._up = np.append(self._joined, new), np.append(self._up, up == 1)
        return len(new)

    def _solve(self, z: float) -> bool:
        """Solve for a fixed z and keep what it proves; True if a flow is endless.

        What flows through a disc enters and leaves it by columns of their own, so each counts half.
        """
        joined, links = self._joined, len(self._real)
        loss = self._loss[self._site[joined]]
        turned = np.where(self._up, -1.0, 1.0)
        self._flows.change_costs(links, z / loss / 2.0 + turned * self._offset[joined])
        found = self._flows.solve(self.deadline)
        flow = np.maximum(found.x[links:], 0.0)
        ambush = np.bincount(self._site[joined], flow / 2.0 / loss, len(self._loss))
        total, gain = float(ambush.sum()), float(np.abs(self._bridges).sum()) - found.cost
        self._potential = found.potential[: self.faces.count]
        endless = bool((flow > POTENTIAL.endless * (1.0 - ROUNDING)).any())
        if gain <= 1.0 + self._precision and not endless:
            self._kept = self._potential
        proved = z + (gain - float(self.budget.binds)) / total if total > 0.0 else 0.0
        if proved > self.bound:
            self.bound, self.q = proved, ambush / total
            self.price = 1.0 / (total * self.budget.limit)
            through = self._bridges.copy()
            through[self._real] = found.x[:links]
            self.circulation = self._circulation(through / total, turned * -flow / total)
        return endless

    def _circulation(self, through: FloatArray, flow: FloatArray) -> Circulation:
        used = np.flatnonzero(flow)
        pairs = self._joined[used]
        return Circulation(through, self._site[pairs], self._face[pairs], flow[used])
