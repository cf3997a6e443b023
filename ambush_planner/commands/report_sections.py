"""Departures by trip: one map, and one pair of places, which may have moved a little."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from ..game.strategy import Strategy
from ..maps.risk_map import RiskMap
from ..recordings import RecordedDeparture
from .figures import ROUTES

# Places are the same up to this share of the way between start and goal.
_MOVED = 0.05


@dataclass(frozen=True, eq=False)
class Section:
    """The departures of one trip, in the order of time."""

    departures: list[RecordedDeparture]

    @property
    def strategy(self) -> Strategy:
        """The latest one."""
        return self.departures[-1].strategy

    @property
    def risk_map(self) -> RiskMap:
        """The map, which all have."""
        return self.departures[-1].risk_map

    @property
    def strategies(self) -> int:
        """How many strategies the departures were drawn from."""
        return len({id(each.strategy) for each in self.departures})

    def colours(self) -> dict[int, str]:
        """The colours of the latest departures, by index: as many as can be told apart."""
        count = len(self.departures)
        return {k: ROUTES[k % len(ROUTES)] for k in range(max(0, count - len(ROUTES)), count)}

    def takes(self, other: RecordedDeparture) -> bool:
        """Whether a departure is of this trip."""
        first = self.departures[0]
        if other.risk_map is not first.risk_map:
            return False
        one, two = first.trip, other.trip
        far = math.dist(one.start_xy, one.goal_xy) * _MOVED
        return (
            math.dist(one.start_xy, two.start_xy) <= far
            and math.dist(one.goal_xy, two.goal_xy) <= far
        )


def sections_of(departures: Iterable[RecordedDeparture]) -> list[Section]:
    """Sort departures by trip, the earliest first."""
    sections: list[Section] = []
    for each in departures:
        for section in sections:
            if section.takes(each):
                section.departures.append(each)
                break
        else:
            sections.append(Section([each]))
    return sections
