"""What has arrived: the current map, the latest poses, and the trip that they make."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from geometry_msgs.msg import PoseStamped
from std_msgs.msg import Header

from ..errors import InvalidPose, InvalidRiskMap
from ..maps.ros_messages import pose_from_ros, position_from_ros
from ..planning.node_parameters import RobotOptions
from ..recordings import type_name
from .conversions import pose_to_ros
from .current_map import CurrentMap, ReceivedMessage, joined_map, map_from, updated_map
from .error_codes import NoGoal, NoMap, NoStart
from .parameter_changes import NodeSettings
from .qos import LATEST
from .transforms import FrameTransforms

# Maximum number of stops on a trip: each adds a leg, with a copy of the network.
MOST_STOPS = 50


@dataclass(frozen=True, eq=False)
class TripRequest:
    """Where somebody wants to go, in any frames, via some stops.

    Without a start it is the robot's pose at departure. A blocked goal may be moved by
    ``goal_tolerance`` [m].
    """

    start: ReceivedMessage | None
    goal: ReceivedMessage
    goal_tolerance: float = 0.0
    via: ReceivedMessage | None = None

    def leads_to(self, other: TripRequest) -> bool:
        """Whether two requests have the same goal and stops."""
        one, two = self.goal.message, other.goal.message
        stops = [each.via.message.poses if each.via else [] for each in (self, other)]
        return (one.header.frame_id == two.header.frame_id and one.pose == two.pose
                and stops[0] == stops[1])


@dataclass(frozen=True, eq=False)
class Trip:
    """A trip request located on a map; poses and positions [m] are in the map's frame.

    The start ``moves`` if it was given in another frame, such as the robot's.
    """

    map: CurrentMap
    start: ReceivedMessage
    goal: ReceivedMessage
    start_pose: PoseStamped
    goal_pose: PoseStamped
    start_xy: tuple[float, float]
    goal_xy: tuple[float, float]
    goal_tolerance: float = 0.0
    via: ReceivedMessage | None = None
    stops_xy: tuple[tuple[float, float], ...] = ()
    moves: bool = False


class Inputs:
    """The latest valid map, and the latest poses as they arrived.

    A map is checked on arrival, and a malformed one leaves the previous map current. A pose is
    checked at departure, when its map is known; a bad pose replaces the previous one, so that
    nobody departs for a goal that has been given up. If a trip starts at the robot, its pose is
    recorded as if it had arrived on ``start_topic``.

    Attributes
    ----------
    start, goal, via
        Where later departures begin and lead, and their stops in order; None: not given.
    """

    def __init__(self, transforms: FrameTransforms, start_topic: str,
                 settings: NodeSettings) -> None:
        self._transforms, self._start_topic = transforms, start_topic
        self._settings = settings
        self._arrived: dict[str, CurrentMap | None] = {'alpha_map': None}
        if settings.current.values['map.costmap']:
            self._arrived['costmap'] = None
        self.start: ReceivedMessage | None = None
        self.goal: ReceivedMessage | None = None
        self.via: ReceivedMessage | None = None
        self._map: CurrentMap | None = None
        self._refused: InvalidRiskMap | None = None

    def accept_map(self, received: ReceivedMessage, topic: str = 'alpha_map') -> None:
        """Make a map the current one; an equal map changes nothing.

        Raises InvalidRiskMap if the map is malformed, and FrameMismatch if a costmap cannot be
        transformed into the risk map's frame; the previous one stays.
        """
        try:
            new = map_from(received)
        except InvalidRiskMap as error:
            self._refused = error
            raise
        self._arrived[topic] = new
        self.join_maps()

    def update_map(self, update: Any, topic: str = 'alpha_map') -> None:
        """Change the cells that a map_msgs/OccupancyGridUpdate gives.

        Raises as ``accept_map``; also NoMap if no map has arrived, and InvalidRiskMap if the update
        does not fit the map, which stays as it was.
        """
        if (present := self._arrived[topic]) is None:
            raise self._no_map()
        self._arrived[topic] = updated_map(present, update)
        self.join_maps()

    def join_maps(self) -> None:
        """Make the risk map, with the costmap's obstacles if there is one, the current map.

        Raises FrameMismatch if the costmap cannot be transformed into the risk map's frame.
        """
        new, costmap = self._arrived['alpha_map'], self._arrived.get('costmap')
        if new is None or 'costmap' in self._arrived and costmap is None:
            return
        if costmap is not None:
            options, (x, y, yaw) = self._settings.current, costmap.origin
            origin = PoseStamped(header=Header(frame_id=costmap.frame), pose=pose_to_ros(x, y, yaw))
            there = self._transforms.to_frame(origin, 'the costmap', new.frame,
                                              options.robot.max_age)
            costmap = replace(costmap, origin=pose_from_ros(there.pose))
            new = joined_map(new, costmap, options.occupancy.unknown_alpha < 0.0)
        if self._map is None or not self._map.same_map(new):
            self._map = new
        self._refused = None

    @property
    def map_topics(self) -> tuple[str, ...]:
        """The topics of the maps."""
        return tuple(self._arrived)

    @property
    def missing_maps(self) -> bool:
        """Whether a map has not arrived."""
        return None in self._arrived.values()

    @property
    def has_map(self) -> bool:
        """Whether there is a current map."""
        return self._map is not None

    def missing(self, robot: RobotOptions) -> tuple[str, ...]:
        """Return the topics of the inputs that have not arrived."""
        inputs = {**self._arrived, 'start_pose': self.start or robot.frame,
                  'goal_pose': self.goal}
        return tuple(name for name, given in inputs.items() if not given)

    def latest(self, robot: RobotOptions) -> TripRequest:
        """Return the trip from the latest start to the latest goal via the latest stops.

        Raises NoMap, NoStart or NoGoal if an input has not arrived.
        """
        self.current_map()
        if self.start is None and not robot.frame:
            raise NoStart(
                'no start yet: publish one on start_pose or initialpose, or set robot_base_frame'
            )
        if self.goal is None:
            raise NoGoal('no goal yet: publish one on goal_pose')
        return TripRequest(self.start, self.goal, via=self.via)

    def current_map(self) -> CurrentMap:
        """Return the current map; raises NoMap if no map has arrived."""
        if self._map is None:
            raise self._no_map()
        return self._map

    def _no_map(self) -> NoMap:
        if self._refused:
            why = f'; the last one was refused: {self._refused}'
        elif self._arrived['alpha_map'] is not None:
            return NoMap('no costmap yet, or none that TF brings to the risk map: publish one on '
                         'costmap, or set map.costmap to false')
        else:
            why = ''
        return NoMap(f'no risk map yet: publish one on alpha_map{why}')

    def locate(self, request: TripRequest, robot: RobotOptions) -> Trip:
        """Locate a trip on the current map, by the transforms of this moment.

        Raises NoMap if no map has arrived, and FrameMismatch or InvalidPose if a pose cannot be
        transformed into the map's frame or is not a valid pose.
        """
        present = self.current_map()
        start, start_pose = self._located_start(request.start, robot, present.frame)
        goal_pose = self._transforms.to_frame(
            request.goal.message, 'goal', present.frame, robot.max_age
        )
        at_robot = start is not request.start
        return Trip(map=present, start=start, goal=request.goal, start_pose=start_pose,
                    goal_pose=goal_pose, start_xy=position_from_ros(start_pose, 'start'),
                    goal_xy=position_from_ros(goal_pose, 'goal'),
                    goal_tolerance=request.goal_tolerance, via=request.via,
                    stops_xy=self._located_stops(request.via, present.frame, robot.max_age),
                    moves=at_robot or start.message.header.frame_id != present.frame)

    def _located_start(self, start: ReceivedMessage | None, robot: RobotOptions,
                       frame: str) -> tuple[ReceivedMessage, PoseStamped]:
        """Return the start to record, and its pose in the map's frame."""
        if start is not None and (start.message.header.frame_id or not robot.frame):
            return start, self._transforms.to_frame(start.message, 'start', frame, robot.max_age)
        pose = self._transforms.to_frame(robot_pose(robot), 'start', frame, robot.max_age)
        return ReceivedMessage(self._start_topic, type_name(pose), pose, LATEST), pose

    def _located_stops(self, via: ReceivedMessage | None, frame: str,
                       max_age: float) -> tuple[tuple[float, float], ...]:
        """Return the positions of the stops [m] in the map's frame."""
        if via is None:
            return ()
        if len(via.message.poses) > MOST_STOPS:
            raise InvalidPose(
                f'via_poses: {len(via.message.poses)} stops, but at most {MOST_STOPS} are allowed'
            )
        stops = {f'stop {number}': PoseStamped(header=via.message.header, pose=pose)
                 for number, pose in enumerate(via.message.poses, start=1)}
        return tuple(position_from_ros(self._transforms.to_frame(given, name, frame, max_age), name)
                     for name, given in stops.items())


def robot_pose(robot: RobotOptions) -> PoseStamped | None:
    """Return the pose of the robot, in its own frame; None if that has no name."""
    if not robot.frame:
        return None
    return PoseStamped(header=Header(frame_id=robot.frame), pose=pose_to_ros(0.0, 0.0))
