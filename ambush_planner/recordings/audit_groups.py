"""The departures of each strategy: drawn one by one, or as the distinct ones of a day."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IndexArray
from ..game.strategy import Strategy
from ..routes.days import MOST_TRIES, MiddleSection
from .audit_draws import ROUTES_AT_ONCE, ManyRoutes, NotAuditable, Steps
from .audit_places import Ground


@dataclass(frozen=True, eq=False)
class Day:
    """A day whose convoys share none of the middle ``distinct`` of the way; known by its object."""

    distinct: float = 0.5


@dataclass(frozen=True, eq=False)
class Driven:
    """A departure as the audit takes it: the strategy and the route (K,) drawn from it.

    Departures that ``sample_departures`` drew together have the same ``day``, and nobody else has.
    """

    strategy: Strategy
    route: IndexArray
    day: Day | None = None


@dataclass(frozen=True, eq=False)
class Group:
    """The departures of one strategy.

    Attributes
    ----------
    strategy, many
        What they were drawn from.
    indices : (K,)
        Their places in the order of time.
    days : mapping of Day to (L,) int
        Which of them, 0..K - 1, were drawn together.
    alone : (L,)
        Which were drawn on their own.
    """

    strategy: Strategy
    many: ManyRoutes
    indices: IndexArray
    days: Mapping[Day, IndexArray]
    alone: IndexArray

    def not_distinct(self, routes: Sequence[IndexArray]) -> int:
        """On how many days routes share some of the middle; ``routes`` of all departures."""
        found = 0
        shares = {day.distinct for day in self.days}
        middles = {share: MiddleSection(self.strategy, share) for share in shares}
        for day, who in self.days.items():
            nodes = np.concatenate([routes[k] for k in who])
            none = np.zeros(len(nodes), np.int64)
            found += not middles[day.distinct].are_disjoint(nodes, none, 1)[0]
        return found

    def draw_sets(self, sets: int, rng: np.random.Generator) -> Iterator[tuple[slice, Steps]]:
        """Draw ``sets`` times all departures, as ``ManyRoutes.draw_sets``."""
        if not self.days:
            yield from self.many.draw_sets(len(self.indices), sets, rng)
            return
        # Days of as many convoys, as far apart, have one law: which departures they are, (D, n).
        alike: dict[tuple[int, float], list[IndexArray]] = {}
        for day, who in self.days.items():
            alike.setdefault((len(who), day.distinct), []).append(who)
        at_once = max(ROUTES_AT_ONCE // len(self.indices), 1)
        for begin in range(0, sets, at_once):
            size = min(at_once, sets - begin)
            parts = [(self.alone, self.many.draw(size * len(self.alone), rng))]
            for (n, distinct), days in alike.items():
                drawn = self._draw_days(distinct, n, size * len(days), rng)
                parts.append((np.concatenate(days), drawn))
            yield slice(begin, begin + size), self._joined(size, parts)

    def _draw_days(
        self, distinct: float, n: int, count: int, rng: np.random.Generator
    ) -> Steps:
        """Routes of ``count`` days of ``n`` convoys, day by day: as ``routes.days.draw_days``."""
        middle = MiddleSection(self.strategy, distinct)
        edges, routes, found, tried = [], [], 0, 0
        while found < count:
            middle.check_progress(n, found, tried, MOST_TRIES)
            batch = max(ROUTES_AT_ONCE // n, 1)
            steps = self.many.draw(batch * n, rng)
            day = steps.route // n
            apart = middle.are_disjoint(self.many.network.heads[steps.edge], day, batch)
            place = np.cumsum(apart) - 1 + found
            kept = apart[day] & (place[day] < count)
            edges.append(steps.edge[kept])
            routes.append(place[day[kept]] * n + steps.route[kept] % n)
            found, tried = found + int(apart.sum()), tried + batch
        return Steps(count * n, np.concatenate(edges), np.concatenate(routes))

    def _joined(self, size: int, parts: Sequence[tuple[IndexArray, Steps]]) -> Steps:
        """The steps of ``size`` sets from those of their parts, set by set in each."""
        parts = [(who, steps) for who, steps in parts if len(who)]
        routes = [
            steps.route // len(who) * len(self.indices) + who[steps.route % len(who)]
            for who, steps in parts
        ]
        edges = np.concatenate([steps.edge for _, steps in parts])
        return Steps(size * len(self.indices), edges, np.concatenate(routes))


def groups_of(departures: Sequence[Driven]) -> list[Group]:
    """Sort departures by strategy.

    Raises
    ------
    NotAuditable
        A strategy has cycles, or the departures of a day have several.
    """
    found: dict[int, list[int]] = {}
    for number, each in enumerate(departures):
        found.setdefault(id(each.strategy), []).append(number)
    groups = [_group(departures, np.array(numbers)) for numbers in found.values()]
    days = [id(day) for group in groups for day in group.days]
    if len(days) > len(set(days)):
        raise NotAuditable('the departures of one day were drawn from several strategies')
    return groups


def _group(departures: Sequence[Driven], indices: IndexArray) -> Group:
    strategy = departures[indices[0]].strategy
    days: dict[Day, list[int]] = {}
    alone = []
    for k, number in enumerate(indices):
        day = departures[number].day
        (alone if day is None else days.setdefault(day, [])).append(k)
    return Group(
        strategy, ManyRoutes(strategy.network, strategy.edge_probability), indices,
        {day: np.array(who) for day, who in days.items()}, np.array(alone, dtype=np.int64),
    )


def owners(groups: Sequence[Group], count: int) -> IndexArray:
    """Which group each departure (n,) belongs to."""
    owner = np.empty(count, np.int64)
    for k, group in enumerate(groups):
        owner[group.indices] = k
    return owner


def expected_by_law(
    groups: Sequence[Group], ground: Ground
) -> tuple[FloatArray, FloatArray]:
    """Expected passages and their variance at each place of an edge (C,)."""
    expected, variance = np.zeros(len(ground.segments)), np.zeros(len(ground.segments))
    for group, place in zip(groups, ground.of_edge, strict=True):
        used, n = group.many.used, len(group.indices)
        p = group.many.p[used]
        np.add.at(expected, place[used], n * p)
        # Rounding may leave a p a little over 1.
        np.add.at(variance, place[used], n * np.maximum(p * (1.0 - p), 0.0))
    return expected, variance


def expected_of_sets(
    passages: npt.NDArray[np.uint16]
) -> tuple[FloatArray, FloatArray]:
    """Mean and variance (C,) of the passages (B + 1, C) of all sets, which are exchangeable."""
    mean = passages.mean(axis=0, dtype=np.float64)
    square = np.zeros_like(mean)
    for row in passages:
        square += (row - mean) ** 2
    return mean, square / len(passages)
