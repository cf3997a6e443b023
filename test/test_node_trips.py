# SPDX-License-Identifier: Apache-2.0
"""Trips with stops: requested over DDS, displayed, recorded, verified and replayed."""

import numpy as np
import pytest
from geometry_msgs.msg import PoseArray
from ros_harness import header, pose, stage, wait_until

from ambush_planner.commands import verify
from ambush_planner.maps.ros_messages import path_from_ros
from ambush_planner.recordings.recorded_departure import read_departure
from ambush_planner.recordings.recorded_departures import recordings_in

STOPS = ((2.5, 2.25), (7.0, 8.5), (7.25, 2.5))
SPACING = {'network.spacing': 1.2}


def depart(client, stops):
    """Depart via these stops; the array may arrive after the request."""
    poses = [pose(*stop).pose for stop in stops]
    client.publish('via_poses', PoseArray(header=header(), poses=poses))
    client.call_until(
        'new_route', lambda answer: answer.success and stops_shown(client) == len(stops)
    )

    def wanted():
        path = path_from_ros(client.last('path'))
        met = [bool(len(meets(path, stop))) for stop in stops or STOPS]
        return [path] if (all(met) if stops else not any(met)) else []

    return wait_until(wanted, 'a path by the stops')[0]


def stops_shown(client):
    (marker,) = client.last('stops').markers
    return len(marker.points)


def meets(path, stop):
    """At which poses the path is exactly at a stop."""
    return np.flatnonzero((path[:, :2] == stop).all(axis=1))


@pytest.fixture(scope='module')
def runs(tmp_path_factory):
    """Departures via three stops, via none, and by get_plan."""
    folder = tmp_path_factory.mktemp('trips')
    with stage(folder, SPACING) as running:
        client = running.give()
        assert client.call('new_route').success
        given = depart(client, STOPS)
        client.diagnostics(stops='3')
        asked = path_from_ros(client.get_plan(pose(1.5, 5.5), pose(8.5, 5.5)))
        again = depart(client, ())
    files = recordings_in(folder)
    return files, given, asked, again


def trips(files):
    return [read_departure(path).metadata.trip for path in files]


def test_the_path_meets_each_stop_in_order_and_without_stops_none(runs):
    files, given, asked, again = runs
    places = [meets(given, stop) for stop in STOPS]
    assert all(len(each) == 1 for each in places)
    assert sorted(np.concatenate(places)) == list(np.concatenate(places))
    assert given[0, :2].tolist() == [1.5, 5.5] and given[-1, :2].tolist() == [8.5, 5.5]
    assert not any(len(meets(path, stop)) for path in (asked, again) for stop in STOPS)
    by = [trip.stops for trip in trips(files)]
    assert by[0] == by[-1] == () and sum(len(stops) == 3 for stops in by) == 1


def test_recordings_of_trips_hold(runs, capsys):
    for arguments in ([str(runs[0][0].parent)], [str(by_stops(runs[0])), '--replan']):
        code = verify.main(arguments)
        out, err = capsys.readouterr()
        assert code == 0, out + err


def by_stops(files, count=3):
    return next(path for path, trip in zip(files, trips(files), strict=True)
                if len(trip.stops) == count)
