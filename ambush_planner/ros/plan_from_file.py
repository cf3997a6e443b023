# SPDX-License-Identifier: Apache-2.0
"""A plan file as the node's start: its options as parameters, its map and trip as inputs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseArray, PoseStamped
from std_msgs.msg import Header

from ..errors import InvalidOption
from ..maps.occupancy import risk_from_occupancy
from ..parameters.table import PARAMETERS, is_planned
from ..parameters.values import NodeParameters
from ..planning.plan import measured_corridors
from ..recordings.messages import grid_values
from ..recordings.plan_file import SavedPlan, read_plan
from ..recordings.recording_errors import UnreadableRecording
from .conversions import occupancy_to_ros, pose_to_ros
from .current_map import CurrentMap, map_from
from .trip import TripRequest


def read_plan_for_node(path: str) -> SavedPlan:
    """Read a plan file that the node can draw from, with corridors; raises InvalidOption."""
    try:
        saved = read_plan(path)
    except UnreadableRecording as error:
        raise InvalidOption(f'plan: {error}') from error
    plan, occupancy = saved.plan, saved.parameters.occupancy
    risk_map = plan.own_map
    again = risk_from_occupancy(grid_values(risk_map, occupancy), risk_map.resolution,
                                risk_map.origin, occupancy)
    free = ~risk_map.obstacles
    if not (np.array_equal(again.obstacles, risk_map.obstacles)
            and np.allclose(again.alpha[free], risk_map.alpha[free], rtol=1e-9)):
        raise InvalidOption(f'plan {path} has a map whose losses an occupancy grid cannot hold; '
                            'plan on the .yaml or .tif file of ambush risk')
    return replace(saved, plan=replace(plan, corridors=measured_corridors(plan)))


def planned_parameters(saved: SavedPlan) -> dict[str, Any]:
    """The parameters that a plan sets, by name."""
    return {name: value for name, value in saved.parameters.values.items()
            if name in PARAMETERS and not PARAMETERS[name].fixed
            and (is_planned(name) or name == 'map.preset')}


def inputs_of(saved: SavedPlan, parameters: NodeParameters,
              full_name: Callable[[str], str]) -> tuple[CurrentMap, TripRequest]:
    """The map and the trip of a plan as if they had arrived; ``full_name`` is that of a topic."""
    plan, header = saved.plan, Header(frame_id=saved.frame)
    risk_map, network = plan.own_map, plan.network
    grid = occupancy_to_ros(grid_values(risk_map, saved.parameters.occupancy), risk_map.resolution,
                            risk_map.origin, header)
    start, goal = (PoseStamped(header=header, pose=pose_to_ros(*network.points[node].tolist()))
                   for node in (network.source, network.target))
    stops = PoseArray(header=header, poses=[pose_to_ros(*xy) for xy in plan.stops_xy])
    return (map_from(grid, full_name('alpha_map')),
            TripRequest(parameters, start, goal, via=stops if plan.stops_xy else None))
