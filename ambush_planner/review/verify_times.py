"""The order of a departure's times. That they are right is shown by nothing in a recording."""

from __future__ import annotations

from nav_msgs.srv import GetPlan
from rclpy.time import Time
from service_msgs.msg import ServiceEventInfo
from std_srvs.srv import Trigger

from ..recording.departure import RecordedDeparture
from ..recording.messages import type_name

_EVENTS = (type_name(Trigger.Event), type_name(GetPlan.Event))
_INPUTS = ('map', 'start', 'goal')


def time_faults(recorded: RecordedDeparture) -> list[str]:
    """Check that the request came first, the answer last, and that the path left in between.

    Nodes record it so even where the clock stands still or is set back on the way.
    """
    calls = {
        recorded.decode(each).info.event_type: each.stamp_ns
        for each in recorded.messages if each.type in _EVENTS
    }
    begin = calls.get(ServiceEventInfo.REQUEST_RECEIVED)
    end = calls.get(ServiceEventInfo.RESPONSE_SENT)
    if begin is None or end is None:
        return []  # that it is missing is found elsewhere
    faults = []
    if not all(begin <= each.stamp_ns <= end for each in recorded.messages):
        faults.append('times: a message is from before the request or after the answer')
    if any(recorded.recorded(role).stamp_ns != begin for role in _INPUTS):
        faults.append('times: map, start and goal are not from when the request came')
    leaving = Time.from_msg(recorded.message('path').header.stamp).nanoseconds
    if not begin <= leaving <= end:
        faults.append('times: the path is stamped before the request or after the answer')
    return faults
