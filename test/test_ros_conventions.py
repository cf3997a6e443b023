# SPDX-License-Identifier: Apache-2.0
"""Conventions of ROS: frames, simulated time, several nodes."""

import math

from builtin_interfaces.msg import Time
from ros_harness import free_domain, pose, recorded, risk_grid, stage, wait_until
from rosgraph_msgs.msg import Clock


def test_rotated_map_in_its_own_frame():
    grid = risk_grid(origin=(100.0, -50.0, math.pi / 2), frame='site')
    with stage() as running:
        client = running.client
        client.publish('alpha_map', grid)
        client.diagnostics(message='waiting for /start_pose, /goal_pose')
        path = client.get_plan(
            pose(94.5, -48.5, frame='site'), pose(94.5, -41.5, frame='site'))
        assert path.header.frame_id == 'site'
        assert client.last('edge_probabilities').markers[0].header.frame_id == 'site'


def test_several_nodes_side_by_side_in_one_domain():
    with free_domain() as domain, stage(domain=domain, namespace='/north') as north, stage(
            domain=domain, namespace='/south') as south:
        for goal, running in ((2.5, north), (3.5, south)):
            running.give(goal=(8.5, goal))
            answer = running.client.call_until('new_route', lambda answer: answer.success)
            namespace = running.planner.get_namespace()
            assert f'published on {namespace}/path' in answer.message
            running.client.diagnostics(departures='1')  # /diagnostics is one topic for all nodes
            names = {each.status[0].hardware_id for each in running.client.received['/diagnostics']}
            assert f'{namespace}/ambush_planner'[1:] in names
            assert running.client.last('path').poses[-1].pose.position.y == goal
        assert len(north.client.received['path']) == len(south.client.received['path']) == 1


def test_simulated_time_stamps_what_is_published_and_does_not_hold_anything_up(tmp_path):
    with stage(tmp_path, {'use_sim_time': True}) as running:
        client = running.client
        assert running.give().call('new_route').success
        assert client.last('path').header.stamp == Time(), 'there is no time yet'
        client.last('/diagnostics', len(client.received['/diagnostics']) + 2)
        now = Time(sec=12, nanosec=345)
        client.publish('/clock', Clock(clock=now))
        wait_until(lambda: running.planner.get_clock().now().to_msg() == now, 'the new time')
        assert client.call('new_route').success
        assert client.last('path', 2).header.stamp == now
        client.publish('/clock', Clock(clock=Time(sec=3)))
        wait_until(lambda: running.planner.get_clock().now().to_msg().sec == 3, 'time gone back')
        assert client.call('new_route').success
        client.diagnostics(departures='3', recording='on', code='NONE')
    recorded(tmp_path, 3)
