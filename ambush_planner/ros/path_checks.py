# SPDX-License-Identifier: Apache-2.0
"""Nav2's service ``is_path_valid``: whether the rest of a path is clear on the newest map."""

from __future__ import annotations

from typing import Any

import numpy as np
from nav_msgs.msg import Path

from ..arrays import FloatArray, Position
from ..errors import InvalidPose
from ..maps.ros_messages import path_from_ros
from ..planning.clear_ground import WAY_OUT, ClearGround
from .conversions import installed_type
from .errors import ErrorBoundary, FrameMismatch
from .inputs import Inputs
from .listener import Listener
from .parameter_changes import NodeSettings


class PathChecks:
    """Serves ``~/is_path_valid`` by a listener, if ``nav2_msgs`` is installed.

    Not by the planner's executor: rclpy takes 0.3 s to read a path of 20 000 poses.
    """

    def __init__(self, listener: Listener, inputs: Inputs, settings: NodeSettings,
                 error_boundary: ErrorBoundary) -> None:
        self._inputs, self._settings, self._error_boundary = inputs, settings, error_boundary
        if kind := installed_type('nav2_msgs.srv', 'IsPathValid'):
            listener.serve(kind, '~/is_path_valid',
                           lambda request: self._check(request, kind.Response))

    def _check(self, request: Any, kind: Any) -> Any:
        invalid, error = self._error_boundary.attempt(
            'is_path_valid', 'request', lambda: self._invalid_poses(request.path))
        return kind() if error else kind(is_valid=invalid == [],
                                         invalid_pose_indices=invalid or [])

    def _invalid_poses(self, path: Path) -> list[int] | None:
        """Return the indices of a path's poses, from the robot on, that cannot be reached.

        The newest map counts. None if the path has no poses: Nav2's trees ask so before their first
        path. Raises Refusal without a map, FrameMismatch if the path is not in the map's frame, and
        InvalidPose.
        """
        if not path.poses:
            return None
        newest, parameters = self._inputs.current_map(), self._settings.current
        if path.header.frame_id != newest.frame:
            raise FrameMismatch(f'the path is in the frame {path.header.frame_id[:80]!r}, the map '
                                f'in {newest.frame!r}')
        points = path_from_ros(path)[:, :2]
        if not np.isfinite(points).all():
            raise InvalidPose('path: positions must be finite')
        values = parameters.values
        place = self._inputs.robot_place(values['robot_base_frame'], newest.frame,
                                         values['transform.max_age'])
        first = _first_near(points, place) if place else 0
        rest = points[first:]
        ground = ClearGround(newest, parameters.occupancy, parameters.planning.network)
        if len(rest) == 1:
            return [] if ground.segments(rest, rest).all() else [first]
        return (np.flatnonzero(~ground.drivable_steps(rest)) + first + 1).tolist()


def _first_near(points: FloatArray, place: Position) -> int:
    """Return the pose of a path (L, 2) where it first passes a place [m].

    The nearest pose of a way out and back may be on the way back.
    """
    away, steps = np.hypot(*(points - place).T), np.hypot(*np.diff(points, axis=0).T)
    near = away <= max(WAY_OUT + steps.max(initial=0.0), away.min())
    first = int(near.argmax())
    return first + int(np.append(np.diff(away[first:]) < 0.0, False).argmin())
