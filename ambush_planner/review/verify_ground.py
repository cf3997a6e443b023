"""A route that was drawn on condition that it is clear on a map that has changed: drawn again."""

from __future__ import annotations

import numpy as np

from ..core.planner import Plan
from ..recording.map_changes import BadMapChanges, changed_map
from ..ros.conversions import occupancy_from_ros
from ..ros.ground import Ground
from ..ros.inputs import MapInForce
from .case import Case


def changed_route_faults(case: Case, plan: Plan) -> list[str]:
    """Draw the route again as the node does, until it is clear on the newest map.

    ``plan`` has the recorded strategy.
    """
    values, resolution, origin = occupancy_from_ros(case.message('map'))
    try:
        after = changed_map(values, case.recorded.map_changes)
    except BadMapChanges as error:
        return [f'map_changes: {error}']
    planned, newest = (
        MapInForce(None, cells, resolution, origin)  # what came, and where from, is not looked at
        for cells in (values, after)
    )
    ground = Ground(plan, planned, case.parameters.occupancy)
    drawn = ground.draw(
        np.random.default_rng(case.metadata.route_entropy_source), newest,
        case.parameters.path_spacing or plan.spacing, case.metadata.ends,
    )
    if drawn is None or not np.array_equal(drawn[0].nodes, case.metadata.route):
        return ['route: it is not what route_entropy_source draws on the map as it had changed']
    return []
