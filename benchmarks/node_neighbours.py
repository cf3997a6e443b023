"""What runs around the node in ``node_motion``, each in a process of its own.

``maps`` publishes a costmap and its changes, and ``idle`` serves an action without doing anything,
until they are terminated. ``goals`` sends goals in turns to the node and to ``idle``, and does
nothing else that could delay what it measures; it prints how long each took to be accepted [ms] by
either, as JSON.
"""

from __future__ import annotations

import gc
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from nav_msgs.msg import OccupancyGrid
from node_rig import LATCHED, PLANNER, TIMEOUT, Rig, grid_of
from rclpy.action import ActionClient, ActionServer
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.serialization import serialize_message
from scipy.ndimage import gaussian_filter
from std_msgs.msg import Header

sys.path.append(str(Path(__file__).resolve().parent.parent / 'test'))
import interfaces  # noqa: E402

for package in ('tf2_msgs', 'map_msgs', 'nav2_msgs'):
    interfaces.install(package)
os.environ['PYTHONPATH'] = os.pathsep.join(sys.path)  # of the node, too
from map_msgs.msg import OccupancyGridUpdate  # noqa: E402
from nav2_msgs.action import ComputePathToPose  # noqa: E402

RESOLUTION, RATE = 0.05, 5.0  # m, Hz
SIDE = 8  # cells of the obstacle that moves
# Mean time between goals; the intervals vary, so that goals do not keep step with maps [s].
GOAL_PERIOD = 0.05
IDLE = '/idle/compute_path_to_pose'


def costmap(cells: int) -> np.ndarray:
    """A smooth map (H, W) with blocks, and a closed room around its centre."""
    rng = np.random.default_rng(1)
    rough = gaussian_filter(rng.random((cells, cells)), cells / 40)
    values = (60 * (rough - rough.min()) / np.ptp(rough)).astype(np.int8)
    for row, column in rng.integers(0, cells - cells // 25, (25, 2)):
        values[row:row + cells // 25, column:column + cells // 25] = 100
    room, wall = cells // 20, cells // 100
    middle = slice(cells // 2 - room - wall, cells // 2 + room + wall)
    inside = slice(cells // 2 - room, cells // 2 + room)
    values[middle, middle], values[inside, inside] = 100, 0
    return values


def obstacle_at(cells: int, step: int) -> tuple[int, int]:
    """The lowest row and column of the obstacle after this many steps."""
    row, column = np.random.default_rng((3, step)).integers(0, cells - SIDE, 2).tolist()
    return row, column


def publish_maps(cells: int, whole: bool, begin: float) -> None:
    """Publish a map, and from ``begin`` (``time.monotonic``) on where its obstacle moves."""
    node = rclpy.create_node('costmap')
    maps = node.create_publisher(OccupancyGrid, 'alpha_map', LATCHED)
    updates = node.create_publisher(OccupancyGridUpdate, 'alpha_map_updates', 10)
    values, step = costmap(cells), 0
    grid = grid_of(values, RESOLUTION)
    maps.publish(grid)
    data = bytearray(serialize_message(grid))
    shown = np.frombuffer(data, np.int8)[len(data) - values.size:].reshape(values.shape)
    while rclpy.ok():
        step += 1
        time.sleep(max(0.0, begin + step / RATE - time.monotonic()))
        before, now = obstacle_at(cells, step - 1), obstacle_at(cells, step)
        for (row, column), lethal in ((before, False), (now, True)):
            part = slice(row, row + SIDE), slice(column, column + SIDE)
            shown[part] = 100 if lethal else values[part]
            if not whole:
                updates.publish(OccupancyGridUpdate(
                    header=Header(frame_id='map'), x=column, y=row, width=SIDE, height=SIDE,
                    data=shown[part].ravel().tolist()))
        if whole:
            maps.publish(bytes(data))


def serve_idle() -> None:
    """Accept all goals, and abort them."""
    node = rclpy.create_node('idle')
    def abort(handle: Any) -> ComputePathToPose.Result:
        handle.abort()
        return ComputePathToPose.Result()

    ActionServer(node, ComputePathToPose, IDLE, abort, result_timeout=10)
    rclpy.spin(node)


def send_goals(seconds: float) -> None:
    """Send goals for another planner: the node accepts and then aborts them, at little cost."""
    node = rclpy.create_node('goals')
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    clients = [ActionClient(node, ComputePathToPose, name)
               for name in (f'{PLANNER}/compute_path_to_pose', IDLE)]
    goal = ComputePathToPose.Goal(planner_id='other')

    def accepted(client: ActionClient, timeout: float) -> bool:
        future, end = client.send_goal_async(goal), time.monotonic() + timeout
        while not future.done() and time.monotonic() < end:
            executor.spin_once(timeout_sec=timeout)
        return future.done()

    for client in clients:
        client.wait_for_server(TIMEOUT)
        while not accepted(client, 1.0):  # answers are lost until the server has discovered it
            pass
    gc.freeze()
    gc.disable()
    rng, due = np.random.default_rng(), time.monotonic()
    end, times = due + seconds, ([], [])
    while due < end:
        for client, each in zip(clients, times, strict=True):
            due += rng.uniform(0.5, 1.5) * GOAL_PERIOD
            while (left := due - time.monotonic()) > 0.0:
                executor.spin_once(timeout_sec=left)
            begin = time.perf_counter()
            accepted(client, TIMEOUT)
            each.append(round(1e3 * (time.perf_counter() - begin), 2))
    print(json.dumps(times))


@contextmanager
def neighbour(rig: Rig, *arguments: object) -> Iterator[subprocess.Popen[str]]:
    """Run one of the processes until the block ends."""
    process = subprocess.Popen(
        [sys.executable, __file__, *map(str, arguments)], stdout=subprocess.PIPE, text=True,
        env={**os.environ, 'ROS_DOMAIN_ID': str(rig.domain)})
    try:
        yield process
    finally:
        process.terminate()
        process.wait(TIMEOUT)


def main() -> None:
    what, *arguments = sys.argv[1:]
    rclpy.init()
    with suppress(RuntimeError, ExternalShutdownException):  # terminated
        if what == 'maps':
            cells, whole, begin = arguments
            publish_maps(int(cells), whole == 'True', float(begin))
        elif what == 'idle':
            serve_idle()
        else:
            send_goals(float(arguments[0]))


if __name__ == '__main__':
    main()
