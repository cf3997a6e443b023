# SPDX-License-Identifier: Apache-2.0
"""A path from a running node (`ros2 launch ambush_planner ambush_planner.launch.xml`).

Each request for another goal is a departure with a fresh route. Give the path to Nav2's FollowPath,
for instance with `BasicNavigator.followPath`; docs/nav2.md has the whole drive.
"""

import math

import rclpy
from nav_msgs.srv import GetPlan

rclpy.init()
node = rclpy.create_node('get_plan_example')
client = node.create_client(GetPlan, '/ambush_planner/get_plan')
if not client.wait_for_service(timeout_sec=10.0):
    raise SystemExit('no planner is running')

request = GetPlan.Request()
for pose, x, y in ((request.start, 1.5, 5.5), (request.goal, 8.5, 5.5)):
    pose.header.frame_id = 'map'  # for the robot's own pose: base_link, and zeros
    pose.pose.position.x, pose.pose.position.y = x, y
    pose.pose.orientation.w = 1.0

answer = client.call_async(request)
rclpy.spin_until_future_complete(node, answer)
path = answer.result().plan
if not path.poses:
    raise SystemExit('there is no route: /diagnostics says why')
places = [each.pose.position for each in path.poses]
length = sum(math.dist((a.x, a.y), (b.x, b.y)) for a, b in zip(places, places[1:], strict=False))
print(f'{len(places)} poses in {path.header.frame_id}, {length:.1f} m')
for place in places[::10]:
    print(f'{place.x:.2f} {place.y:.2f}')
rclpy.shutdown()
