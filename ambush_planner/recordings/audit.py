# SPDX-License-Identifier: Apache-2.0
"""Audit of departures: do they follow the published strategy, and could an observer predict them?

If all is well, each departure is an independent draw from its own strategy. The test counts the
passages N_e of each edge in all departures and compares them with their mean E_e and variance V_e
under the strategies:

    ``T = sum_e (N_e - E_e)^2 / (V_e + 1)``

This is Pearson's statistic; the 1 keeps rarely driven edges from dominating it. T grows if a route
or an edge is favoured, if routes repeat, and if they vary too little. Counts of edges are
dependent, so T has no chi-square distribution: its p-value comes from resampling all departures
from their strategies, ``(1 + #{T* >= T}) / (1 + resamples)``, as in
``scipy.stats.monte_carlo_test``, and holds for any number of departures and strategies. Where times
of departure were drawn, their counts have such a statistic, too; both are divided by their spread
among the resamples and added.

Edges and nodes of different networks are the same if they lie at the same positions: a start that
moves by a few centimetres makes a new strategy, but most of its network stays.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_matrix

from ..arrays import ROUNDING, FloatArray, IndexArray, frozen_array
from ..errors import AmbushPlannerError
from ..game.route_sampler import route_edges
from ..game.strategy import Strategy
from ..operations.slots import Slots

# Minimum number of departures; with fewer the test finds little but one route driven every time.
MIN_DEPARTURES = 5
# False-positive rate: departures with a p-value up to this are a finding.
LEVEL = 0.001
# Resamples in which an observer is followed, for the range that honest draws lead to.
FOLLOWED = 49
# Nodes of two networks closer than this are at the same position [m].
SAME_POSITION = 1e-3
# Routes drawn at a time; bounds memory to about 100 MB.
ROUTES_AT_ONCE = 20_000

Steps = tuple[IndexArray, IndexArray]
# Counts (1 + resamples, C), the recorded ones first, with their mean and variance (C,).
_Counts = tuple[npt.NDArray[np.uint16], FloatArray, FloatArray]


class NotAuditable(AmbushPlannerError):
    """There are too few departures from strategies without cycles."""


@dataclass(frozen=True, eq=False)
class Audit:
    """The result of an audit.

    Attributes
    ----------
    departures, strategies, left_out : int
        How many were audited; how many departures were not, as their strategies have cycles.
    impossible : int
        Steps and ends of routes that the strategies cannot have drawn.
    p_value : float
        Probability of a deviation as large as the recorded one if departures follow their
        strategies; 0 if something impossible was driven.
    value : float
        Mean value of the departures after the first.
    observer_losses : (n - 1,)
        Losses at the departures after the first, caused by an observer who learns as he goes:
        before each departure he waits where waiting would have cost the earlier ones most. Where
        the time was drawn, he waits at the times that cover most departures.
    observer_range : (float, float)
        5 % and 95 % quantiles of the mean of these losses for departures drawn honestly.
    """

    departures: int
    strategies: int
    left_out: int
    impossible: int
    p_value: float
    value: float
    observer_losses: FloatArray
    observer_range: tuple[float, float]

    @property
    def finding(self) -> bool:
        """Return whether the departures do not follow their strategies."""
        return self.p_value <= LEVEL

    @property
    def observer_loss(self) -> float:
        """Mean loss that an observer who learns as he goes would have caused."""
        return float(self.observer_losses.mean())


def audit(departures: Sequence[Any], rng: np.random.Generator | int = 1,
          resamples: int = 999) -> Audit:
    """Test departures against their strategies, and follow an observer who learns from them.

    ``departures`` are in order of time, each with the attributes ``drawn_from`` (TripStrategy),
    ``route`` (the nodes of each leg), ``drawn_slot`` (its time and the Slots that it was
    drawn from, or None), ``covered`` and ``value`` of RecordedDeparture; those of one strategy
    share it. A finding needs 999 ``resamples`` or more. Raises NotAuditable if fewer than
    ``MIN_DEPARTURES`` are from strategies without cycles.
    """
    rng = np.random.default_rng(rng)
    groups, audited = _grouped(departures)
    n, impossible = len(audited), 0
    if n < MIN_DEPARTURES:
        raise NotAuditable(f'at least {MIN_DEPARTURES} departures from strategies without '
                           f'cycles are needed, got {n}')
    edges = _number_by_position(groups)
    # Set 0 is the recorded one, the others are resamples.
    passages = np.zeros((1 + resamples, edges), np.uint16)
    followed, losses = 1 + min(FOLLOWED, resamples), []
    for group in groups:
        size = len(group.members)
        *recorded, wrong = group.recorded()
        impossible += wrong
        for route, edge in chain([recorded], group.resampled(resamples, rng)):
            cells = route // size * edges + group.edge_number[edge]
            np.add.at(passages.reshape(-1), cells, np.uint16(1))
            early = route < followed * size
            losses.append(group.losses(route[early], edge[early], n))
    counts = [(passages, *_expected(groups, edges))]
    counts += _slot_counts([each.drawn_slot for each in audited if each.drawn_slot], resamples, rng)
    loss, row, node = (np.concatenate(parts) for parts in zip(*losses, strict=True))
    loss = loss * np.array([each.covered for each in audited])[row % n]
    caused = _observe(followed, n, loss, row, node)
    low, high = np.quantile(caused[1:].mean(axis=1), (0.05, 0.95))
    return Audit(departures=n, strategies=len({id(each.drawn_from) for each in audited}),
                 left_out=len(departures) - n, impossible=impossible,
                 p_value=0.0 if impossible else _p_value(counts),
                 value=float(np.mean([each.value for each in audited[1:]])),
                 observer_losses=frozen_array(caused[0], np.float64),
                 observer_range=(float(low), float(high)))


class _Group:
    """A leg of the departures of one strategy; edges and nodes by numbers that all groups share.

    Steps of routes are two arrays (S,): the number of the route, and the index of the edge. Route
    k of set s has the number s * size + k.
    """

    edge_number: IndexArray
    node_number: IndexArray

    def __init__(self, strategy: Strategy) -> None:
        self.game, self.network, self.p = strategy.game, strategy.network, strategy.edge_probability
        self.sampler = strategy.sampler
        self.whole = {tuple(route.tolist()) for route in strategy.mixture.routes
                      } if strategy.mixture else None
        self.used = np.flatnonzero(self.p > 0.0)
        self.loss, self.hits = self.game.loss[self.game.sites], self.game.entering.T.tocsr()
        self.members: list[int] = []
        self.routes: list[IndexArray] = []

    def recorded(self) -> tuple[IndexArray, IndexArray, int]:
        """Return the steps of recorded routes, and the number of impossible steps and ends.

        Steps along no edge, or along an edge of probability 0, are impossible and left out. Of a
        mixture of whole routes, another one is impossible.
        """
        network = self.network
        owner = np.repeat(np.arange(len(self.members)), [len(route) - 1 for route in self.routes])
        steps = np.concatenate([np.column_stack((route[:-1], route[1:])) for route in self.routes])
        edge = network.edges_between(*steps.T)
        possible = (edge >= 0) & (self.p[edge] > 0.0)
        ends = np.array([(route[0], route[-1]) for route in self.routes])
        wrong_ends = ends != (network.source, network.target)
        others = 0 if self.whole is None else sum(
            tuple(route_edges(network, route).tolist()) not in self.whole for route in self.routes)
        return owner[possible], edge[possible], int((~possible).sum() + wrong_ends.sum()) + others

    def resampled(self, resamples: int, rng: np.random.Generator) -> Iterator[Steps]:
        """Yield the steps of sets 1, 2, ... in batches."""
        batch = max(ROUTES_AT_ONCE // len(self.members), 1)
        for begin in range(0, resamples, batch):
            count = min(batch, resamples - begin) * len(self.members)
            route, edge = self.sampler.draw_steps(count, rng)
            yield route + (1 + begin) * len(self.members), edge

    def losses(self, route: IndexArray, edge: IndexArray,
               n: int) -> tuple[FloatArray, IndexArray, IndexArray]:
        """Return what waiting costs routes: loss, set * n + departure, and node number."""
        first = int(route.min(initial=0))
        shape = int(route.max(initial=0)) - first + 1, len(self.p)
        driven = csr_matrix((np.ones(len(edge)), (route - first, edge)), shape)
        hit = (driven @ self.hits).tocoo()  # each route counts once, however often it comes back
        drawn, member = np.divmod(hit.row + first, len(self.members))
        site_number = self.node_number[self.game.sites]
        return (self.loss[hit.col], drawn * n + np.array(self.members)[member],
                site_number[hit.col])


def _grouped(departures: Sequence[Any]) -> tuple[list[_Group], list[Any]]:
    """Sort departures by strategy and leg, without those of strategies with cycles."""
    groups: dict[int, list[_Group]] = {}
    audited: list[Any] = []
    for each in departures:
        if (key := id(each.drawn_from)) not in groups:
            groups[key] = [_Group(leg) for leg in each.drawn_from.legs]
        legs = groups[key]
        if all(group.sampler.acyclic for group in legs):
            for group, nodes in zip(legs, each.route, strict=True):
                group.members.append(len(audited))
                group.routes.append(nodes)
            audited.append(each)
    return [group for legs in groups.values() for group in legs if group.members], audited


def _number_by_position(groups: Sequence[_Group]) -> int:
    """Number nodes and used edges of all groups; return how many edges they are."""
    points = np.concatenate([group.network.points for group in groups])
    node = np.unique(np.rint(points / SAME_POSITION) @ [1.0, 1.0j], return_inverse=True)[1]
    first = np.cumsum([0, *(len(group.network.points) for group in groups)])
    ends = np.concatenate([group.network.edges[group.used] + first[k]
                           for k, group in enumerate(groups)])
    key = node[ends[:, 0]] * len(points) + node[ends[:, 1]]
    used, edge = np.unique(key, return_inverse=True)
    parts = np.split(edge, np.cumsum([len(group.used) for group in groups])[:-1])
    for k, (group, part) in enumerate(zip(groups, parts, strict=True)):
        group.node_number = node[first[k]:first[k + 1]]
        group.edge_number = np.full(len(group.p), -1)
        group.edge_number[group.used] = part
    return len(used)


def _expected(groups: Sequence[_Group], count: int) -> tuple[FloatArray, FloatArray]:
    """Mean and variance (C,) of the passages of each edge under the strategies."""
    mean, variance = np.zeros(count), np.zeros(count)
    for group in groups:
        # Rounding may leave a probability slightly above 1.
        p = np.minimum(group.p[group.used], 1.0)
        number = group.edge_number[group.used]
        np.add.at(mean, number, len(group.members) * p)
        np.add.at(variance, number, len(group.members) * p * (1.0 - p))
    return mean, variance


def _slot_counts(drawn: Sequence[tuple[str, Slots]], resamples: int,
                 rng: np.random.Generator) -> list[_Counts]:
    """Count the draws of each time of departure; empty if none was drawn."""
    times = sorted({time for _, slots in drawn for time in slots.times})
    passages = np.zeros((1 + resamples, len(times)), np.uint16)
    expected, variance = np.zeros(len(times)), np.zeros(len(times))
    for slot, slots in drawn:
        column, shares = np.searchsorted(times, slots.times), np.array(slots.shares)
        expected[column] += shares
        variance[column] += shares * (1.0 - shares)
        again = column[rng.choice(len(shares), resamples, p=shares)]
        passages[np.arange(1 + resamples), [times.index(slot), *again]] += 1
    return [(passages, expected, variance)] if drawn else []


def _p_value(counts: Sequence[_Counts]) -> float:
    """Monte Carlo p-value of the first rows; the statistics of several counts are added."""
    total = np.zeros(len(counts[0][0]))
    for passages, expected, variance in counts:
        found = np.array([(row - expected) ** 2 @ (1.0 / (variance + 1.0)) for row in passages])
        total += found / (float(found.std()) or 1.0)
    reached = np.count_nonzero(total[1:] >= total[0] * (1.0 - ROUNDING))
    return float(1 + reached) / len(total)


def _observe(sets: int, n: int, loss: FloatArray, row: IndexArray,
             node: IndexArray) -> FloatArray:
    """Losses (sets, n - 1) that an observer causes in each set after the first departure.

    In row set * n + departure, waiting at the node costs the loss (K,).
    """
    hit, column = np.unique(node, return_inverse=True)
    # The last column has no losses: he stays away until he has seen a place.
    waiting = csr_matrix((loss, (row, column)), (sets * n, len(hit) + 1))
    seen, every = np.zeros((sets, len(hit) + 1)), np.arange(sets)
    seen[:, -1] = np.finfo(float).tiny
    caused = np.zeros((sets, n))
    for k in range(n):
        latest = waiting[every * n + k].toarray()
        caused[:, k] = latest[every, seen.argmax(axis=1)]
        seen += latest
    return caused[:, 1:]
