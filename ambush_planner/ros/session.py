"""What the node does, apart from how it is wired: trip, plan, route, path, recording."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from threading import RLock

import numpy as np
import yaml
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path as PathMessage
from rclpy.clock import Clock
from rclpy.impl.rcutils_logger import RcutilsLogger
from std_msgs.msg import Header

from ..core.construction import chosen_spacing
from ..core.errors import InvalidOption
from ..core.planner import Plan, depart
from ..core.routes import densify
from ..recording import RecordedMessage, Recorder
from . import markers
from .conversions import path_to_ros
from .diagnostics import Status, status_to_ros
from .inputs import Inputs, Received, Trip, nearest_free_cell
from .outbox import Outbox
from .parameters import NodeParameters
from .planning import PlanCache, route_entropy_source


class Session:
    """One planner's run: its inputs, its plans and its departures.

    ``new_route``, ``get_plan`` and ``replan`` must not be called at the same time; everything
    else may be called meanwhile. They raise the planner's errors and leave the session usable.
    """

    def __init__(
        self,
        name: str,
        parameters: NodeParameters,
        outbox: Outbox,
        clock: Clock,
        logger: RcutilsLogger,
    ) -> None:
        self._name, self._outbox, self._clock, self._logger = name, outbox, clock, logger
        self._parameters = parameters
        self._inputs = Inputs(parameters.occupancy)
        self._plans = PlanCache()
        self._markers: list[RecordedMessage] = []
        self._recorder = _recorder(parameters)
        self._status = Status(missing=self._inputs.missing, recording=self._recording_state())
        self._status_lock = RLock()

    @property
    def solving(self) -> bool:
        """Whether a solve is running."""
        return self._status.solving

    def reconfigure(self, parameters: NodeParameters) -> None:
        """Use other parameters from the next request on."""
        if parameters.recording != self._parameters.recording:
            self._recorder = _recorder(parameters)
            state = self._recording_state()
            self._change(lambda s: replace(s.without_problem('recording'), recording=state))
        self._inputs.set_occupancy(parameters.occupancy)
        self._parameters = parameters

    def accept_map(self, received: Received) -> None:
        """Put a map in force; raises InvalidRiskMap if the last one stays."""
        self._inputs.accept_map(received)
        self._change(lambda s: replace(s.without_problem('map'), missing=self._inputs.missing))

    def set_start(self, received: Received, pose: PoseStamped) -> None:
        """Take a pose as the start of the trips to come."""
        self._inputs.set_start(received, pose)
        self._change(lambda s: replace(s, missing=self._inputs.missing))

    def set_goal(self, received: Received, pose: PoseStamped) -> None:
        """Take a pose as the goal of the trips to come."""
        self._inputs.set_goal(received, pose)
        self._change(lambda s: replace(s, missing=self._inputs.missing))

    def new_route(self) -> str:
        """Depart between the latest start and goal; return what to tell the caller."""
        self._depart(self._inputs.trip(), 'new_route')
        where = self._outbox.topic_name('path')
        failed = self._status.problems.get('recording')
        return f'departure {self._status.departures} is published on {where}' + (
            f'; {failed.message}' if failed else ''
        )

    def get_plan(self, start: Received, goal: Received, tolerance: float) -> PathMessage:
        """Depart between the poses of a request; a blocked goal may move by ``tolerance`` [m]."""
        if not tolerance >= 0.0:
            raise InvalidOption(f'tolerance must be >= 0 [m], got {tolerance}')
        trip = self._inputs.trip_between((start, start.message), (goal, goal.message))
        return self._depart(self._with_free_goal(trip, tolerance), 'get_plan')

    def replan(self) -> str:
        """Solve anew for the latest map, start and goal; return what to tell the caller."""
        plan = self._make_plan(self._inputs.trip(), self._parameters)
        self._change(lambda s: s.without_problem('request'))
        return (
            f'solved in {plan.seconds:.3f} s: value {plan.strategy.value:.6g}, gap '
            f'{plan.strategy.gap:.3g}, {len(plan.network.points)} nodes'
        )

    def fail(self, concern: str, error: Exception) -> None:
        """Tell what is wrong with the last request, or with the map that just came."""
        self._change(lambda s: s.with_problem(concern, error))

    def report(self) -> RecordedMessage:
        """Publish the diagnostics as they are."""
        # Under the lock, or an older status could go out after a newer one.
        with self._status_lock:
            stamp = self._clock.now().to_msg()
            return self._outbox.publish(
                '/diagnostics', status_to_ros(self._status, self._name, stamp)
            )

    def _depart(self, trip: Trip, service: str) -> PathMessage:
        begin, parameters = self._clock.now().nanoseconds, self._parameters
        plan = self._plan(trip, parameters)
        number = self._status.departures + 1
        source = route_entropy_source(parameters.seed, number)
        route = depart(plan, np.random.default_rng(source))
        spacing = _path_spacing(plan, parameters)
        path = path_to_ros(
            densify(route.points, spacing),
            trip.start_pose.pose,
            trip.goal_pose.pose,
            self._header(trip),
        )
        published = [
            self._outbox.publish('path', path),
            self._change(lambda s: replace(s.without_problem('request'), departures=number)),
        ]
        if (recorder := self._recorder) is not None:
            metadata = _metadata(parameters, service, number, source)
            self._record(recorder, trip, begin, published, metadata)
        return path

    def _plan(self, trip: Trip, parameters: NodeParameters) -> Plan:
        plan = self._plans.find(trip, parameters.planning)
        if plan is None:
            return self._make_plan(trip, parameters)
        if plan is not self._status.plan:
            self._show(plan, trip)
        return plan

    def _make_plan(self, trip: Trip, parameters: NodeParameters) -> Plan:
        self._change(lambda s: replace(s, solving=True))
        try:
            plan = self._plans.make(trip, parameters.planning)
        finally:
            self._change(lambda s: replace(s, solving=False))
        self._show(plan, trip)
        return plan

    def _show(self, plan: Plan, trip: Trip) -> None:
        """Publish the markers of the plan that is in force from now on."""
        header, strategy = self._header(trip), plan.strategy
        self._markers = [
            self._outbox.publish(topic, message)
            for topic, message in (
                ('network', markers.network_lines(plan.network, header)),
                ('edge_probabilities', markers.edge_probabilities(strategy, header)),
                ('mean_direction', markers.mean_direction(strategy, header)),
                ('ambush_sites', markers.ambush_sites(strategy, header)),
            )
        ]
        self._change(lambda s: replace(s, plan=plan))

    def _with_free_goal(self, trip: Trip, tolerance: float) -> Trip:
        if tolerance == 0.0:
            return trip
        clearance = self._parameters.planning.network.clearance
        xy = nearest_free_cell(trip.map.risk_map, trip.goal_xy, tolerance, clearance)
        if xy == trip.goal_xy:
            return trip
        pose = deepcopy(trip.goal_pose)
        pose.pose.position.x, pose.pose.position.y = xy
        return replace(trip, goal_pose=pose, goal_xy=xy)

    def _header(self, trip: Trip) -> Header:
        return Header(frame_id=trip.map.frame, stamp=self._clock.now().to_msg())

    def _record(
        self,
        recorder: Recorder,
        trip: Trip,
        begin: int,
        published: list[RecordedMessage | None],
        metadata: dict[str, str],
    ) -> None:
        """Record a departure; it has left already, so that nothing may fail it here."""
        inputs = [
            RecordedMessage(each.topic, each.message, each.qos, begin)
            for each in (trip.map.received, trip.start, trip.goal)
        ]
        shown = [replace(each, stamp_ns=max(begin, each.stamp_ns)) for each in self._markers]
        try:
            recorder.record_departure([*inputs, *shown, *filter(None, published)], metadata)
        except Exception as error:
            self._recording_failed(error)
        else:
            self._change(lambda s: replace(s.without_problem('recording'), recording='on'))

    def _recording_failed(self, error: Exception) -> None:
        self._logger.error(f'recording: {error}')
        self._change(lambda s: replace(s.with_problem('recording', error), recording='failed'))

    def _recording_state(self) -> str:
        return 'off' if self._recorder is None else 'on'

    def _change(self, change: Callable[[Status], Status]) -> RecordedMessage | None:
        """Change the status, and publish it if it is another one then."""
        with self._status_lock:
            before, self._status = self._status, change(self._status)
            return self.report() if self._status != before else None


def _recorder(parameters: NodeParameters) -> Recorder | None:
    options = parameters.recording
    return Recorder(Path(options.directory), options.compression) if options.enabled else None


def _path_spacing(plan: Plan, parameters: NodeParameters) -> float:
    if parameters.path_spacing > 0.0:
        return parameters.path_spacing
    nodes = chosen_spacing(plan.risk_map, parameters.planning.network)
    return max(plan.risk_map.resolution, nodes)


def _metadata(
    parameters: NodeParameters, service: str, departure: int, source: list[int]
) -> dict[str, str]:
    """What is needed to plan and draw the departure again; kept in the recording only."""
    try:
        planner_version = version('ambush_planner')
    except PackageNotFoundError:
        planner_version = 'not installed'
    return {
        'planner_version': planner_version,
        'service': service,
        'departure': str(departure),
        'parameters': yaml.safe_dump(dict(parameters.values)),
        'route_entropy_source': yaml.safe_dump(source, default_flow_style=True).strip(),
    }
