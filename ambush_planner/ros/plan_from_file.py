# SPDX-License-Identifier: Apache-2.0
"""A plan file as the node's start: its options as parameters."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import InvalidOption
from ..maps.occupancy import risk_from_occupancy
from ..parameters.table import PARAMETERS
from ..recordings import UnreadableRecording
from ..recordings.plain_messages import grid_values
from ..recordings.plan_file import SavedPlan, read_plan

# Parameters that the plan sets begin with one of these, or are one; the node keeps the others.
_SET = ('map.', 'network.', 'game.', 'strategy.', 'route.', 'trip.order')
_KEPT = ('map.costmap', 'strategy.max_gap', 'route.path_spacing')


def read_plan_for_node(path: str) -> SavedPlan:
    """Read a plan file that the node can draw from; raises InvalidOption."""
    try:
        saved = read_plan(path)
    except UnreadableRecording as error:
        raise InvalidOption(f'plan: {error}') from error
    plan, occupancy = saved.plan, saved.parameters.occupancy
    assert plan.risk_map is not None
    if plan.few:
        raise InvalidOption(f'plan {path} draws from {len(plan.few.paths)} routes, but the node '
                            'draws from a whole strategy; plan without --routes')
    again = risk_from_occupancy(grid_values(plan.risk_map, occupancy), plan.risk_map.resolution,
                                plan.risk_map.origin, occupancy)
    free = ~plan.risk_map.obstacles
    if not (np.array_equal(again.obstacles, plan.risk_map.obstacles)
            and np.allclose(again.alpha[free], plan.risk_map.alpha[free], rtol=1e-9)):
        raise InvalidOption(f'plan {path} has a map whose losses an occupancy grid cannot hold; '
                            'plan on the .yaml or .tif file of ambush risk')
    return saved


def planned_parameters(saved: SavedPlan) -> dict[str, Any]:
    """The parameters that a plan sets, by name."""
    return {name: value for name, value in saved.parameters.values.items()
            if name in PARAMETERS and name.startswith(_SET) and name not in _KEPT}


def other_options(saved: SavedPlan) -> dict[str, Any]:
    """The options of a plan that are no parameters of the node."""
    return {name: value for name, value in saved.parameters.values.items()
            if name not in PARAMETERS}
