"""A route that was drawn on condition that it is clear on a map that has changed: drawn again."""

from __future__ import annotations

import numpy as np

from ..core.planner import Plan
from ..recording.map_changes import BadMapChanges, changed_map
from ..ros.conversions import occupancy_from_ros
from ..ros.ground import Ground
from ..ros.inputs import MapInForce
from .case import Case


def ground_then(case: Case, plan: Plan) -> tuple[Ground, MapInForce]:
    """The ground as it was planned on, with the recorded strategy, and the newest map.

    Raises
    ------
    UnreadableRecording
        The changes of the map are none.
    """
    values, resolution, origin = occupancy_from_ros(case.message('map'))
    # What came, and where from, is not looked at.
    planned = newest = MapInForce(None, values, resolution, origin)
    if case.recorded.map_changes:
        try:
            after = changed_map(values, case.recorded.map_changes)
        except BadMapChanges as error:
            raise case.unreadable(f'map_changes: {error}') from error
        newest = MapInForce(None, after, resolution, origin)
    return Ground(plan, planned, case.parameters.occupancy), newest


def changed_route_faults(case: Case, ground: Ground, newest: MapInForce) -> list[str]:
    """Draw the route again as the node does, until it is clear on the newest map."""
    drawn = ground.draw(np.random.default_rng(case.metadata.route_entropy_source), newest)
    if drawn is None or not np.array_equal(drawn.nodes, case.metadata.route):
        return ['route: it is not what route_entropy_source draws on the map as it had changed']
    return []
