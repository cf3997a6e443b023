# SPDX-License-Identifier: Apache-2.0
"""The data of a report: departures by trip, and their measures."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

from ..game.strategy import TripStrategy
from ..maps.risk_map import RiskMap
from ..operations.slots import Slots
from ..planning.ambush_costs import BestAmbush, best_ambush
from ..planning.evaluation import Measures, compared
from .recorded_departure import RecordedDeparture

# Starts or goals are the same up to this share of the distance between start and goal.
SAME_TRIP = 0.05


@dataclass(frozen=True, eq=False)
class Section:
    """The departures of one trip in order of time; start and goal may move a little."""

    departures: list[RecordedDeparture]

    @property
    def trip(self) -> TripStrategy:
        """The latest strategies."""
        return self.departures[-1].departed_on

    @property
    def slots(self) -> Slots | None:
        """The times that the latest departure's was drawn from, if any."""
        return (self.departures[-1].drawn_slot or ('', None))[1]

    @property
    def bounds(self) -> tuple[float, float]:
        """Value and lower bound for an ambusher who also has to choose a time, if it is drawn."""
        return self.departures[-1].value, self.departures[-1].lower_bound

    @property
    def risk_map(self) -> RiskMap:
        """The map of the latest departure; the others were planned on the same one."""
        return self.departures[-1].newest_risk_map

    @cached_property
    def measures(self) -> dict[str, Measures]:
        """The departures' strategy, at the times that are drawn, and planners of a fixed route."""
        last = self.departures[-1]
        rows = compared(self.trip, self.trip)
        drawn = rows['stochastic']
        return rows | {'stochastic': replace(
            drawn, p_first=drawn.p_first * last.covered, p_repeated=drawn.p_repeated * last.covered,
            v_repeated=drawn.v_repeated * last.covered)}

    @cached_property
    def best(self) -> BestAmbush | None:
        """The best ambush, for one who knows the time."""
        return best_ambush(self.trip, self.risk_map)

    def includes(self, other: RecordedDeparture) -> bool:
        """Return whether a departure is on this trip."""
        first = self.departures[0]
        one, two = first.metadata.trip, other.metadata.trip
        far = math.dist(one.start, one.goal) * SAME_TRIP
        return (other.risk_map is first.risk_map
                and math.dist(one.start, two.start) <= far
                and math.dist(one.goal, two.goal) <= far)


def sections_of(departures: Iterable[RecordedDeparture]) -> list[Section]:
    """Group departures by trip, the earliest trip first."""
    sections: list[Section] = []
    for each in departures:
        section = next((section for section in sections if section.includes(each)), None)
        if section is None:
            sections.append(section := Section([]))
        section.departures.append(each)
    return sections
