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
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix, diags, hstack, vstack

from ...arrays import FloatArray, IndexArray, frozen_array, sums
from ...errors import SolverFailed
from ...network.trip_graph import with_copies
from ..budget import margin_rows
from ..game import Game
from ..slack import ceiling, within
from ..value.mixtures import Mixtures
from ..value.routes import MIN_FLOW, TIGHT, Routes
from .acyclic import conserved_strategy, order_potential, rank_around
from .chain import MarkovChain
from .entropy_search import maximize_entropy
from .gibbs import AcyclicNetwork

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


@dataclass(frozen=True, eq=False)
class Copied:
    """A law on copies of the ground.

    Attributes
    ----------
    chain : MarkovChain
        On the copies' edges; ``chain.network.edge`` are the trip's edges that they stand for.
    node : (n,)
        The trip's node that each copied node stands for, without source and target.
    value : float
        What the best ambush costs on average, each route counted once.
    limit : float
        What it may cost.
    worst : int
        The row of the site that costs most.
    evaluations : int
        Of the Gibbs law.
    """

    chain: MarkovChain
    node: IndexArray
    value: float
    limit: float
    worst: int
    evaluations: int

    def unrolled(self, game: Game) -> tuple[Game, FloatArray]:
        """The trip's game with the copies' nodes and edges after its own, and the p (M',) there."""
        p = np.append(np.zeros(len(game.playable)), self.chain.p)
        return _on_copies(game, self.chain.network, self.node), frozen_array(p, np.float64)


def law_on_copies(routes: Routes, slack: float, deadline: float) -> Copied | None:
    """The law on copies around few routes of a solved program, or around more if it costs too much.

    Its value is at most (1 + slack) times the bound if possible, or (1 + slack / 2) times that of
    the mixture. The last copies have all routes. Returns the law of least value if none is within
    the slack; None if there is none at all, or at ``deadline`` (``time.monotonic``), or if the
    bound is 0: one chain on the edges that no site hits needs no labels.
    """
    order, count = np.argsort(-routes.shares, kind='stable'), FEWEST
    best: Copied | None = None
    while routes.bound > 0.0 and time.monotonic() < deadline:
        few, every = routes.mixtures.among(order[:count]), count >= len(order)
        count *= 2
        try:
            shares = few.solve(TIGHT).shares
        except SolverFailed:  # these routes exceed a budget
            continue
        value = few.value(shares)
        if within(value, routes.value, FEW_LOSE * slack) or every:
            limit = max(ceiling(routes.bound, slack), ceiling(value, slack / 2.0))
            found = _Laws(routes, few, shares, limit, slack, count // 2).best(deadline)
            if found and (best is None or found.value < best.value):
                best = found
            if every or best and best.value <= limit:
                return best
    return best


class _Laws:
    """Laws on copies around the mixture of some routes, with a value of at most ``limit``."""

    def __init__(self, routes: Routes, few: Mixtures, shares: FloatArray, limit: float,
                 slack: float, count: int) -> None:
        self.game, self.limit, self.slack = routes.game, limit, slack
        self._loss, self._entering = routes.loss, routes.entering
        self._ambushers = few.ambushers
        level = few.level(shares, routes.gap)
        most = level * limit * (1.0 - (1.0 - AIM) * slack) / few.value(shares)
        self._most = most / self._loss
        edges = len(self.game.playable)
        ground = conserved_strategy(self.game, few.flow(shares, edges), MIN_FLOW)
        assert ground is not None
        self._copies([np.flatnonzero(ground), *few.routes], max(WIDTH // count, 1))
        # By site and label: whether the label concedes the site.
        entries = [np.zeros(len(self._loss)), *(self._entering[:, route].sum(axis=1)
                                                for route in few.routes)]
        hits = csr_matrix(self._entering[:, self.network.edge])
        self._most_counted = _largest(hits, self.label, len(self._begin))
        self._conceded = np.column_stack([np.ravel(each) for each in entries]) > (
            ONCE * self._most_counted)
        self._excess = margin_rows(routes.budgets, self.network.edge) / (1.0 - KEPT_MARGIN)

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

    def best(self, deadline: float) -> Copied | None:
        """The last law within the limit, else the one of least value; None if there is none."""
        start, best = np.zeros(len(self._loss) + self._excess.shape[0]), None
        hits, evaluations = csr_matrix(self._entering[:, self.network.edge]), 0
        for _ in range(LAWS):
            rows = csr_matrix(diags(1.0 / self._most) @ self._counted(hits))
            near = np.flatnonzero(np.asarray(rows.sum(axis=1)).ravel() > 1.0)
            moved = np.append(near, np.arange(len(self._loss), len(start)))
            found = maximize_entropy(self.network, csr_matrix(vstack((rows[near], self._excess))),
                                     start[moved], TOLERANCE * self.slack, deadline, len(near))
            evaluations += found.evaluations
            if found.infeasible or not len(found.p):
                break
            start[:] = 0.0
            start[moved] = found.multipliers
            chain = MarkovChain(self.network, found.p)
            losses = self._losses(hits, chain)
            value = float(np.sort(losses)[len(losses) - self._ambushers :].sum())
            if (self._excess @ chain.p * (1.0 - KEPT_MARGIN) > 1.0).any():  # the time is up
                break
            if best is None or value <= max(self.limit, best.value):
                best = Copied(chain, self.node, value, self.limit, int(losses.argmax()),
                              evaluations)
        return best

    def _counted(self, hits: csr_matrix) -> csr_matrix:
        """The rows (S, m) of the limits: entries, or the weight of a label that concedes."""
        entry, (site, label) = hits.tocoo(), np.nonzero(self._conceded)
        kept = ~self._conceded[entry.row, self.label[entry.col]]
        begin = [self._begin[k] for k in label]
        row = np.concatenate((entry.row[kept], np.repeat(site, list(map(len, begin)))))
        column = np.concatenate((entry.col[kept], *begin))
        most = np.repeat(self._most_counted[site, label], list(map(len, begin)))
        counts = np.append(entry.data[kept], most)
        return csr_matrix((counts, (row, column)), hits.shape)

    def _losses(self, hits: csr_matrix, chain: MarkovChain) -> FloatArray:
        """Mean losses (S,) of a law; in the next one, labels concede what they enter twice in it.

        Those that are not among the largest are upper bounds.
        """
        entry, labels, law = hits.tocoo(), len(self._begin), chain.p
        entries = sums(entry.row * labels + self.label[entry.col], entry.data * law[entry.col],
                       len(self._loss) * labels).reshape(-1, labels)
        weight = np.array([law[begin].sum() for begin in self._begin])
        weight = weight * self._most_counted
        self._conceded = entries > weight * ONCE
        losses = self._loss * np.minimum(entries, weight).sum(axis=1)
        worst = np.argsort(-losses)[:EXACT]
        losses[worst] = self._loss[worst] * chain.hits(hits[worst])
        return np.asarray(losses)


def _largest(hits: csr_matrix, label: IndexArray, labels: int) -> FloatArray:
    """The largest count of an entry in ``hits`` (S, m) by site and label (S, labels)."""
    entry, largest = hits.tocoo(), np.zeros((hits.shape[0], labels))
    np.maximum.at(largest, (entry.row, label[entry.col]), entry.data)
    return largest


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
