# SPDX-License-Identifier: Apache-2.0
"""Log lines about maps, plans and departures, and the warning of a volatile map."""

import re

import numpy as np
from nav_msgs.msg import OccupancyGrid
from rclpy.node import Node
from rclpy.qos import QoSProfile
from ros_harness import risk_grid, stage, wait_until
from waiting import stderr_in

INFO = re.compile(r'^\[INFO\].*\[ambush_planner\]: (.*)$', re.MULTILINE)


def test_maps_plans_and_departures_are_logged_in_a_line_each(tmp_path):
    with stderr_in(tmp_path / 'log') as said, stage() as running:
        client = running.give(risk_grid(np.full((12, 30), 20, np.int8)), (1.5, 3.0), (13.5, 3.0))
        assert client.call('new_route').success
        assert client.call('new_route').success
        identity = client.diagnostics(departures='2')['departure_id']
        client.publish('alpha_map', risk_grid(np.full((12, 30), 20, np.int8)))  # the same again
        client.publish('alpha_map', risk_grid(np.full((14, 30), 20, np.int8)))
        wait_until(lambda: said().count('map accepted') == 2, 'the second map')
    logged = INFO.findall(said())
    maps = [line for line in logged if 'map accepted' in line]
    assert ['30 x 12' in maps[0], '30 x 14' in maps[1], len(maps)] == [True, True, 2]
    assert said().count('the map carries no risk') == 2, 'once for each ground'
    (solved,) = [line for line in logged if 'solved' in line]
    assert re.search(r'\d s.*value \d.* \d+ nodes', solved)
    departures = [line for line in logged if line.startswith('departure')]
    assert [line.split()[1] for line in departures] == ['1', '2'] and identity in departures[1]


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
