"""What has arrived: the risk map in force, the latest start and goal, and the trip they make."""

from __future__ import annotations

from dataclasses import dataclass

from geometry_msgs.msg import PoseStamped
from rclpy.serialization import serialize_message
from std_msgs.msg import Header

from ..errors import InvalidPose, InvalidRiskMap
from ..maps.ros_messages import position_from_ros
from ..planning.node_parameters import RobotOptions
from ..recordings import type_name
from .cdr import GridUpdate
from .conversions import pose_to_ros
from .current_map import CurrentMap, Received, changed_map, map_from
from .error_codes import NoGoal, NoMap, NoStart
from .qos import LATEST
from .transforms import FrameTransforms

# Each adds a leg, with a copy of the network.
MOST_STOPS = 50


@dataclass(frozen=True, eq=False)
class TripRequest:
    """From where to where somebody wants to go.

    ``start`` is None for where the robot is. The goal may be moved by ``goal_tolerance`` [m] where
    it is blocked. ``via`` are the stops on the way, if there are any.
    """

    start: Received | None
    goal: Received
    goal_tolerance: float = 0.0
    via: Received | None = None


@dataclass(frozen=True, eq=False)
class Trip:
    """What was asked for, on a map; poses and positions [m] in the map's frame."""

    map: CurrentMap
    start: Received
    goal: Received
    start_pose: PoseStamped
    goal_pose: PoseStamped
    start_xy: tuple[float, float]
    goal_xy: tuple[float, float]
    goal_tolerance: float = 0.0
    via: Received | None = None
    stops_xy: tuple[tuple[float, float], ...] = ()


class Inputs:
    """The latest map that is valid, and the latest poses as they came.

    A map is checked when it arrives, and a bad one leaves the last good one in force. A pose is
    checked when somebody departs, since only then its map is known; a bad one replaces the last
    one, so that nobody departs for a goal that has been given up. Where the start is the robot's
    pose, it is recorded as if it had come on ``start_topic``.
    """

    def __init__(self, transforms: FrameTransforms, start_topic: str) -> None:
        self._transforms, self._start_topic = transforms, start_topic
        self._map: CurrentMap | None = None
        self._refused: InvalidRiskMap | None = None
        self._start: Received | None = None
        self._goal: Received | None = None
        self._via: Received | None = None

    def accept_map(self, received: Received) -> CurrentMap:
        """Put a map in force and return it; one that equals the present one changes nothing.

        Raises
        ------
        InvalidRiskMap
            The map is malformed; the one before stays in force.
        """
        try:
            new = map_from(received)
        except InvalidRiskMap as error:
            self._refused = error
            raise
        return self._put_in_force(new)

    def update_map(self, update: GridUpdate) -> CurrentMap:
        """Change some cells of the map in force, and return the map that is in force then.

        Raises
        ------
        NoMap
            There is no map that could be changed.
        InvalidRiskMap
            The update does not fit the map; the map stays as it was.
        """
        return self._put_in_force(changed_map(self.current_map(), update))

    def set_start(self, received: Received) -> None:
        """Depart from here from now on."""
        self._start = received

    def set_goal(self, received: Received) -> None:
        """Drive there from now on."""
        self._goal = received

    def set_via(self, received: Received) -> None:
        """Drive by way of these poses from now on, in their order; an empty array clears them."""
        self._via = received if received.message.poses else None

    def missing(self, robot: RobotOptions) -> tuple[str, ...]:
        """What has not arrived yet, by the names of the topics."""
        parts = {
            'alpha_map': self._map is not None,
            'start_pose': self._start is not None or bool(robot.frame),
            'goal_pose': self._goal is not None,
        }
        return tuple(name for name, here in parts.items() if not here)

    def latest(self, robot: RobotOptions) -> TripRequest:
        """Return the trip between the latest start and goal, by the latest stops, as asked for.

        Raises
        ------
        NoMap, NoStart, NoGoal
            Something has not arrived.
        """
        self.current_map()
        if self._start is None and not robot.frame:
            raise NoStart(
                'no start yet: publish one on start_pose or initialpose, or set robot_base_frame'
            )
        if self._goal is None:
            raise NoGoal('no goal yet: publish one on goal_pose')
        return TripRequest(self._start, self._goal, via=self._via)

    def current_map(self) -> CurrentMap:
        """Return the map; raises NoMap as long as there is none."""
        if self._map is None:
            why = f'; the last one was refused: {self._refused}' if self._refused else ''
            raise NoMap(f'no risk map yet: publish one on alpha_map{why}')
        return self._map

    def locate(self, asked: TripRequest, robot: RobotOptions) -> Trip:
        """Return the trip on the map in force, with all poses where they are now.

        Raises
        ------
        NoMap
            There is no map.
        FrameMismatch, InvalidPose
            A pose cannot be brought into the map's frame, or its numbers are not a pose.
        """
        present = self.current_map()
        start, start_pose = self._start_of(asked.start, robot, present.frame)
        goal_pose = self._transforms.to_frame(
            asked.goal.message, 'goal', present.frame, robot.max_age
        )
        return Trip(
            map=present,
            start=start,
            goal=asked.goal,
            start_pose=start_pose,
            goal_pose=goal_pose,
            start_xy=position_from_ros(start_pose, 'start'),
            goal_xy=position_from_ros(goal_pose, 'goal'),
            goal_tolerance=asked.goal_tolerance,
            via=asked.via,
            stops_xy=self._stops_of(asked.via, present.frame, robot.max_age),
        )

    def _start_of(
        self, start: Received | None, robot: RobotOptions, frame: str
    ) -> tuple[Received, PoseStamped]:
        """Return the start as it is recorded, and its pose in the map's frame."""
        if start is not None and (start.message.header.frame_id or not robot.frame):
            return start, self._transforms.to_frame(start.message, 'start', frame, robot.max_age)
        here = PoseStamped(header=Header(frame_id=robot.frame), pose=pose_to_ros(0.0, 0.0))
        pose = self._transforms.to_frame(here, 'start', frame, robot.max_age)
        data = serialize_message(pose)
        return Received(self._start_topic, type_name(pose), pose, data, LATEST), pose

    def _stops_of(
        self, via: Received | None, frame: str, max_age: float
    ) -> tuple[tuple[float, float], ...]:
        """Positions of the stops [m] in the map's frame."""
        if via is None:
            return ()
        if len(via.message.poses) > MOST_STOPS:
            raise InvalidPose(
                f'via_poses: {len(via.message.poses)} stops, and {MOST_STOPS} are the most'
            )
        stops = []
        for number, pose in enumerate(via.message.poses, start=1):
            name = f'stop {number}'
            given = PoseStamped(header=via.message.header, pose=pose)
            moved = self._transforms.to_frame(given, name, frame, max_age)
            stops.append(position_from_ros(moved, name))
        return tuple(stops)

    def _put_in_force(self, new: CurrentMap) -> CurrentMap:
        present = self._map
        if present is None or not present.same_map(new):
            present = self._map = new
        self._refused = None
        return present
