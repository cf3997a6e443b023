# SPDX-License-Identifier: Apache-2.0
"""Which requests continue the trip of a robot, and the rest of its path; without ROS."""

import math

import numpy as np
import pytest
from games import examples
from hypothesis import given
from hypothesis import strategies as st

from ambush_planner import GameOptions, PlanningOptions, RiskMap, plan_trip
from ambush_planner.planning import trip_under_way
from ambush_planner.planning.plan import departure_path, draw_routes
from ambush_planner.planning.trip_under_way import Destination, TripUnderWay

FRAMES = ('map', 'base_link')
CELL, TOLERANCE, BACK = 0.1, 0.5, 2.0


def along(corners, spacing=0.05):
    """A dense path (L, 3) along straight lines."""
    pieces = [np.linspace(a, b, math.ceil(math.dist(a, b) / spacing), endpoint=False)
              for a, b in zip(corners, corners[1:], strict=False)]
    points = np.vstack((*pieces, corners[-1]))
    return np.column_stack((points, np.zeros(len(points))))


def trip_on(corners, goal=None, stops=(), passes=()):
    """A trip whose route has its nodes at the corners of its path, numbered from 10 on."""
    corners = [tuple(map(float, each)) for each in corners]
    legs = np.searchsorted(passes, np.arange(len(corners)))
    return TripUnderWay(
        Destination(FRAMES, goal or corners[-1], CELL, tuple(stops)), along(corners),
        np.arange(10, 10 + len(corners)), legs, np.array(corners), np.array(passes, int),
        np.arange(len(stops)), TOLERANCE, BACK)


def asked(goal=(10.0, 0.0), stops=(), frames=FRAMES):
    return Destination(frames, goal, CELL, tuple(stops))


@pytest.mark.parametrize(('request_', 'place', 'goal_tolerance', 'continues'), [
    (asked(), (0.0, 0.0), 0.0, True),
    (asked((10.05, 0.05)), (4.0, 0.3), 0.0, True),  # a goal that drifts
    (asked((10.3, 0.0)), (4.0, 0.0), 0.0, False), (asked((10.3, 0.0)), (4.0, 0.0), 0.5, True),
    (asked(), (4.0, 0.6), 0.0, False), (asked(), (-0.6, 0.0), 0.0, False),  # beside the path
    (asked(stops=[(5.0, 0.0)]), (4.0, 0.0), 0.0, False),
    (asked(frames=('map', 'other')), (4.0, 0.0), 0.0, False),
    (asked(frames=('odom', 'base_link')), (4.0, 0.0), 0.0, False),
])
def test_a_request_continues_the_trip_to_its_goal_from_its_path(request_, place, goal_tolerance,
                                                                continues):
    trip = trip_on([(0, 0), (10, 0)])
    assert trip.continues(request_, place, goal_tolerance) == continues


def test_a_robot_that_went_back_begins_a_new_trip():
    trip = trip_on([(0, 0), (10, 0)])
    assert trip.continues(asked(), (6.0, 0.0), 0.0)
    assert trip.continues(asked(), (6.0 - BACK - 0.4, 0.0), 0.0)
    assert trip.progress == 6.0
    assert not trip.continues(asked(), (6.0 - BACK - TOLERANCE - 0.1, 0.0), 0.0)
    assert trip.continues(asked(), (6.1, 0.0), 0.0)


def test_a_robot_that_drove_on_before_it_had_the_path_joins_it():
    trip = trip_on([(0, 0), (10, 0)])
    assert not trip.continues(asked(), (3.0, 2.0), 0.0)
    trip.drive_on((3.0, 2.0))
    assert trip.continues(asked(), (3.0, 2.0), 0.0)
    rest = trip.rest((3.0, 2.0), (10.0, 0.0))
    assert tuple(rest[0, :2]) == (3.0, 2.0) and rest[1, :2] == pytest.approx((5.05, 0.0), abs=0.06)
    assert trip.continues(asked(), (5.0, 0.1), 0.0)
    assert not trip.continues(asked(), (6.0, 2.0), 0.0), 'it has joined the path, and left it'
    trip.drive_on((5.0, 5.0 * BACK + 0.1))
    assert not trip.continues(asked(), (5.0, 5.0 * BACK + 0.1), 0.0), 'too far'


def test_progress_only_grows_on_a_path_that_comes_near_itself():
    """There and back, 0.4 m apart: within the tolerance of each other."""
    trip = trip_on([(0, 0), (10, 0), (10, 0.4), (0, 0.4)], goal=(0.0, 0.4))
    for x in np.arange(0.0, 10.0, 1.5):
        assert trip.follow((x, 0.2)) == pytest.approx(x)
    assert trip.follow((10.1, 0.2)) == pytest.approx(10.2)
    for x in np.arange(9.0, 0.0, -1.5):
        assert trip.follow((x, 0.2)) == pytest.approx(10.4 + 10.0 - x)


STOPS = ((4.0, 0.0), (8.0, 0.0))


def test_a_stop_that_has_been_passed_does_not_lie_ahead_on_a_path_that_leads_back_to_it():
    ends, stop = ((1.5, 1.5), (18.5, 1.5)), (10.5, 15.5)
    plan = plan_trip(RiskMap(np.ones((20, 20)), np.zeros((20, 20), bool), 1.0), *ends,
                     PlanningOptions(game=GameOptions(secured_radius=1.0)), stops=[stop])
    (route,) = draw_routes(plan, 1, np.random.default_rng(1))
    path, wanted = departure_path(plan, route, 0.25), Destination(FRAMES, ends[1], 1.0, (stop,))
    for passed, continues in (frozenset(), False), (frozenset([0]), True):
        trip = trip_under_way.trip_on(plan, route, path, wanted, passed)
        assert trip.continues(asked(ends[1]), ends[0], 0.0) == continues
        assert trip.passed == passed


@pytest.mark.parametrize(('x', 'stops', 'continues'), [
    (2.0, STOPS, True),
    (2.0, STOPS[1:], False),  # the first one lies ahead
    (5.0, STOPS[1:], True),
    (5.0, STOPS, True),  # the client has not removed it
    (5.0, (), False),
    (5.0, STOPS[:1], False),
    (9.0, (), True),
    (9.0, STOPS[::-1], False),
])
def test_the_stops_that_remain_are_asked_for(x, stops, continues):
    corners = [(0, 0), *STOPS, (10, 0)]
    trip = trip_on(corners, stops=STOPS, passes=(1, 2))
    assert trip.continues(asked(stops=stops), (x, 0.0), 0.0) == continues


def test_a_stop_may_be_left_out_from_where_nav2s_trees_take_it_off():
    """Which is before it counts as passed, if the tolerance is small."""
    trip = trip_on([(0, 0), *STOPS, (10, 0)], stops=STOPS, passes=(1, 2))
    assert not trip.continues(asked(stops=STOPS[1:]), (2.9, 0.0), 0.0)
    assert trip.continues(asked(stops=STOPS[1:]), (3.3, 0.0), 0.0)
    assert trip.passed == set()


def seen(place, seconds, yaw=0.0):
    return trip_under_way.Sighting(*place, yaw, seconds)


def test_a_round_trip_is_asked_for_again_by_a_robot_that_has_stood_at_its_end():
    """Start and goal are the same place, and a tree names the stops until it has ended."""
    stops = [(5.0, 0.0), (5.0, 5.0)]
    trip = trip_on([(0, 0), *stops, (0, 0)], stops=stops, passes=(1, 2))
    again = asked((0.0, 0.0), stops)
    for place in [(0.0, 0.0), (2.5, 0.0), (5.0, 0.1), (5.0, 2.5), (5.0, 5.0), (2.5, 2.5)]:
        assert trip.continues(again, place, 0.0)
    for second, place in enumerate([(1.0, 1.0), (0.3, 0.2), (0.2, 0.1), (0.15, 0.1)]):
        assert trip.continues(again, place, 0.0)
        trip.watch(seen(place, second))
    trip.watch(seen((0.15, 0.1), 3.1))  # too early to be standing
    trip.watch(seen((0.15, 0.1), 4.0, yaw=0.3))  # it turns
    assert trip.continues(again, place, 0.0) and not trip.arrived
    trip.watch(seen((0.16, 0.1), 5.0, yaw=0.3))
    assert trip.arrived and not trip.continues(again, place, 0.0)
    assert trip.continues(asked((0.0, 0.0)), place, 0.0), 'the goal remains'


def test_a_robot_whose_place_never_settles_arrives_in_the_end():
    trip = trip_on([(0, 0), (10, 0)])
    for second in range(20):
        assert trip.arrived == (second > 12)
        trip.watch(seen((0.0 if second < 2 else 9.9 + 0.05 * (second % 2), 0.0), second))


@examples(25)
@given(x=st.floats(0.0, 9.5), beside=st.floats(-0.45, 0.45))
def test_the_rest_begins_at_the_robot_and_ends_at_the_goal(x, beside):
    trip = trip_on([(0, 0), (10, 0)])
    place = (x, beside)
    assert trip.continues(asked(), place, 0.0)
    rest = trip.rest(place, (10.02, 0.01))
    assert tuple(rest[0, :2]) == place
    assert tuple(rest[-1, :2]) == (10.02, 0.01)
    assert (rest[1:-1, 0] > x).all() and (rest[1:-1, 1] == 0.0).all()
    if len(rest) > 2:
        assert rest[1, 0] - x <= abs(beside) + 0.05 + 1e-9, 'it meets the path at 45 degrees'


@pytest.mark.parametrize(('place', 'nodes'), [
    ((0.5, 0.0), [11]), ((3.0, 0.2), [12, 11]), ((4.0, 1.0), [13, 12]), ((9.9, 2.0), [14, 13]),
])
def test_a_route_changes_at_the_next_node_or_at_the_last_one(place, nodes):
    trip = trip_on([(0, 0), (2, 0), (4, 0), (4, 2), (10, 2)])
    for each in [(1.0, 0.0), (3.0, 0.0), (4.0, 1.0)]:
        if each[0] + each[1] < place[0] + place[1]:
            trip.follow(each)
    leg, ahead = trip.nodes_ahead(place)
    assert leg == 0 and ahead.tolist() == nodes


@pytest.mark.parametrize(('place', 'leg', 'nodes'), [
    ((1.0, 0.0), 0, [11]), ((5.0, 0.0), 1, [12]), ((9.0, 0.0), 2, [13])])
def test_a_route_changes_only_within_the_leg_that_is_driven(place, leg, nodes):
    trip = trip_on([(0, 0), *STOPS, (10, 0)], stops=STOPS, passes=(1, 2))
    for x in np.arange(0.0, place[0]):
        trip.follow((x, 0.0))
    found, ahead = trip.nodes_ahead(place)
    assert found == leg and ahead.tolist() == nodes


@examples(20)
@given(seed=st.integers(0, 10**6))
def test_a_robot_that_follows_its_path_stays_on_it_to_the_end(seed):
    """However the path winds and crosses itself; the robot is seen every metre or more often."""
    rng = np.random.default_rng(seed)
    headings = np.cumsum(rng.normal(0.0, 0.8, 25))
    corners = np.cumsum(np.column_stack((np.cos(headings), np.sin(headings))), axis=0)
    trip = trip_on(corners.tolist())
    points = trip.path[:, :2]
    driven = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))))
    at, before = 0.0, 0.0
    goal = tuple(corners[-1].tolist())
    while at < driven[-1]:
        beside = rng.uniform(-0.28, 0.28, 2)
        place = tuple(float(np.interp(at, driven, axis)) + off
                      for axis, off in zip(points.T, beside, strict=True))
        assert trip.continues(asked(goal), place, 0.0)
        assert trip.progress >= before
        rest = trip.rest(place, goal)
        assert tuple(rest[0, :2]) == place and tuple(rest[-1, :2]) == goal
        before, at = trip.progress, at + rng.uniform(0.0, 1.0)
    assert trip.progress > driven[-1] - 1.0 - 2.0 * TOLERANCE
