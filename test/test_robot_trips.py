# SPDX-License-Identifier: Apache-2.0
"""Which trips are under way when departures do not leave."""

from concurrent.futures import Future
from types import SimpleNamespace

import pytest
from geometry_msgs.msg import PoseArray
from ros_harness import GOAL, header, pose

from ambush_planner.ros.current_map import ReceivedMessage
from ambush_planner.ros.departures import RobotTrip, RobotTrips
from ambush_planner.ros.trip import TripRequest

FRAMES = ('map', 'robot')
ASKED = SimpleNamespace(destination=SimpleNamespace(frames=FRAMES), start_xy=(0.0, 0.0),
                        request=SimpleNamespace(goal_tolerance=0.0))


def trip(before=None, goal=(1.0, 1.0)):
    track = SimpleNamespace(destination=SimpleNamespace(frames=FRAMES, goal=goal), arrived=False,
                            continues=lambda *_: True, drive_on=lambda _: None)
    return RobotTrip(track, None, None, None, Future(), True, before)


def test_requests_with_stops_in_different_frames_lead_elsewhere():
    def through(frame):
        stops = PoseArray(header=header(frame), poses=[pose(3.0, 8.0).pose])
        goal, via = (ReceivedMessage('', '', each, None) for each in (GOAL, stops))
        return TripRequest(None, None, goal, via=via)

    assert through('map').leads_to(through('map'))
    assert not through('map').leads_to(through('odom'))


@pytest.mark.parametrize('fails', [False, True])
def test_a_robot_whose_diversion_does_not_leave_is_on_its_trip_as_before(fails):
    trips, first = RobotTrips(None, None), trip()
    first.left.set_result(None)
    diversion = trip(first)
    trips.add(first)
    trips.add(diversion)
    assert trips.continued_by(ASKED) is diversion, 'it may be on the disk in a moment'
    if fails:
        diversion.left.set_exception(OSError())
    else:
        diversion.left.set_result(None)
    assert trips.continued_by(ASKED) is (first if fails else diversion)
    assert diversion.before is None


def test_a_departure_that_does_not_leave_is_not_under_way():
    trips, first = RobotTrips(None, None), trip()
    trips.add(first)
    first.left.set_exception(OSError())
    assert trips.continued_by(ASKED) is None
