"""What was published at a departure and what was answered, compared with what has to be in it."""

from __future__ import annotations

import array
import math
from collections import Counter
from contextlib import suppress
from copy import deepcopy
from itertools import pairwise
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Pose
from nav_msgs.msg import Path as PathMessage
from nav_msgs.srv import GetPlan
from rclpy.serialization import deserialize_message
from service_msgs.msg import ServiceEventInfo
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from ..core.planner import Plan, Route, departure_path
from ..core.strategy import Strategy
from ..recording import type_name
from ..ros import markers
from ..ros.diagnostics import Status, status_to_ros
from ..ros.errors import OK_CODE
from ..ros.paths import path_between
from .case import Case
from .verify_strategy import PROBABILITY_TOLERANCE
from .verify_trip import PosedTrip

# Of numbers in messages [m, or parts of a unit quaternion]: what rounding can make of them.
_TOLERANCE = 1e-9
_MARKERS, _DIAGNOSTICS = type_name(MarkerArray), type_name(DiagnosticArray)
_SHOWN = ('network', 'edge_probabilities', 'mean_direction', 'ambush_sites', 'stops')
_EVENTS = {type_name(kind.Event): kind for kind in (Trigger, GetPlan)}
# What the diagnostics say beside the strategy and the departure.
_UNFORESEEN = (
    'state', 'code', 'message', 'recording', 'solve_seconds', 'current_value', 'current_gap',
    'stale',
)
# The ambusher's sites, and what is worked out beside the strategy as long as there is time.
_TIMED = ('deciding_sites', 'deciding_sites_near_ends', 'secured_value')


def message_faults(case: Case) -> list[str]:
    """Check that there is each message that the node records, and no other."""
    recorded, topics = case.recorded, set(case.metadata.inputs.values())
    kinds = Counter(
        'service event' if each.type in _EVENTS else each.type
        for each in recorded.messages
        if each.topic not in topics
    )
    expected = {_MARKERS: len(_SHOWN), _DIAGNOSTICS: 1, 'service event': 2}
    faults = [
        f'messages: there are {kinds[kind]} of the kind {kind}, not {count}'
        for kind, count in expected.items()
        if kinds[kind] != count
    ]
    others = sum(kinds.values()) - sum(kinds[kind] for kind in expected)
    return [*faults, f'messages: {others} are of kinds that are not recorded'] if others else faults


def path_faults(case: Case, plan: Plan, trip: PosedTrip) -> list[str]:
    """Make the path of the recorded route again, and compare it pose for pose.

    Parameters
    ----------
    case
        The departure.
    plan
        What it was planned with; its network has the route's nodes.
    trip
        Start and goal pose; where one is not known, what the path has instead is believed.
    """
    path, nodes = case.message('path'), np.array(case.metadata.route)
    edges = set(map(tuple, plan.network.edges.tolist()))
    if not path.poses or not edges.issuperset(pairwise(case.metadata.route)):
        return ['route: it leaves the network']
    (begin, end), first, last = case.metadata.ends, path.poses[0].pose, path.poses[-1].pose
    spacing = case.parameters.path_spacing or plan.spacing
    route = Route(nodes, plan.network.points[nodes])
    rows = departure_path(plan, route, spacing, (begin, end))
    again = path_between(rows, trip.start or _at(first, begin), trip.goal or last, path.header)
    return _differences(path, again.to_message())


def service_faults(case: Case) -> list[str]:
    """Compare the recorded call, its request and its response, with the departure."""
    messages = case.of_type(Trigger.Event, GetPlan.Event)
    faults = []
    events = {}
    for message in messages:
        event = case.decode(message)
        if message.topic.split('/')[-2:] != [case.metadata.service, '_service_event']:
            faults.append('service: the recorded call is of another one')
        if event.info.sequence_number != case.metadata.number:
            faults.append('departure: its number is not that of the recorded call')
        if _nanoseconds(event.info.stamp) != message.stamp_ns:
            faults.append('service: the recorded call was at another time')
        events[event.info.event_type] = _EVENTS[message.type], event
    kind, asked = events.get(ServiceEventInfo.REQUEST_RECEIVED, (None, None))
    if asked is None or len(asked.request) != 1 or asked.response:
        return [*faults, 'request: it is missing']
    answering, answered = events.get(ServiceEventInfo.RESPONSE_SENT, (None, None))
    if answering is not kind or len(answered.response) != 1 or answered.request:
        return [*faults, 'response: it is missing']
    check = _trigger_faults if kind is Trigger else _get_plan_faults
    return [*faults, *check(case, asked.request[0], answered.response[0])]


def solve_seconds(case: Case) -> float:
    """How long the diagnostics say that the solve took [s]; nan where they do not."""
    for each in case.of_type(DiagnosticArray):
        for status in case.decode(each).status:
            for value in status.values:
                if value.key == 'solve_seconds':
                    with suppress(ValueError):
                        return float(value.value)
    return math.nan


def status_faults(case: Case, plan: Plan, hurried: bool) -> list[str]:
    """Compare the recorded diagnostics with the departure and with the plan.

    ``hurried``: what could be found with more time is not looked at.
    """
    unforeseen = (*_UNFORESEEN, *_TIMED) if hurried else _UNFORESEEN
    messages = [case.decode(each) for each in case.of_type(DiagnosticArray)]
    if len(messages) != 1 or len(messages[0].status) != 1:
        return ['diagnostics: there is not one status']
    shown = messages[0].status[0]
    told = {each.key: each.value for each in shown.values}
    status = Status(plan=plan, departures=case.metadata.number, departure_id=case.metadata.id)
    tolerance = PROBABILITY_TOLERANCE * plan.strategy.value
    failing = shown.level in (DiagnosticStatus.ERROR, DiagnosticStatus.STALE)
    again = status_to_ros(status, '', Time()).status[0]
    faults = []
    if [each.key for each in shown.values] != [each.key for each in again.values]:
        faults.append('diagnostics: there are not the values that the node reports')
    if shown.hardware_id:
        faults.append('diagnostics: the node reports no hardware')
    if failing != (told.get('code') != OK_CODE) or shown.message != told.get('message'):
        faults.append('diagnostics: level, code and message do not agree')
    return faults + [
        f'diagnostics: {each.key} is not that of the departure'
        for each in again.values
        if each.key not in unforeseen
        and not _same_text(told.get(each.key), each.value, tolerance)
    ]


def marker_faults(case: Case, strategy: Strategy) -> list[str]:
    """Draw the recorded strategy again, and compare the markers."""
    shown, faults = {}, []
    for message in case.of_type(MarkerArray):
        if (each := case.decode(message)).markers:
            name = each.markers[0].ns
            shown[name] = each
            # A topic may have been remapped, but not to another one's name.
            if (topic := message.topic.rpartition('/')[2]) != name and topic in _SHOWN:
                faults.append(f'markers: those of {name[:60]!r} are on the topic of {topic}')
    for name, content, draw in (
        ('network', strategy.network, markers.network_lines),
        ('edge_probabilities', strategy, markers.edge_probabilities),
        ('mean_direction', strategy, markers.mean_direction),
        ('ambush_sites', strategy, markers.ambush_sites),
        ('stops', strategy.network, markers.stops),
    ):
        if name not in shown:
            faults.append(f'markers: {name} is missing')
            continue
        header = shown[name].markers[0].header
        again = deserialize_message(draw(content, header), MarkerArray)
        if header.frame_id != case.metadata.frame or not same(shown[name], again):
            faults.append(f'markers: {name} does not show the recorded strategy')
    return faults


def time_faults(case: Case) -> list[str]:
    """Check that the request came first, the answer last, and that the path left in between.

    Nodes record it so even where the clock stands still or is set back on the way. That the times
    are right is shown by nothing in a recording.
    """
    calls = {
        case.decode(each).info.event_type: each.stamp_ns
        for each in case.of_type(Trigger.Event, GetPlan.Event)
    }
    begin = calls.get(ServiceEventInfo.REQUEST_RECEIVED)
    end = calls.get(ServiceEventInfo.RESPONSE_SENT)
    if begin is None or end is None:
        return []  # that it is missing is found elsewhere
    faults = []
    if not all(begin <= each.stamp_ns <= end for each in case.recorded.messages):
        faults.append('times: a message is from before the request or after the answer')
    inputs = [role for role in case.metadata.roles if role != 'path']
    if any(case.recorded.recorded(role).stamp_ns != begin for role in inputs):
        faults.append('times: map, start, stops and goal are not from when the request came')
    if not begin <= _nanoseconds(case.message('path').header.stamp) <= end:
        faults.append('times: the path is stamped before the request or after the answer')
    return faults


def same(one: Any, other: Any) -> bool:
    """Whether messages, or fields of them, are the same up to the rounding of numbers."""
    if type(one) is not type(other):
        return False
    if isinstance(one, np.ndarray):
        return np.array_equal(one, other)
    if one == other:
        return True
    if isinstance(one, float):
        return abs(one - other) <= _TOLERANCE
    if isinstance(one, (list, array.array)):
        return len(one) == len(other) and all(map(same, one, other))
    names = getattr(one, 'get_fields_and_field_types', dict)()
    return bool(names) and all(same(getattr(one, n), getattr(other, n)) for n in names)


def _trigger_faults(case: Case, request: Any, response: Any) -> list[str]:
    metadata = case.metadata
    topic = metadata.inputs['path']
    told = f'departure {metadata.number} ({metadata.id}) is published on {topic}'
    faults = []
    if metadata.trip.tolerance != 0.0:
        faults.append('trip: new_route has no tolerance')
    trouble = response.message.removeprefix(told)
    is_told = response.message.startswith(told) and _is_reported(case, trouble)
    if not response.success or not is_told:
        faults.append('response: it does not tell this departure_id, departure and topic')
    return faults


def _is_reported(case: Case, trouble: str) -> bool:
    """Whether an answer's text about a recording that failed is that of the diagnostics, if any."""
    for message in case.of_type(DiagnosticArray):
        if statuses := case.decode(message).status:
            values = {each.key: each.value for each in statuses[0].values}
            if values.get('recording') == 'failed':
                # Trouble with a map stands before it.
                return trouble.startswith('; ') and f'; {statuses[0].message}'.endswith(trouble)
    return not trouble


def _get_plan_faults(case: Case, request: Any, response: Any) -> list[str]:
    faults = [
        f'request: its {role} is not the recorded {role} pose'
        for role in ('start', 'goal')
        if not (role == 'start' and _from_the_robot(case, request))
        and not same(getattr(request, role), case.message(role))
    ]
    if request.tolerance != case.metadata.trip.tolerance:
        faults.append("trip: its tolerance is not the request's")
    if not same(response.plan, case.message('path')):
        faults.append('response: its plan is not the recorded path')
    return faults


def _from_the_robot(case: Case, request: Any) -> bool:
    """Whether the request leaves the start to where the robot is."""
    return bool(case.parameters.robot_base_frame) and not request.start.header.frame_id


def _differences(path: PathMessage, again: PathMessage) -> list[str]:
    count = len(again.poses)
    if len(path.poses) != count:
        return [f'path: it has {len(path.poses)} poses, the recorded route gives {count}']
    for k, (one, other) in enumerate(zip(path.poses, again.poses, strict=True), start=1):
        if not same(one, other):
            name = {1: 'its first pose', count: 'its last pose'}.get(k, f'pose {k} of {count}')
            return [f'path: {name} is not what start, route and goal give']
    return []


def _at(pose: Pose, xy: tuple[float, float]) -> Pose:
    moved = deepcopy(pose)
    moved.position.x, moved.position.y = xy
    return moved


def _nanoseconds(stamp: Time) -> int:
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def _same_text(told: str | None, expected: str, tolerance: float) -> bool:
    """Whether the diagnostics tell the expected; numbers are the same up to a tolerance."""
    if told == expected:
        return True
    try:
        one, other = float(told or ''), float(expected)
    except ValueError:
        return False
    return math.isclose(one, other, rel_tol=PROBABILITY_TOLERANCE, abs_tol=tolerance)
