# SPDX-License-Identifier: Apache-2.0
"""Stand-in for ``ros2`` and Nav2's map_server, which are not on PyPI, for the tutorial's commands.

``ros2 run ambush_planner`` starts the real programs.
"""

import signal
import subprocess
import sys
from pathlib import Path

ACTIVE = 'map_server/active'
# Imports are inside functions, because each command is a process of its own.


def serve_map(node, arguments):
    """Publish the latched map and serve ``ACTIVE`` until a signal ends the process."""
    from std_msgs.msg import Header
    from std_srvs.srv import Trigger
    from waiting import wait_until

    from ambush_planner.maps.map_file import read_map
    from ambush_planner.ros.conversions import occupancy_to_ros
    from ambush_planner.ros.topics import LATCHED

    options = dict(each.split(':=') for each in arguments if ':=' in each)
    grid = read_map(Path(options['yaml_filename']))
    header = Header(frame_id='map')
    message = occupancy_to_ros(grid.values, grid.resolution, grid.origin, header)
    publisher = node.create_publisher(type(message), options['map'], LATCHED)
    # A latched message takes up to 3 s to a subscription that is discovered after it.
    wait_until(publisher.get_subscription_count, f'a subscription of {options["map"]}')
    publisher.publish(message)
    assert publisher.wait_for_all_acked()
    node.create_service(Trigger, ACTIVE, lambda _, answer: answer)
    signal.pause()  # the middleware has threads of its own


def wait_for_map(node):
    """Wait until the map has been received."""
    from std_srvs.srv import Trigger
    from waiting import wait_until

    wait_until(node.create_client(Trigger, ACTIVE).service_is_ready, ACTIVE)


def publish(node, topic, kind, text, qos):
    import yaml
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from ros_yaml import filled, type_of
    from waiting import wait_until

    durability = DurabilityPolicy[qos.get('--qos-durability', 'volatile').upper()]
    publisher = node.create_publisher(type_of(kind), topic,
                                      QoSProfile(depth=1, durability=durability))
    wait_until(publisher.get_subscription_count, f'a subscription of {topic}')
    publisher.publish(filled(type_of(kind)(), yaml.safe_load(text)))
    assert publisher.wait_for_all_acked()


def echo(node, topic):
    """Print a message of a latched topic."""
    import rclpy
    from ros_yaml import type_of
    from waiting import wait_until

    from ambush_planner.ros.topics import LATCHED

    wait_until(lambda: node.get_publishers_info_by_topic(topic), f'a publisher of {topic}')
    (info,) = node.get_publishers_info_by_topic(topic)
    received = rclpy.task.Future()
    node.create_subscription(type_of(info.topic_type), topic, received.set_result, LATCHED)
    rclpy.spin_until_future_complete(node, received, timeout_sec=30.0)
    print(received.result())


def call(node, name, kind):
    from rcl_interfaces.srv import GetParameters
    from ros_yaml import type_of
    from waiting import TIMEOUT, wait_until

    client = node.create_client(type_of(kind), name)
    wait_until(client.service_is_ready, name)
    # Answers are lost until the server has discovered the client; it discovers them in order.
    later = node.create_client(GetParameters, f'{name.rpartition("/")[0]}/get_parameters')
    wait_until(later.service_is_ready, later.srv_name)
    wait_until(lambda: answer_within(0.1, node, later), later.srv_name)
    print(answer_within(TIMEOUT, node, client))


def answer_within(seconds, node, client):
    import rclpy

    future = client.call_async(client.srv_type.Request())
    rclpy.spin_until_future_complete(node, future, timeout_sec=seconds)
    return future.result()


def main(arguments):
    match arguments:
        case ['run', package, name, *rest]:
            # Like the real one, which leaves its child alone when it is killed.
            own = [sys.executable, __file__] * (package != 'ambush_planner')
            sys.exit(subprocess.run([*own, name, *rest], check=False).returncode)
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    # With rclpy's own handlers, `spin` occasionally misses a signal and never ends.
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node('standin')
    match arguments:
        case ['map_server', '--ros-args', *rest]:
            serve_map(node, rest)
        case ['lifecycle_bringup', 'map_server']:
            wait_for_map(node)
        case ['topic', 'pub', '--once', *qos, topic, kind, text]:
            publish(node, topic, kind, sys.stdin.read() if text == '--stdin' else text,
                    dict(zip(qos[::2], qos[1::2], strict=True)))
        case ['topic', 'echo', '--once', topic]:
            echo(node, topic)
        case ['service', 'call', name, kind]:
            call(node, name, kind)
        case _:
            sys.exit(f'the stand-in has no {arguments}')


if __name__ == '__main__':
    main(sys.argv[1:])
