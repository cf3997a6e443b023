# SPDX-License-Identifier: Apache-2.0
"""Log lines about maps, plans and departures, and the warning of a volatile map."""


from nav_msgs.msg import OccupancyGrid
from rclpy.node import Node
from rclpy.qos import QoSProfile
from ros_harness import stage, wait_until


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
