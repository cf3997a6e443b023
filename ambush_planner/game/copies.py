# SPDX-License-Identifier: Apache-2.0
"""The law of a trip's routes: a label is drawn at the start, each label has a chain of its own.

One Markov chain draws the legs of a trip independently of each other, which can cost more than the
slack. A label remembers what the legs have to agree on: the chain runs on copies of the ground, one
around all routes of a mixture, and one within a few edges of each of its best routes. The copies
are joined at the source and the target, so together they are one acyclic network, with one law of
greatest entropy. Its limits are valid and linear: site j counts in copy k at most
min(weight of k, entries in k). A copy whose routes enter the disc twice *concedes* the site: it
counts with its whole weight, times the largest load with which they enter.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from scipy.sparse import csr_matrix, diags, hstack, vstack

from ..arrays import FloatArray, IndexArray, frozen_array, sums
from ..errors import SolverFailed, TimeLimit
from ..network.trip_graph import with_copies
from .budget import margin_rows
from .game import Game
from .law.acyclic import conserved_strategy, order_potential, rank_around
from .law.chain import MarkovChain
from .law.entropy_search import maximize_entropy
from .law.gibbs import AcyclicNetwork
from .slack import ceiling, within
from .value.mixtures import Mixtures
from .value.routes import MIN_FLOW, TIGHT, Routes

# Routes with a copy of their own at first, and their number times the copies' width in edges.
FEWEST, WIDTH = 16, 128
# Laws on one set of copies: those after the first concede by the law before.
LAWS = 2
# Of the slack: what few routes may cost more than all; what the law aims at; its tolerance.
FEW_LOSE, AIM, TOLERANCE = 1.0 / 3.0, 0.95, 0.04
# Share of a budget's margin that the law keeps below it.
KEPT_MARGIN = 1e-3
# Entries over the weight of a copy that count as more than one.
ONCE = 1.0 + 1e-9
# Sites whose hits are computed; the others count with their limits, which are larger.
EXACT = 200


def law_on_copies(routes: Routes, slack: float, deadline: float) -> LawOnCopies | None:
    """The law on copies around few routes of a solved program, or around more if it costs too much.

    Its value is at most (1 + slack) times the bound if possible, or (1 + slack / 2) times that of
    the mixture. The last copies have all routes. Returns the law of least value if none is within
    the slack; None if there is none at all, or at ``deadline`` (``time.monotonic``), or if the
    bound is 0: one chain on the edges that no site hits needs no labels.
    """
    order, count = np.argsort(-routes.shares, kind='stable'), FEWEST
    best: LawOnCopies | None = None
    while routes.bound > 0.0 and time.monotonic() < deadline:
        few, every = routes.mixtures.among(order[:count]), count >= len(order)
        count *= 2
        try:
            shares = few.solve(TIGHT, deadline).shares
        except SolverFailed:  # these routes exceed a budget
            continue
        except TimeLimit:
            break
        value = few.value(shares)
        if within(value, routes.value, FEW_LOSE * slack) or every:
            limit = max(ceiling(routes.bound, slack), ceiling(value, slack / 2.0))
            law = LawOnCopies(routes, few, shares, limit, slack, count // 2)
            if law.run(deadline, LAWS) and (best is None or law.value < best.value):
                best = law
            if every or best and best.value <= limit:
                return best
    return best


class LawOnCopies:
    """Laws on copies around the mixture of some routes, with a value of at most ``limit``.

    A run finds ``chain``, ``value`` and ``worst``.

    Attributes
    ----------
    chain : MarkovChain
        On the copies' edges; ``chain.network.edge`` are the trip's edges that they stand for.
    node : (n,)
        The trip's node that each copied node stands for, without source and target.
    value : float
        What the best ambush costs on average, each route counted once.
    worst : int
        The row of the site that costs most.
    evaluations : int
        Of the Gibbs law.
    """

    def __init__(self, routes: Routes, few: Mixtures, shares: FloatArray, limit: float,
                 slack: float, count: int) -> None:
        self.game, self.limit, self.slack, self.evaluations = routes.game, limit, slack, 0
        self._few, self._shares, self._gap = few, shares, routes.gap
        ground = conserved_strategy(self.game, few.flow(shares, len(self.game.playable)), MIN_FLOW)
        assert ground is not None
        self._copies([np.flatnonzero(ground), *few.routes], max(WIDTH // count, 1))
        self._excess = margin_rows(routes.budgets, self.network.edge) / (1.0 - KEPT_MARGIN)
        self._prices, self._multipliers = np.zeros(self._excess.shape[0]), np.zeros(0)
        self._hits = csr_matrix((0, len(self.label)))
        # By site and label: the largest count of an entry, and whether the label concedes the site.
        self._largest = np.zeros((0, len(self._begin)))
        self._conceded = np.zeros(self._largest.shape, dtype=bool)
        self._know(routes.entering)

    def add_sites(self, entering: csr_matrix, loss: FloatArray) -> None:
        """Add sites with losses (K,) and the edges (K, M) that enter their discs."""
        self._few.add_sites(entering, loss)
        self._know(entering)

    def _know(self, entering: csr_matrix) -> None:
        hits = self.network.columns(entering)
        entry, largest = hits.tocoo(), np.zeros((hits.shape[0], len(self._begin)))
        np.maximum.at(largest, (entry.row, self.label[entry.col]), entry.data)
        entries = [np.zeros(hits.shape[0]), *(np.ravel(entering[:, route].sum(axis=1))
                                              for route in self._few.routes)]
        self._hits = csr_matrix(vstack((self._hits, hits)))
        self._largest = np.vstack((self._largest, largest))
        self._conceded = np.vstack((self._conceded, np.column_stack(entries) > ONCE * largest))
        self._multipliers = np.append(self._multipliers, np.zeros(len(largest)))

    def unrolled(self, chain: MarkovChain) -> tuple[Game, FloatArray]:
        """The trip's game with the copies' nodes and edges after its own, and a law's p (M',)."""
        p = np.append(np.zeros(len(self.game.playable)), chain.p)
        return _on_copies(self.game, self.network, self.node), frozen_array(p, np.float64)

    def _copies(self, around: list[IndexArray], width: int) -> None:
        """Join copies around acyclic sets of edges at source and target; the first has no width."""
        network, potential, count = self.game.network, order_potential(self.game), 1
        parts, nodes = [], []
        for label, used in enumerate(around):
            edge, rank = _part(self.game, used, potential, width if label else None)
            ends = network.edges[edge]
            own = np.unique(ends)
            own = own[np.argsort(rank[own])][1:-1]  # all but source and target
            place = np.full(self.game.node_count, -1)
            place[own], place[network.source] = count + np.arange(len(own)), 0
            count += len(own)
            nodes.append(own)
            parts.append(np.column_stack((place[ends], edge, np.full(len(edge), label))))
        tail, head, edge, label = np.concatenate(parts).T
        head = np.where(head < 0, count, head)
        order = np.lexsort((head, tail))
        self.node, self.label = np.concatenate(nodes), label[order]
        self.network = AcyclicNetwork(tail[order], head[order], edge[order])
        self._begin = [np.flatnonzero((self.network.tail == 0) & (self.label == k))
                       for k in range(len(around))]

    def run(self, deadline: float, laws: int = 1) -> bool:
        """Find the last of some laws within the limit, else the one of least value.

        Each concedes by the law before. Returns False if there is none.
        """
        level = self._few.level(self._shares, self._gap) / self._few.value(self._shares)
        most = level * self.limit * (1.0 - (1.0 - AIM) * self.slack) / self._few.loss
        self.value = np.inf
        for _ in range(laws):
            rows = csr_matrix(diags(1.0 / most) @ self._counted())
            near = np.flatnonzero(np.asarray(rows.sum(axis=1)).ravel() > 1.0)
            found = maximize_entropy(self.network, csr_matrix(vstack((rows[near], self._excess))),
                                     np.zeros(len(self.label)),
                                     np.append(self._multipliers[near], self._prices),
                                     TOLERANCE * self.slack, deadline, len(near))
            self.evaluations += found.evaluations
            if found.infeasible or not len(found.p):
                break
            self._multipliers[:] = 0.0
            self._multipliers[near], self._prices = np.split(found.multipliers, [len(near)])
            chain = MarkovChain(self.network, found.p)
            if (self._excess @ chain.p * (1.0 - KEPT_MARGIN) > 1.0).any():  # the time is up
                break
            losses = self._losses(chain)
            value = float(np.sort(losses)[len(losses) - self._few.ambushers :].sum())
            if value <= max(self.limit, self.value):
                self.chain, self.value, self.worst = chain, value, int(losses.argmax())
        return self.value < np.inf

    def _counted(self) -> csr_matrix:
        """The rows (S, m) of the limits: entries, or the weight of a label that concedes."""
        entry, (site, label) = self._hits.tocoo(), np.nonzero(self._conceded)
        kept = ~self._conceded[entry.row, self.label[entry.col]]
        begin = [self._begin[k] for k in label]
        row = np.concatenate((entry.row[kept], np.repeat(site, list(map(len, begin)))))
        column = np.concatenate((entry.col[kept], *begin))
        most = np.repeat(self._largest[site, label], list(map(len, begin)))
        counts = np.append(entry.data[kept], most)
        return csr_matrix((counts, (row, column)), self._hits.shape)

    def _losses(self, chain: MarkovChain) -> FloatArray:
        """Mean losses (S,) of a law; in the next one, labels concede what they enter twice in it.

        Those that are not among the largest are upper bounds.
        """
        entry, labels, loss = self._hits.tocoo(), len(self._begin), self._few.loss
        entries = sums(entry.row * labels + self.label[entry.col], entry.data * chain.p[entry.col],
                       len(loss) * labels).reshape(-1, labels)
        weight = np.array([chain.p[begin].sum() for begin in self._begin]) * self._largest
        self._conceded = entries > weight * ONCE
        losses = loss * np.minimum(entries, weight).sum(axis=1)
        worst = np.argsort(-losses)[:EXACT]
        losses[worst] = loss[worst] * chain.hits(self._hits[worst])
        return np.asarray(losses)


def _part(game: Game, used: IndexArray, potential: FloatArray,
          width: int | None) -> tuple[IndexArray, IndexArray]:
    """The edges that go forward at most ``width`` edges from those used, and the order of nodes.

    ``width`` None: anywhere.
    """
    tails, heads = game.network.edges.T
    flow, inside = np.zeros(len(tails)), np.full(game.node_count, width is None)
    flow[used], inside[game.network.edges[used]] = 1.0, True
    rank = rank_around(game, flow, potential)
    for _ in range(width or 0):
        grown = inside.copy()
        grown[heads[game.playable & inside[tails]]] = True
        grown[tails[game.playable & inside[heads]]] = True
        inside = grown
    part = game.restricted_to(inside[tails] & inside[heads] & (rank[tails] < rank[heads]))
    assert part is not None  # it contains the flow
    return np.flatnonzero(part.playable), rank


def _on_copies(game: Game, copies: AcyclicNetwork, node: IndexArray) -> Game:
    """The game with the copies' nodes and edges after its own; ``node`` are those copied."""
    network, count = game.network, game.node_count
    of = np.append(np.arange(count), node)
    at = np.concatenate(([network.source], count + np.arange(len(node)), [network.target]))
    edges = np.column_stack((at[copies.tail], at[copies.head]))
    playable = np.append(game.playable, np.ones(len(edges), dtype=bool))
    return replace(game, network=with_copies(network, node, edges),
                   playable=frozen_array(playable, np.bool_),
                   loss=frozen_array(game.loss[of], np.float64),
                   known_hits=csr_matrix(hstack((game.hits, game.hits[:, copies.edge]))))
