# SPDX-License-Identifier: Apache-2.0
"""A client of the node without `ros2`: publishes a map, a start and a goal, and departs twice.

    .venv/bin/ambush_planner & sleep 5; .venv/bin/python examples/06_ros_client.py; kill %1

after `make demo`, which has put ROS into .venv; with a ROS installation, run it with its python3.
"""

import array

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid, Path
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_srvs.srv import Trigger

rclpy.init()
node = rclpy.create_node('client')
latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
map_out = node.create_publisher(OccupancyGrid, 'alpha_map', latched)
ends = [node.create_publisher(PoseStamped, name, 1) for name in ('start_pose', 'goal_pose')]
paths = []
node.create_subscription(Path, 'path', paths.append, latched)
new_route = node.create_client(Trigger, '/ambush_planner/new_route')
print('waiting for the node')
while not (new_route.service_is_ready() and all(p.get_subscription_count() for p in ends)):
    rclpy.spin_once(node, timeout_sec=0.1)

values = np.full((40, 60), 20, np.int8)  # risk, 0 to 100, of cells of 0.5 m
values[10:30, 28:32] = 100  # an obstacle
grid = OccupancyGrid(data=array.array('b', values.tobytes()))
grid.header.frame_id, grid.info.resolution = 'map', 0.5
grid.info.height, grid.info.width = values.shape
map_out.publish(grid)
for publisher, x in zip(ends, (2.0, 28.0), strict=True):
    pose = PoseStamped()
    pose.header.frame_id, pose.pose.position.x, pose.pose.position.y = 'map', x, 10.0
    publisher.publish(pose)

while len(paths) < 2:
    answer = new_route.call_async(Trigger.Request())
    rclpy.spin_until_future_complete(node, answer)
    print(answer.result().message)
    rclpy.spin_once(node, timeout_sec=1.0)
print([len(path.poses) for path in paths], 'poses')
rclpy.shutdown()
