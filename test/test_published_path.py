# SPDX-License-Identifier: Apache-2.0
"""The path that is published: dense, clear of obstacles, between exactly the poses given."""

import numpy as np
import pytest
from rclpy.parameter import Parameter
from ros_harness import pose, stage

from ambush_planner.maps.ros_messages import path_from_ros

START, GOAL = pose(1.5, 5.5, 0.3), pose(8.5, 5.5, -2.0)


@pytest.fixture(scope='module')
def running():
    with stage() as running:
        running.give()
        yield running


def rows_with(running, **parameters):
    """Poses (L, 3) of a path that the node plans with other parameters."""
    changes = [Parameter(name.replace('__', '.'), value=value)
               for name, value in parameters.items()]
    assert running.planner.set_parameters_atomically(changes).successful
    return path_from_ros(running.client.get_plan(START, GOAL))


def steps(rows):
    return np.hypot(*np.diff(rows[:, :2], axis=0).T)


def test_poses_are_as_far_apart_as_nodes_or_cells_or_the_parameter_say(running):
    longest = steps(rows_with(running, network__spacing=1.0, route__path_spacing=0.0)).max()
    assert 0.5 < longest <= 1.0 + 1e-9, 'nodes lie further apart than cells'
    longest = steps(rows_with(running, network__spacing=0.25)).max()
    assert 0.25 <= longest <= 0.5 + 1e-9, 'cells are larger'
    longest = steps(rows_with(running, network__spacing=1.0, route__path_spacing=0.1)).max()
    assert 0.05 < longest <= 0.1 + 1e-9


@pytest.mark.parametrize('spacing', [1e-4, 5e-324])
def test_a_path_of_too_many_poses_is_refused(running, spacing):
    assert not len(rows_with(running, route__path_spacing=spacing))
    report = running.client.diagnostics(code='INVALID_OPTION')
    assert 'route.path_spacing' in report['message']
    assert len(rows_with(running, route__path_spacing=0.0))
    running.client.diagnostics(code='NONE')
