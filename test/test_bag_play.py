"""Recordings in other tools: people's readers take whole files, and a player drives a node.

`ros2 bag` is not on the package index; the player here is a stand-in that does what `ros2 bag play
--publish-service-requests` does with these files.
"""

import sys
import time

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid
from nav_msgs.srv import GetPlan
from rclpy.serialization import deserialize_message
from ros_harness import pose, risk_grid, stage, wait_until
from std_srvs.srv import Trigger

from ambush_planner.commands.replay import qos_from_yaml
from ambush_planner.recordings import read_recording, recordings_in

convert = pytest.importorskip('rosbags.convert.cli').main
INPUTS = {'nav_msgs/msg/OccupancyGrid': OccupancyGrid, 'geometry_msgs/msg/PoseStamped': PoseStamped}
EVENTS = {'std_srvs/srv/Trigger_Event': Trigger, 'nav_msgs/srv/GetPlan_Event': GetPlan}


def record(folder, **parameters):
    """Three departures: the second on another map to another goal, the third by get_plan."""
    with stage(folder, parameters) as running:
        client = running.give()
        assert client.call('new_route').success
        client.publish('alpha_map', risk_grid(np.full((20, 20), 30, np.int8)))
        client.publish('goal_pose', pose(8.5, 2.5))
        client.call_until('new_route', lambda _: _ends(client)[-1] == (8.5, 2.5))
        assert client.get_plan(pose(2.5, 2.5), pose(7.5, 7.5)).poses
    return recordings_in(folder)


def _ends(client):
    return [(path.poses[-1].pose.position.x, path.poses[-1].pose.position.y)
            for path in client.received['path']]


def play(files, client, rate):
    """Send inputs and requests at the times that they have; return the answers.

    Stands in for rosbag2: publishers first, then each message when its log time is due.
    """
    messages = [each for file in files for each in read_recording(file).messages
                if each.type in INPUTS or each.type in EVENTS]
    publishers = {
        each.topic: client.node.create_publisher(
            INPUTS[each.type], each.topic, qos_from_yaml(each.qos))
        for each in messages if each.type in INPUTS
    }
    wait_until(lambda: all(each.get_subscription_count() for each in publishers.values()), 'node')
    begin, first, answers = time.monotonic(), messages[0].stamp_ns, []
    for each in messages:
        due = begin + (each.stamp_ns - first) / 1e9 / rate
        time.sleep(max(0.0, due - time.monotonic()))
        if each.type in INPUTS:
            # On a busy machine a solve may outlast the recorded pause.
            wait_until(lambda: all(answer.done() for answer in answers), 'answers')
            publishers[each.topic].publish(each.data)
            continue
        event = deserialize_message(each.data, EVENTS[each.type].Event)
        if event.request:
            answers.append(client.send(each.topic.split('/')[-2], event.request[0]))
    wait_until(lambda: all(each.done() for each in answers), 'answers')
    return [each.result() for each in answers]


@pytest.fixture(scope='module')
def files(tmp_path_factory):
    return record(tmp_path_factory.mktemp('runs'))


def test_rosbags_converts_whole_files(files, tmp_path, monkeypatch):
    """To another bag of ROS 2, and to one of ROS 1."""
    for place, suffix in ((files[0].parent, ''), (files[0], '.bag')):
        copy = tmp_path / f'{place.stem}{suffix}'
        monkeypatch.setattr(sys, 'argv', [
            'rosbags-convert', '--src', str(place), '--dst', str(copy)])
        with pytest.raises(SystemExit) as ended:
            convert()
        assert not ended.value.code
        assert copy.exists()


def test_a_player_drives_a_node_to_all_departures(tmp_path):
    files = record(tmp_path, **{'recording.service_events': True})
    recorded = [read_recording(file) for file in files]
    assert all(sum(m.type in EVENTS for m in each.messages) == 2 for each in recorded)
    with stage() as running:
        client = running.client
        # As a player does before it starts: its publishers and clients find the node.
        assert all(each.wait_for_service(10.0) for each in client._services.values())
        # Slower than recorded, so that a busy machine gets the inputs before the request.
        answers = play(files, client, rate=1.0)
        assert [answer.success if hasattr(answer, 'success') else bool(answer.plan.poses)
                for answer in answers] == [True] * len(files)
        wait_until(lambda: len(client.received['path']) == len(files), 'paths')
        assert _ends(client) == [tuple(each.entries['ends'][1]) for each in recorded]
