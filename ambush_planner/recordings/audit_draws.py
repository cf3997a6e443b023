"""Many departures at once: drawn from a strategy in one sweep, and counted edge by edge."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray, IndexArray, sums
from ..errors import AmbushPlannerError
from ..game.acyclic import is_acyclic
from ..network.network import Network

# Routes that are drawn at a time: keeps memory near 100 MB.
ROUTES_AT_ONCE = 20_000


class NotAuditable(AmbushPlannerError):
    """The departures do not allow an audit: a strategy with cycles, or too few of them."""


@dataclass(frozen=True, eq=False)
class Steps:
    """Routes as a list of edges: step k of all belongs to route ``route[k]`` (from 0).

    ``edge`` (S,) are indices into the network's edges, ``route`` (S,) lies in 0..count - 1; the
    steps of a route stand in their order.
    """

    count: int
    edge: IndexArray
    route: IndexArray


class ManyRoutes:
    """Draws routes by the hundred thousand, each as ``Strategy.sample_route`` would draw it.

    All walkers advance by one edge at a time. An acyclic strategy is required: there, routes need
    no loops cut out, and each edge is used with exactly its published probability.

    Attributes
    ----------
    network, p
        As given.
    used : (U,) int
        The edges of positive probability, by tail.
    choice : (M,) float
        p_ij / x_i: how likely the edge is taken by a route that stands at its tail; 0 if unused.
    surprise : (M,) float
        -ln of that [nats]; 0 if unused.
    entropy : float
        Of the drawn route [nats].

    Raises
    ------
    NotAuditable
        The strategy has cycles.
    """

    def __init__(self, network: Network, p: FloatArray) -> None:
        self.network, self.p = network, p
        used = np.flatnonzero(p > 0.0)
        self.used: IndexArray = used[np.argsort(network.tails[used], kind='stable')]
        count = len(network.points)
        if not is_acyclic(network, p):
            raise NotAuditable(
                'the strategy has cycles, so its edge probabilities are not those of drawn routes; '
                'only strategies without cycles (strategy.solver max_entropy) can be audited'
            )
        self._heads = network.heads[self.used]
        tails = network.tails[self.used]
        out = sums(network.tails, p, count)
        self.choice: FloatArray = p / np.where(out > 0.0, out, 1.0)[network.tails]
        self.surprise: FloatArray = -np.log(np.where(p > 0.0, self.choice, 1.0))
        self.entropy = float(p @ self.surprise)
        self._first = np.searchsorted(tails, np.arange(count + 1))
        self._ends = self._ends_of_choices(tails, count)

    def draw(self, count: int, rng: np.random.Generator) -> Steps:
        """Draw ``count`` independent routes."""
        node, route = np.full(count, self.network.source), np.arange(count)
        edges, routes = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
        while len(node):
            chance, place = rng.random(len(node)), self._first[node]
            for ends in self._ends:
                place += chance >= ends[node]
            edges.append(self.used[place])
            routes.append(route)
            node = self._heads[place]
            going = node != self.network.target
            node, route = node[going], route[going]
        return Steps(count, np.concatenate(edges), np.concatenate(routes))

    def _ends_of_choices(self, tails: IndexArray, count: int) -> FloatArray:
        """Where the choices of each node end on the way from 0 to 1 (most choices less 1, N).

        The last one never ends, so that rounding carries nobody beyond it.
        """
        place = np.arange(len(tails)) - self._first[tails]
        running = np.concatenate(([0.0], np.cumsum(self.choice[self.used])))
        ends = np.full((count, int(place.max(initial=0)) + 1), np.inf)
        ends[tails, place] = running[1:] - running[self._first[tails]]
        chosen = np.diff(self._first)
        ends[np.flatnonzero(chosen), chosen[chosen > 0] - 1] = np.inf
        return np.ascontiguousarray(ends.T[:-1])

    def draw_sets(
        self, departures: int, sets: int, rng: np.random.Generator
    ) -> Iterator[tuple[slice, Steps]]:
        """Draw ``sets`` times ``departures`` routes; yields (which sets, their steps)."""
        at_once = max(ROUTES_AT_ONCE // departures, 1)
        for begin in range(0, sets, at_once):
            part = slice(begin, min(begin + at_once, sets))
            yield part, self.draw((part.stop - begin) * departures, rng)

    def recorded(self, routes: Sequence[IndexArray]) -> tuple[Steps, int]:
        """Return the steps of recorded routes, and how many things in them cannot have been drawn.

        Counted as impossible, and left out of the steps: each step along no edge of the network
        or along an edge of probability 0. Also counted: each end of a route that is not the
        source or the target.
        """
        network = self.network
        lengths = np.array([len(route) for route in routes])
        nodes = np.concatenate([np.asarray(route, dtype=np.int64) for route in routes])
        owner = np.repeat(np.arange(len(routes)), lengths)
        inside = owner[:-1] == owner[1:]
        edge = _edges_between(network, nodes[:-1][inside], nodes[1:][inside])
        possible = (edge >= 0) & (self.p[edge] > 0.0)
        wrong_ends = sum(
            int(route[0] != network.source) + int(route[-1] != network.target) for route in routes
        )
        steps = Steps(len(routes), edge[possible], owner[:-1][inside][possible])
        return steps, int((~possible).sum()) + wrong_ends


def _edges_between(network: Network, tails: IndexArray, heads: IndexArray) -> IndexArray:
    """Index of the edge from each tail to each head (K,); -1 where there is none."""
    count = len(network.points)
    keys = network.tails * count + network.heads
    order = np.argsort(keys)
    wanted = tails * count + heads
    place = np.searchsorted(keys, wanted, sorter=order)
    found: IndexArray = order[np.minimum(place, len(keys) - 1)]
    return np.where(keys[found] == wanted, found, -1)
