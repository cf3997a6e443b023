# SPDX-License-Identifier: Apache-2.0
"""Log lines about maps, plans and departures, and the warning of a volatile map."""

import numpy as np
from nav_msgs.msg import OccupancyGrid
from rclpy.node import Node
from rclpy.qos import QoSProfile
from ros_harness import risk_grid, stage, wait_until
from waiting import stderr_in

from ambush_planner.ros import planner_node


def test_warns_of_a_volatile_map_as_long_as_it_is_published():
    with stage() as running:
        client = running.client
        # Of its own and not spun, so that it can be destroyed at any time.
        other = Node('mapper', context=client.node.context)
        other.create_publisher(OccupancyGrid, 'alpha_map', QoSProfile(depth=1))

        def message():
            return client.diagnostics(state='waiting')['message']

        words = '/mapper publishes /alpha_map with volatile durability'
        wait_until(lambda: words in message(), 'a warning')
        assert client.diagnostics(state='waiting')['level'] == b'\1'
        other.destroy_node()
        wait_until(lambda: 'volatile' not in message(), 'no warning')


def test_a_missing_highspy_is_information_and_no_warning(tmp_path, monkeypatch):
    monkeypatch.setattr(planner_node, 'HAS_HIGHSPY', False)
    with stderr_in(tmp_path / 'log') as said, stage() as running:
        assert 'highspy' not in running.client.diagnostics(state='waiting')['message']
    assert said().count('pip install highspy') == 1 and '[INFO]' in said()


def test_a_map_is_logged_when_it_is_the_first_or_of_another_size_or_frame(tmp_path):
    with stderr_in(tmp_path / 'log') as said, stage() as running:
        def known():
            newest = running.planner._inputs._map
            return newest and (len(newest.values), newest.values.max())

        for rows, value in ((20, 10), (20, 20), (20, 30), (24, 30)):
            running.client.publish('alpha_map', risk_grid(np.full((rows, 20), value, np.int8)))
            wait_until(lambda shape=(rows, value): known() == shape, 'the map')
        wait_until(lambda: '20 x 24 cells' in said(), 'the log')
    assert said().count('map accepted: ') == 2
