# SPDX-License-Identifier: Apache-2.0
"""Which trips are under way, and when they are over."""

from types import SimpleNamespace

import pytest
from geometry_msgs.msg import PoseArray
from ros_harness import GOAL, header, pose

from ambush_planner.ros.robot_trips import RobotTrip, RobotTrips
from ambush_planner.ros.trip import TripRequest

FRAMES = ('map', 'robot')
DAY = 86400.0


def asked(stamp=0.0, frames=FRAMES):
    return SimpleNamespace(destination=SimpleNamespace(frames=frames), start_xy=(0.0, 0.0),
                           request=SimpleNamespace(goal_tolerance=0.0), stamp=stamp)


def trip(goal=(1.0, 1.0), frames=FRAMES):
    track = SimpleNamespace(destination=SimpleNamespace(frames=frames, goal=goal), arrived=False,
                            progress=0.0, tolerance=0.5,
                            continues=lambda *_: True, drive_on=lambda _: None)
    wish = SimpleNamespace(parameters=SimpleNamespace(values={'trip.max_idle': 600.0}))
    return RobotTrip(track, wish, 'id', 1, 0, None, None, None, (0.0, 0.0))


class Clock:
    now = 0.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def trips(clock):
    return RobotTrips(None, clock)


def test_requests_with_stops_in_different_frames_lead_elsewhere():
    def through(frame):
        stops = PoseArray(header=header(frame), poses=[pose(3.0, 8.0).pose])
        return TripRequest(None, None, GOAL, via=stops)

    assert through('map').leads_to(through('map'))
    assert not through('map').leads_to(through('odom'))


@pytest.mark.parametrize('by_clock', [True, False])
def test_a_trip_without_progress_is_over_by_the_clock_or_by_tf(trips, clock, by_clock):
    def later(seconds):
        clock.now += seconds * by_clock
        return asked(seconds * (not by_clock))

    first = trip()
    trips.add(first)
    assert trips.continued_by(later(599.0)) is first
    first.track.progress = 0.6
    assert trips.continued_by(later(599.0)) is first, 'it drives'
    first.track.progress = 0.8
    assert trips.continued_by(later(DAY)) is None, 'the same route another day'
    first.track.progress = 5.0
    assert trips.continued_by(later(DAY)) is None, 'for good'


def test_a_simulation_that_restarts_ends_all_trips_and_a_small_step_of_the_clock_none(trips, clock):
    clock.now = 100.0
    trips.add(first := trip())
    first.moment = (100.0, 100.0)
    assert trips.continued_by(asked(100.0)) is first
    clock.now = 99.3
    assert trips.continued_by(asked(99.3)) is first
    clock.now = 2.0
    assert trips.continued_by(asked(2.0)) is None


def test_trips_of_all_robots_are_kept_up_to_a_number(trips, monkeypatch):
    monkeypatch.setattr('ambush_planner.ros.robot_trips._MAX_TRIPS', 3)
    frames = [('map', f'robot {number}') for number in range(4)]
    kept = [trip(frames=each) for each in frames[:3]]
    for each in kept:
        trips.add(each)
    assert trips.continued_by(asked(frames=frames[0])) is kept[0], 'used last'
    trips.add(trip(frames=frames[3]))
    assert trips.continued_by(asked(frames=frames[1])) is None
    assert trips.continued_by(asked(frames=frames[0])) is kept[0]
