# SPDX-License-Identifier: Apache-2.0
"""Plans and departures on a new map or new roads: what is still clear, and what it costs now."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ..maps.risk_map import RiskMap
from ..maps.risk_map_file import read_risk_map
from ..maps.road_file import RoadGraph, read_roads
from ..network.road_network import in_map_frame
from ..parameters.values import NodeParameters
from ..planning.changed_ground import Assessment
from ..planning.new_ground import Blocked, NewGround
from .plan_file import SavedPlan
from .recorded_departure import RecordedDeparture


@dataclass(frozen=True, eq=False)
class Now:
    """A departure or a plan on new ground: ``risk_map``.

    ``blocked`` is where the departure's path is; for a plan it is None. ``value`` is that of the
    routes that are still clear, a ``clear_share`` of all, and ``before`` what it was.
    """

    risk_map: RiskMap
    blocked: Blocked | None
    value: float
    clear_share: float
    before: float


class GroundCheck:
    """New ground from files, each of which may be None: the ground as it was recorded."""

    def __init__(self, map_file: Path | None, roads_file: Path | None,
                 once: Callable[..., Any]) -> None:
        self._map_file, self._roads_file, self._once = map_file, roads_file, once

    def departure(self, departure: RecordedDeparture) -> Now:
        """Judge a departure; raises the errors of ``read_risk_map`` and ``read_roads``."""
        planning = departure.parameters.planning
        before, now = self._grounds(departure.newest_risk_map, departure.parameters)
        blocked = now.blocked(departure.recorded_poses, before, planning.network)
        found: Assessment = self._once(NewGround.assess, now, departure.departed_on, before,
                                       planning)
        return Now(now.risk_map, blocked, found.value * departure.covered, found.clear_share,
                   departure.value)

    def plan(self, saved: SavedPlan) -> Now:
        """Judge a plan; raises the same."""
        before, now = self._grounds(saved.plan.own_map, saved.parameters)
        found = now.assess(saved.plan.drawn_from, before, saved.parameters.planning)
        covered = saved.slots.covered if saved.slots else 1.0
        return Now(now.risk_map, None, found.value * covered, found.clear_share, saved.value)

    def _grounds(self, risk_map: RiskMap,
                 parameters: NodeParameters) -> tuple[NewGround, NewGround]:
        """The ground before, and now."""
        roads, now = parameters.planning.network.roads, risk_map
        if self._map_file:
            now = self._once(read_risk_map, self._map_file,
                             replace(parameters.occupancy, crs=risk_map.crs))
        new_roads = roads
        if self._roads_file and roads:
            new_roads = self._once(_roads_in, self._roads_file, risk_map.crs)
        return (self._once(NewGround, risk_map, roads),
                self._once(NewGround, now, new_roads))


def _roads_in(file: Path, crs: str | None) -> RoadGraph:
    return in_map_frame(read_roads(str(file)), crs)
