"""Routes of several convoys of one day that share no node of the middle section.

The routes of a day are independent draws, all repeated until no node of the middle section is on
two of them. So all convoys of a day have the same distribution, regardless of their order, but it
differs from the strategy: routes that leave space for others become more likely. ``day_effect``
estimates by how much, and what that costs.

A node is in the middle section if its progress d(s, j) / (d(s, j) + d(j, t)), with shortest lengths
d over the network, lies between two bounds. An edge in use that crosses the whole section adds its
tail, or its head if the tail is the source.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import maximum_flow

from ..arrays import BoolArray, FloatArray, IndexArray, frozen_array, sums
from ..errors import InvalidOption, NotDistinct
from ..game.law.acyclic import is_acyclic, order_along
from ..game.strategy import Strategy
from ..network.shortest_paths import distances_from
from ..option_checks import check_at_least, check_whole

# Default for the number of days drawn for each distinct one before giving up.
MOST_TRIES = 100_000
# Days drawn without a distinct one before checking that distinct routes exist.
_FEASIBILITY_CHECK = 1000
# Routes drawn together; bounds the memory.
_ROUTES_AT_ONCE = 20_000
# Numbers in memory at a time.
_NUMBERS = 2_000_000
# Smallest share of distinct days of which an effect is estimated; that of rarer ones is noise.
LEAST_SHARE = 1e-4
# Minimum number of groups of days from which standard errors are estimated.
_GROUPS = 20


@dataclass(frozen=True, eq=False)
class DayEffect:
    """Effect of distinct routes on the published probabilities.

    Attributes
    ----------
    share : float
        Probability that independent draws are distinct; a day takes 1 / share tries on average.
    visit_probability : (N,)
        Visit probabilities of each convoy of such a day.
    largest_change : float
        Largest change of a node's visit probability from the strategy's.
    value, standard_error : float
        Mean loss of each convoy by the best ambush against such days, and its standard error.
    """

    share: float
    visit_probability: FloatArray
    largest_change: float
    value: float
    standard_error: float


def sample_departures(strategy: Strategy, n: int, rng: np.random.Generator, distinct: float = 0.5,
                      tries: int = MOST_TRIES) -> list[IndexArray]:
    """Draw the routes of ``n`` convoys of one day: node indices (K,) each.

    ``distinct`` is the size of the middle section, as a share of the way, in which routes share no
    node; with 0 they may share any, with 1 they meet only at their ends. Gives up after ``tries``
    days.

    Raises NotDistinct, which states how many convoys can have distinct routes, if no such day was
    drawn; InvalidOption if an option is out of range or the strategy has stops.
    """
    return draw_days(strategy, n, 1, rng, distinct, tries)[0][0]


def draw_days(strategy: Strategy, n: int, count: int, rng: np.random.Generator,
              distinct: float = 0.5,
              tries: int = MOST_TRIES) -> tuple[list[list[IndexArray]], float]:
    """Draw ``count`` days as ``sample_departures`` does; also return the share that was distinct.

    Gives up if fewer than one day in ``tries`` is distinct. Raises as ``sample_departures``.
    """
    check_whole('n', n, 1)
    check_whole('tries', tries, 1)
    middle = MiddleSection(strategy, distinct)
    days: list[list[IndexArray]] = []
    tried, found, batch = 0, 0, 1 if count == 1 else max(_ROUTES_AT_ONCE // n, 1)
    while len(days) < count:
        middle.check_progress(n, len(days), tried, tries)
        batch = min(batch, tries * (len(days) + 1) - tried)
        routes = strategy.sample_routes(n * batch, rng)
        owner = np.repeat(np.arange(n * batch), [len(route) for route in routes])
        good = np.flatnonzero(middle.are_disjoint(np.concatenate(routes), owner // n, batch))
        days += [routes[n * k:n * k + n] for k in good[:count - len(days)]]
        tried, found = tried + batch, found + len(good)
        batch = max(min(4 * batch, _ROUTES_AT_ONCE // n), 1)
    return days, found / tried


def day_effect(strategy: Strategy, n: int, rng: np.random.Generator, distinct: float = 0.5,
               days: int = 1000, tries: int = MOST_TRIES) -> DayEffect:
    """Estimate how the distribution of a day's convoys differs from the strategy.

    Averages the exact distribution of one more convoy over ``days`` drawn days of n - 1 convoys.
    Raises as ``sample_departures``; NotDistinct if the share is below ``LEAST_SHARE``, and
    InvalidOption if the strategy has cycles.
    """
    check_whole('n', n, 1)
    check_whole('days', days, _GROUPS)
    if not is_acyclic(strategy.network, strategy.edge_probability):
        raise InvalidOption('the strategy has cycles; use the solver max_entropy')
    others, share = ([[] for _ in range(days)], 1.0) if n == 1 else draw_days(
        strategy, n - 1, days, rng, distinct, tries
    )
    middle, conditional = MiddleSection(strategy, distinct), _ConditionalFlow(strategy)
    size = max(1, min(days // _GROUPS, _NUMBERS // len(strategy.network.points)))
    groups = [others[k:k + size] for k in range(0, days, size)]
    parts = [conditional.flow(middle, group) for group in groups]
    chance, flow = np.array([part[0] for part in parts]), np.array([part[1] for part in parts])
    if not chance.sum() > 0.0:
        raise middle.not_distinct(n, 0, days)
    share *= float(chance.sum()) / days
    if share < LEAST_SHARE:
        raise NotDistinct(
            f'{n} routes are distinct over the middle {100.0 * distinct:g} % of the way with '
            f'probability {share:.2g}, too rarely to estimate the effect (the least is '
            f'{LEAST_SHARE:g}); plan fewer convoys or reduce the distinct share'
        )
    p = flow.sum(axis=0) / chance.sum()
    game = strategy.game
    visits, losses = game.visits(p), game.site_losses(p)
    worst: list[tuple[float, float]] = []
    # Entries bound hits, so only sites that can still be among the worst need a pass.
    for site in np.argsort(-losses):
        if len(worst) == game.ambushers and losses[site] <= worst[-1][0]:
            break
        enters = game.hits[[site]].indices
        unhit = [conditional.reaching_target(middle, group, enters) for group in groups]
        cost = game.loss[game.sites[site]] * (chance - unhit)
        loss = float(cost.sum() / chance.sum())
        # Standard error of a ratio of means over groups of days.
        off = cost - loss * chance
        error = float(np.sqrt(off @ off * len(off) / (len(off) - 1)) / chance.sum())
        worst = sorted([*worst, (loss, error)], reverse=True)[: game.ambushers]
    return DayEffect(
        share, frozen_array(visits, np.float64),
        float(np.abs(visits - strategy.visit_probability).max()),
        sum(loss for loss, _ in worst), sum(error for _, error in worst),
    )


class MiddleSection:
    """The middle section between source and target, as a mask ``nodes`` (N,).

    Raises InvalidOption if ``distinct`` is not in 0..1 or the strategy has stops: two convoys could
    then share a place in different legs.
    """

    def __init__(self, strategy: Strategy, distinct: float) -> None:
        check_at_least('distinct', distinct, 0.0)
        if distinct > 1.0:
            raise InvalidOption(f'distinct must be a share of the way, 0 to 1, got {distinct}')
        if strategy.network.legs > 1:
            raise InvalidOption('convoys of one day cannot have stops; plan without them')
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
        # The progress is nan for nodes on no route, which no convoy visits.
        self.nodes |= (share > first) & (share < last)
        used = self._strategy.edge_probability > 0.0
        tails, heads = network.tails[used], network.heads[used]
        across = (share[tails] <= first) & (share[heads] >= last)
        across |= (share[tails] >= last) & (share[heads] <= first)
        self.nodes[np.where(tails == network.source, heads, tails)[across]] = True
        self.nodes[[network.source, network.target]] = False

    def are_disjoint(self, nodes: IndexArray, day: IndexArray, count: int) -> BoolArray:
        """Return on which of ``count`` days no two routes share a node of the section.

        ``nodes`` (K,) are those of all routes, none of which visits a node twice; ``day`` (K,) are
        the days of their routes.
        """
        inner = self.nodes[nodes]
        used = np.sort(day[inner] * len(self.nodes) + nodes[inner])
        disjoint = np.ones(count, dtype=bool)
        disjoint[used[1:][used[1:] == used[:-1]] // len(self.nodes)] = False
        return disjoint

    def check_progress(self, n: int, found: int, tried: int, tries: int) -> None:
        """Raise ``NotDistinct`` if ``found`` of ``tried`` days of ``n`` routes are too few."""
        impossible = not found and tried >= _FEASIBILITY_CHECK and self.max_disjoint(n) < n
        if impossible or tried >= tries * (found + 1):
            raise self.not_distinct(n, found, tried)

    def not_distinct(self, n: int, found: int, tried: int) -> NotDistinct:
        """The error if ``n`` routes were distinct in ``found`` of ``tried`` tries."""
        most = self.max_disjoint(n)
        reason = f'at most {most} can be' if most < n else 'distinct routes are too rare'
        return NotDistinct(
            f'{n} routes were distinct over the middle {100.0 * self.distinct:g} % of the way in '
            f'{found} of {tried} tries: {reason}; plan fewer convoys or reduce the distinct share'
        )

    def max_disjoint(self, n: int) -> int:
        """Largest number, up to ``n``, of the strategy's routes that can be distinct: a flow."""
        network, count = self._strategy.network, len(self.nodes)
        used = np.flatnonzero(self._strategy.edge_probability > 0.0)
        # Node j is split into an entry j and an exit count + j.
        nodes = np.arange(count)
        tails = np.concatenate((nodes, network.tails[used] + count))
        heads = np.concatenate((nodes + count, network.heads[used]))
        capacity = np.full(len(tails), n, np.int32)
        capacity[:count][self.nodes] = 1
        graph = coo_matrix((capacity, (tails, heads)), shape=(2 * count, 2 * count)).tocsr()
        return int(maximum_flow(graph, network.source, network.target + count).flow_value)


class _ConditionalFlow:
    """The distribution of one more convoy, given that it avoids the others in the middle section.

    With transition probabilities w = p / x, the probability a of reaching a node and Z of reaching
    the target from it, both past the others' nodes, an edge is used with probability
    w a_tail Z_head.
    """

    def __init__(self, strategy: Strategy) -> None:
        network, p = strategy.network, strategy.edge_probability
        self._network = network
        rank = order_along(network, p)
        assert rank is not None  # the strategy is acyclic
        used = np.flatnonzero(p > 0.0)
        self._edges = used[np.argsort(rank[network.tails[used]], kind='stable')]
        tails = network.tails[self._edges]
        leaving = sums(tails, p[self._edges], len(network.points))
        self._chance = p[self._edges] / leaving[tails]
        begin = np.flatnonzero(np.diff(tails, prepend=-1))
        end = [*begin[1:].tolist(), len(tails)]
        self._nodes = list(zip(tails[begin].tolist(), map(slice, begin.tolist(), end), strict=True))

    def flow(self, middle: MiddleSection,
             days: Sequence[Sequence[IndexArray]]) -> tuple[float, FloatArray]:
        """Sums over days of the probability to avoid the day's routes, and of that flow (M,)."""
        network, chance = self._network, self._chance
        heads, free = network.heads[self._edges], self._free(middle, days)
        behind, ahead = self._reaching_target(free, chance), np.zeros_like(free)
        ahead[network.source] = 1.0
        for node, out in self._nodes:
            ahead[node] *= free[node]
            ahead[heads[out]] += chance[out, None] * ahead[node]
        p = np.zeros(len(network.edges))
        # At blocked heads, ``behind`` is 0.
        p[self._edges] = chance * [ahead[tail] @ behind[head]
                                   for tail, head in network.edges[self._edges].tolist()]
        return float(behind[network.source].sum()), p

    def reaching_target(self, middle: MiddleSection, days: Sequence[Sequence[IndexArray]],
                        without: IndexArray) -> float:
        """Sum over days of the probability to avoid the day's routes and the edges ``without``."""
        chance = np.where(np.isin(self._edges, without), 0.0, self._chance)
        found = self._reaching_target(self._free(middle, days), chance)
        return float(found[self._network.source].sum())

    def _free(self, middle: MiddleSection, days: Sequence[Sequence[IndexArray]]) -> FloatArray:
        """Where no other convoy drives (N, days): 1, else 0."""
        free = np.ones((len(self._network.points), len(days)))
        for k, day in enumerate(days):
            for route in day:
                free[route[middle.nodes[route]], k] = 0.0
        return free

    def _reaching_target(self, free: FloatArray, chance: FloatArray) -> FloatArray:
        """Probability (N, days) of reaching the target from each node by free nodes."""
        behind, heads = np.zeros_like(free), self._network.heads[self._edges]
        behind[self._network.target] = 1.0
        for node, out in reversed(self._nodes):
            behind[node] = free[node] * (chance[out] @ behind[heads[out]])
        return behind
