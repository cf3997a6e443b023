"""What was published at a departure, asked and answered: made again, and compared field by field.

What is made again follows from the metadata, the strategy and the other messages; fields that
nothing recorded leads to are taken from the message itself.
"""

from __future__ import annotations

import array
import math
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from copy import deepcopy
from itertools import pairwise
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Pose, PoseStamped
from nav_msgs.msg import Path as PathMessage
from nav_msgs.srv import GetPlan
from rclpy.serialization import deserialize_message
from service_msgs.msg import ServiceEventInfo
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from ..game.strategy import Strategy
from ..planning.plan import DRAWN, Plan, Route, departure_path
from ..ros import markers
from ..ros.departure_path import path_between
from ..ros.departure_record import INPUTS_LEAD_NS
from ..ros.diagnostics import Status, status_to_ros
from ..ros.error_codes import OK_CODE
from . import type_name
from .recorded_case import Case
from .verify_plan import PROBABILITY_TOLERANCE
from .verify_trip import PosedTrip

# Of numbers in messages [m, or parts of a unit quaternion]: what rounding can make of them.
_TOLERANCE = 1e-9
_SERVICES = {type_name(Trigger): Trigger, type_name(GetPlan): GetPlan}
_EVENTS = tuple(each.Event for each in _SERVICES.values())
_DRAWN = {
    'network': lambda strategy, header: markers.network_lines(strategy.network, header),
    'edge_probabilities': markers.edge_probabilities,
    'mean_direction': markers.mean_direction,
    'ambush_sites': markers.ambush_sites,
    'stops': lambda strategy, header: markers.stops(strategy.network, header),
}
# What the diagnostics say beside the strategy and the departure.
_UNFORESEEN = {
    'state', 'code', 'message', 'recording', 'solve_seconds', 'current_value', 'current_gap',
    'stale', 'tight_turns', f'different_paths_of_{DRAWN}',
}
# The ambusher's sites, and what is worked out beside the strategy as long as there is time.
_TIMED = {'deciding_sites', 'deciding_sites_near_ends', 'secured_value'}


def kind_faults(case: Case) -> list[str]:
    """Check that there is each message that the node records, and no other."""
    topics = set(case.metadata.inputs.values())
    kinds = Counter(
        'service event' if each.type in map(type_name, _EVENTS) else each.type
        for each in case.recorded.messages if each.topic not in topics
    )
    expected = {
        type_name(MarkerArray): len(_DRAWN), type_name(DiagnosticArray): 1,
        'service event': 2 if case.parameters.recording.service_events else 0,
    }
    return [
        f'messages: there are {kinds[kind]} of the kind {kind[:60]!r}, not {expected.get(kind, 0)}'
        for kind in sorted({*kinds, *expected}) if kinds[kind] != expected.get(kind, 0)
    ]


def call_faults(case: Case) -> list[str]:
    """Make request and answer again, and the events of the call where they are recorded."""
    call, kind = case.metadata.call, _SERVICES.get(case.metadata.call.type)
    if kind is None:
        return [f'call: {call.type[:60]!r} is not a service of the planner']
    plan = ('plan',) if kind is GetPlan else ()
    try:
        request = message_of(kind.Request, call.request)
        response = message_of(kind.Response, call.response, but=plan)
    except ValueError as error:
        return [f'call: {error}']
    if plan:
        response.plan = case.message('path', PathMessage)
    faults = _unlike('request', request, _request(case, request))
    faults += _unlike('response', response, _response(case, response))
    if call.service.rpartition('/')[2] != case.metadata.service:
        faults.append('service: the recorded call is of another one')
    if kind is Trigger and case.metadata.trip.tolerance != 0.0:
        faults.append('trip: new_route has no tolerance')
    return faults + _event_faults(case, kind, request, response)


def _event_faults(case: Case, kind: Any, request: Any, response: Any) -> list[str]:
    call, number = case.metadata.call, case.metadata.number
    content = {
        ServiceEventInfo.REQUEST_RECEIVED: (call.request_ns, {'request': [request]}),
        ServiceEventInfo.RESPONSE_SENT: (call.response_ns, {'response': [response]}),
    }
    faults = []
    for message in case.of_type(*_EVENTS):
        event = case.decode(message)
        stamp_ns, parts = content.pop(event.info.event_type, (-1, {}))
        seconds, nanoseconds = divmod(message.stamp_ns, 1_000_000_000)
        info = ServiceEventInfo(
            event_type=event.info.event_type, sequence_number=number,
            stamp=Time(sec=seconds, nanosec=nanoseconds),
        )
        if stamp_ns != message.stamp_ns or message.topic != f'{call.service}/_service_event':
            faults.append('service event: it is not of the recorded call')
        faults += _unlike('service event', event, kind.Event(info=info, **parts))
    return faults


def time_faults(case: Case) -> list[str]:
    """Check that the request came first, the answer last, and that the path left in between.

    Nodes record it so even where the clock stands still or is set back on the way. That the times
    are right is shown by nothing in a recording.
    """
    begin, end = case.metadata.call.request_ns, case.metadata.call.response_ns
    inputs = [case.recorded.recorded(role) for role in case.metadata.inputs if role != 'path']
    others = [each for each in case.recorded.messages if each not in inputs]
    faults = []
    if not all(begin <= each.stamp_ns <= end for each in others):
        faults.append('times: a message is from before the request or after the answer')
    if any(each.stamp_ns != max(0, begin - INPUTS_LEAD_NS) for each in inputs):
        faults.append('times: map and poses are not from half a second before the request')
    stamp = case.message('path').header.stamp
    if not begin <= stamp.sec * 1_000_000_000 + stamp.nanosec <= end:
        faults.append('times: the path is stamped before the request or after the answer')
    return faults


def marker_faults(case: Case, strategy: Strategy) -> list[str]:
    """Draw the recorded strategy again, and compare the markers."""
    shown, faults = {}, []
    for message in case.of_type(MarkerArray):
        if (each := case.decode(message)).markers:
            name = each.markers[0].ns
            shown[name] = each
            # A topic may have been remapped, but not to another one's name.
            if (topic := message.topic.rpartition('/')[2]) != name and topic in _DRAWN:
                faults.append(f'markers: those of {name[:60]!r} are on the topic of {topic}')
    for name, draw in _DRAWN.items():
        if name not in shown:
            faults.append(f'markers: {name} is missing')
            continue
        header = shown[name].markers[0].header
        again = deserialize_message(draw(strategy, header), MarkerArray)
        if header.frame_id != case.metadata.frame or difference(shown[name], again) is not None:
            faults.append(f'markers: {name} does not show the recorded strategy')
    return faults


def path_faults(case: Case, plan: Plan, trip: PosedTrip) -> list[str]:
    """Make the path of the recorded route again, and compare it pose for pose.

    ``plan`` has the recorded strategy and its network; where ``trip`` has no start or no goal pose,
    what the path has instead is believed.
    """
    path, nodes = case.message('path'), np.array(case.metadata.route)
    edges = set(map(tuple, plan.network.edges.tolist()))
    if not path.poses or not edges.issuperset(pairwise(case.metadata.route)):
        return ['route: it leaves the network']
    (begin, end), first, last = case.metadata.ends, path.poses[0].pose, path.poses[-1].pose
    spacing = case.parameters.path_spacing or plan.spacing
    rows = departure_path(plan, Route(nodes, plan.network.points[nodes]), spacing, (begin, end))
    again = path_between(rows, trip.start or _at(first, begin), trip.goal or last, path.header)
    return _unlike('path', path, again.to_message())


def status_faults(case: Case, plan: Plan, hurried: bool) -> list[str]:
    """Compare the recorded diagnostics with the departure and with the plan.

    ``hurried``: what could be found with more time is not looked at.
    """
    found = _status(case)
    if found is None:
        return ['diagnostics: there is not one status']
    status = Status(plan=plan, departures=case.metadata.number, departure_id=case.metadata.id)
    again = status_to_ros(status, '', Time()).status[0]
    told = {each.key: each.value for each in found.values}
    faults = []
    if [each.key for each in found.values] != [each.key for each in again.values]:
        faults.append('diagnostics: there are not the values that the node reports')
    if found.hardware_id:
        faults.append('diagnostics: the node reports no hardware')
    failing = found.level in (DiagnosticStatus.ERROR, DiagnosticStatus.STALE)
    warns = found.level != DiagnosticStatus.OK
    if found.message != told.get('message') or failing != (told.get('code') != OK_CODE) or (
        warns != (found.message != told.get('state'))
    ):
        faults.append('diagnostics: level, code and message do not agree')
    believed = _UNFORESEEN | _TIMED if hurried else _UNFORESEEN
    tolerance = PROBABILITY_TOLERANCE * plan.strategy.value
    return faults + [
        f'diagnostics: {each.key} is not that of the departure'
        for each in again.values
        if each.key not in believed and not _same_text(told.get(each.key), each.value, tolerance)
    ]


def solve_seconds(case: Case) -> float:
    """How long the diagnostics say that the solve took [s]; nan where they do not."""
    with suppress(StopIteration, ValueError):
        values = getattr(_status(case), 'values', ())
        return float(next(each.value for each in values if each.key == 'solve_seconds'))
    return math.nan


def difference(one: Any, other: Any, place: str = '') -> str | None:
    """Return the first field in which messages differ beyond rounding; None: in none."""
    if type(one) is not type(other):
        return place
    if isinstance(one, np.ndarray):
        return None if np.array_equal(one, other) else place
    if one == other or (isinstance(one, float) and abs(one - other) <= _TOLERANCE):
        return None
    if isinstance(one, (list, array.array)):
        if len(one) != len(other):
            return f'{place}.length'
        parts = [(f'[{k}]', *pair) for k, pair in enumerate(zip(one, other, strict=True))]
    else:
        names = getattr(one, 'get_fields_and_field_types', dict)()
        parts = [(f'.{name}', getattr(one, name), getattr(other, name)) for name in names]
    found = (difference(a, b, place + name) for name, a, b in parts)
    return next((each for each in found if each is not None), None) if parts else place


def _unlike(name: str, one: Any, other: Any) -> list[str]:
    """Name the first field of a message that is not as it has been made again; never its value."""
    place = difference(one, other)
    if place is None:
        return []
    field = place.removeprefix(f'.{name}[0]').lstrip('.') or 'type'
    return [f'{name}: its {field} is not what follows from the rest']


def _request(case: Case, asked: Any) -> Any:
    """What was asked for; ``asked`` may leave the start to where the robot is."""
    if isinstance(asked, Trigger.Request):
        return asked
    from_robot = case.parameters.robot.frame and not asked.start.header.frame_id
    start = asked.start if from_robot else case.message('start')
    return GetPlan.Request(
        start=start if isinstance(start, PoseStamped) else PoseStamped(),
        goal=case.message('goal', PoseStamped), tolerance=case.metadata.trip.tolerance,
    )


def _response(case: Case, answered: Any) -> Any:
    """What was answered; only what ``answered`` says of trouble with recordings is believed."""
    metadata = case.metadata
    if isinstance(answered, GetPlan.Response):
        return GetPlan.Response(plan=case.message('path', PathMessage))
    told = f'departure {metadata.number} ({metadata.id}) is published on {metadata.inputs["path"]}'
    trouble = answered.message.removeprefix(told)
    status = _status(case)
    failed = status and any((v.key, v.value) == ('recording', 'failed') for v in status.values)
    # Trouble with a map stands before it in the diagnostics.
    is_told = failed and trouble.startswith('; ') and f'; {status.message}'.endswith(trouble)
    return Trigger.Response(success=True, message=told + (trouble if is_told else ''))


def _status(case: Case) -> DiagnosticStatus | None:
    """The only status of the only diagnostics, if there is just one."""
    found = [status for each in case.of_type(DiagnosticArray)
             for status in case.decode(each).status]
    return found[0] if len(found) == 1 else None


def _at(pose: Pose, xy: tuple[float, float]) -> Pose:
    moved = deepcopy(pose)
    moved.position.x, moved.position.y = xy
    return moved


def _same_text(told: str | None, expected: str, tolerance: float) -> bool:
    """Whether the diagnostics tell the expected; numbers are the same up to a tolerance."""
    if told == expected:
        return True
    try:
        one, other = float(told or ''), float(expected)
    except ValueError:
        return False
    return math.isclose(one, other, rel_tol=PROBABILITY_TOLERANCE, abs_tol=tolerance)


def message_of(kind: Any, fields: Mapping[str, Any], but: tuple[str, ...] = ()) -> Any:
    """Return the message with these fields: the inverse of ``fields_of``.

    Raises
    ------
    ValueError
        They are not those of the message, or have other types.
    """
    message = kind()
    if set(fields) != set(message.get_fields_and_field_types()) - set(but):
        raise ValueError(f'they are not the fields of a {kind.__name__}')
    for name, value in fields.items():
        default = getattr(message, name)
        if hasattr(default, 'get_fields_and_field_types') and isinstance(value, dict):
            value = message_of(type(default), value)
        if type(value) is not type(default):
            raise ValueError(f'{name} is not a {type(default).__name__}')
        try:
            setattr(message, name, value)
        except AssertionError as error:
            raise ValueError(f'{name} is out of its range') from error
    return message
