"""A day's plan: several convoys between the same places whose routes do not share their middle.

The routes of a day are independent draws on condition that no node of the middle is on two of
them: all are drawn, and all again, until they are distinct. So the convoys of a day have one law,
whatever their order, but it is not the strategy's: what leaves room for others is driven more
often. ``day_effect`` tells by how much, and what that costs.

A node lies in the middle if its share of the way, d(s, j) / (d(s, j) + d(j, t)) with shortest
lengths d over the network, is between two bounds. So does the node from which an edge in use leads
across all of it; from the source, the node to which.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import maximum_flow

from ..arrays import BoolArray, FloatArray, IndexArray, frozen_array, sums
from ..errors import InvalidOption, NotDistinct
from ..game.acyclic import is_acyclic, rank_around
from ..game.hits import worst_loss
from ..game.strategy import Strategy
from ..network.shortest_paths import distances_from
from ..option_checks import check_at_least, check_whole

MOST_TRIES = 100_000
# So many days are drawn before it is asked whether there are such routes at all.
_PATIENCE = 1000
_ROUTES_AT_ONCE = 20_000
# Numbers in memory at a time, and groups of days by which errors are estimated, at least.
_NUMBERS, _GROUPS = 2_000_000, 20


@dataclass(frozen=True, eq=False)
class DayEffect:
    """What being distinct does to the published probabilities.

    Attributes
    ----------
    share : float
        Chance that independent draws are distinct; a day needs 1 / share tries on average.
    visit_probability : (N,)
        Of each convoy of such a day, in place of the strategy's.
    largest_change : float
        Of any node's visit probability.
    value, standard_error : float
        What the best ambush costs each convoy on average if its day is planned so: the
        certificate's sum over these visits; and how exactly that is known at its site.
    """

    share: float
    visit_probability: FloatArray
    largest_change: float
    value: float
    standard_error: float


def sample_departures(
    strategy: Strategy,
    n: int,
    rng: np.random.Generator,
    distinct: float = 0.5,
    tries: int = MOST_TRIES,
) -> list[IndexArray]:
    """Draw the routes of ``n`` convoys of one day: node indices (K,) each.

    Parameters
    ----------
    strategy
        What each route is drawn from.
    n
        Number of convoys.
    rng
        Source of the draws.
    distinct
        Share of the way, about its middle, in which no two routes have a node in common; 0:
        nothing is asked, 1: they meet nowhere but at their ends.
    tries
        Give up after so many days that were not distinct.

    Raises
    ------
    NotDistinct
        No such day was drawn; says how many convoys can be apart at all.
    InvalidOption
        ``n``, ``distinct`` or ``tries`` is out of range, or the strategy goes by way of stops.
    """
    return draw_days(strategy, n, 1, rng, distinct, tries)[0][0]


def draw_days(
    strategy: Strategy,
    n: int,
    count: int,
    rng: np.random.Generator,
    distinct: float = 0.5,
    tries: int = MOST_TRIES,
) -> tuple[list[list[IndexArray]], float]:
    """Draw ``count`` days as ``sample_departures`` does; also the share of days that were distinct.

    Gives up where fewer than one day in ``tries`` is. Raises what ``sample_departures`` does.
    """
    check_whole('n', n, 1)
    check_whole('tries', tries, 1)
    middle = Middle(strategy, distinct)
    days: list[list[IndexArray]] = []
    tried, found, batch = 0, 0, 1 if count == 1 else max(_ROUTES_AT_ONCE // n, 1)
    while len(days) < count:
        middle.go_on(n, len(days), tried, tries)
        batch = min(batch, tries * (len(days) + 1) - tried)
        routes = strategy.sample_routes(n * batch, rng)
        owner = np.repeat(np.arange(n * batch), [len(route) for route in routes])
        good = np.flatnonzero(middle.apart(np.concatenate(routes), owner // n, batch))
        days += [routes[n * k:n * k + n] for k in good[:count - len(days)]]
        tried, found = tried + batch, found + len(good)
        batch = max(min(4 * batch, _ROUTES_AT_ONCE // n), 1)
    return days, found / tried


def day_effect(
    strategy: Strategy,
    n: int,
    rng: np.random.Generator,
    distinct: float = 0.5,
    days: int = 1000,
    tries: int = MOST_TRIES,
) -> DayEffect:
    """Tell how the law of a day's convoys differs from the strategy's.

    Averages over ``days`` drawn days of n - 1 convoys what the law of one more is beside them,
    which is exact. Raises what ``sample_departures`` does.

    Raises
    ------
    InvalidOption
        The strategy has cycles, so its probabilities are not those of routes.
    """
    check_whole('n', n, 1)
    check_whole('days', days, _GROUPS)
    if not is_acyclic(strategy.network, strategy.edge_probability):
        raise InvalidOption('the strategy has cycles; use the solver max_entropy')
    others, share = ([[] for _ in range(days)], 1.0) if n == 1 else draw_days(
        strategy, n - 1, days, rng, distinct, tries
    )
    middle, beside = Middle(strategy, distinct), _Beside(strategy)
    size = max(1, min(days // _GROUPS, _NUMBERS // len(strategy.network.points)))
    parts = [beside.flow(middle, others[k:k + size]) for k in range(0, days, size)]
    chance, flow = np.array([part[0] for part in parts]), np.array([part[1] for part in parts])
    if not chance.sum() > 0.0:
        raise middle.not_distinct(n, 0, days)
    p = flow.sum(axis=0) / chance.sum()
    game = strategy.game
    visits, losses = game.visits(p), game.site_losses(p)
    error = 0.0
    if len(losses):
        worst = int(np.argmax(losses))
        # Of a ratio of means, by groups of days.
        cost = np.asarray(game.hits[[worst]] @ flow.T).ravel() * game.loss[game.sites[worst]]
        off = cost - losses[worst] * chance
        error = float(np.sqrt(off @ off * len(off) / (len(off) - 1)) / chance.sum())
    return DayEffect(
        share * float(chance.sum()) / days,
        frozen_array(visits, np.float64),
        float(np.abs(visits - strategy.visit_probability).max()),
        worst_loss(game, p),
        error,
    )


class Middle:
    """The middle of the way from source to target: nodes (N,), and which routes share none of it.

    Raises
    ------
    InvalidOption
        ``distinct`` is not in 0..1, or the strategy is a trip's with stops, on which two convoys
        can share a place in different legs.
    """

    def __init__(self, strategy: Strategy, distinct: float) -> None:
        check_at_least('distinct', distinct, 0.0)
        if distinct > 1.0:
            raise InvalidOption(f'distinct must be a share of the way, 0 to 1, got {distinct}')
        if strategy.network.legs > 1:
            raise InvalidOption('convoys of one day cannot go by way of stops; plan without them')
        self._strategy, self.distinct = strategy, distinct
        self.nodes: BoolArray = np.zeros(len(strategy.network.points), dtype=bool)
        if distinct > 0.0:
            self._find()

    def _find(self) -> None:
        network = self._strategy.network
        lengths, count = network.lengths, len(network.points)
        ahead = distances_from(network.edges, lengths, count, network.source)
        behind = distances_from(network.edges[:, ::-1], lengths, count, network.target)
        with np.errstate(invalid='ignore'):
            share = ahead / (ahead + behind)
        first, last = 0.5 - self.distinct / 2.0, 0.5 + self.distinct / 2.0
        # Nodes off every route have no share and are never driven through.
        self.nodes |= (share > first) & (share < last)
        used = self._strategy.edge_probability > 0.0
        tails, heads = network.tails[used], network.heads[used]
        across = (share[tails] <= first) & (share[heads] >= last)
        across |= (share[tails] >= last) & (share[heads] <= first)
        self.nodes[np.where(tails == network.source, heads, tails)[across]] = True
        self.nodes[[network.source, network.target]] = False

    def apart(self, nodes: IndexArray, day: IndexArray, count: int) -> BoolArray:
        """Tell of which days, 0..count - 1, no two routes share any of the middle.

        ``nodes`` (K,) are those of all routes, which come nowhere twice, ``day`` (K,) of which day.
        """
        inner = self.nodes[nodes]
        used = np.sort(day[inner] * len(self.nodes) + nodes[inner])
        apart = np.ones(count, dtype=bool)
        apart[used[1:][used[1:] == used[:-1]] // len(self.nodes)] = False
        return apart

    def go_on(self, n: int, found: int, tried: int, tries: int) -> None:
        """Raise ``NotDistinct`` where ``found`` of ``tried`` days of ``n`` routes are too few."""
        hopeless = not found and tried >= _PATIENCE and self.most(n) < n
        if hopeless or tried >= tries * (found + 1):
            raise self.not_distinct(n, found, tried)

    def not_distinct(self, n: int, found: int, tried: int) -> NotDistinct:
        """The error of ``n`` routes that were apart in ``found`` of ``tried`` tries."""
        most = self.most(n)
        there = f'no more than {most} can be' if most < n else 'routes that are, are too rare'
        return NotDistinct(
            f'{n} routes were apart over the middle {100.0 * self.distinct:g} % of the way in '
            f'{found} of {tried} tries: {there}; plan fewer convoys, or a smaller share to be '
            'distinct in'
        )

    def most(self, n: int) -> int:
        """How many routes of the strategy can be apart at once, counted up to ``n``: a flow."""
        network, count = self._strategy.network, len(self.nodes)
        used = np.flatnonzero(self._strategy.edge_probability > 0.0)
        # Node j comes in at j and goes out at count + j.
        nodes = np.arange(count)
        tails = np.concatenate((nodes, network.tails[used] + count))
        heads = np.concatenate((nodes + count, network.heads[used]))
        room = np.full(len(tails), n, np.int32)
        room[:count][self.nodes] = 1
        graph = coo_matrix((room, (tails, heads)), shape=(2 * count, 2 * count)).tocsr()
        return int(maximum_flow(graph, network.source, network.target + count).flow_value)


class _Beside:
    """The law of one more convoy beside others: the strategy on condition that it avoids them.

    With w = p / x the chance of the next edge, a the chance to come to a node and Z the chance to
    go on from it to the target, past the others' nodes: an edge is used with w a_tail Z_head.
    """

    def __init__(self, strategy: Strategy) -> None:
        network, p = strategy.network, strategy.edge_probability
        self._network = network
        rank = rank_around(strategy.game, p, np.zeros(len(network.points)))
        used = np.flatnonzero(p > 0.0)
        self._edges = used[np.argsort(rank[network.tails[used]], kind='stable')]
        tails = network.tails[self._edges]
        leaving = sums(tails, p[self._edges], len(network.points))
        self._chance = p[self._edges] / leaving[tails]
        begin = np.flatnonzero(np.diff(tails, prepend=-1))
        end = [*begin[1:].tolist(), len(tails)]
        self._nodes = list(zip(tails[begin].tolist(), map(slice, begin.tolist(), end), strict=True))

    def flow(
        self, middle: Middle, days: Sequence[Sequence[IndexArray]]
    ) -> tuple[float, FloatArray]:
        """Sum over days of the chance to avoid the day's routes, and of the flow (M,) that does."""
        network = self._network
        shape = len(network.points), len(days)
        free, ahead, behind = np.ones(shape), np.zeros(shape), np.zeros(shape)
        for k, day in enumerate(days):
            for route in day:
                free[route[middle.nodes[route]], k] = 0.0
        heads, chance = network.heads[self._edges], self._chance
        behind[network.target], ahead[network.source] = 1.0, 1.0
        for node, out in reversed(self._nodes):
            behind[node] = free[node] * (chance[out] @ behind[heads[out]])
        for node, out in self._nodes:
            ahead[node] *= free[node]
            ahead[heads[out]] += chance[out, None] * ahead[node]
        p = np.zeros(len(network.edges))
        # Where a head is not free, nothing goes on behind it.
        p[self._edges] = chance * [
            ahead[tail] @ behind[head]
            for tail, head in network.edges[self._edges].tolist()
        ]
        return float(behind[network.source].sum()), p
