# SPDX-License-Identifier: Apache-2.0
"""A node, an executor and a thread for large or frequent messages, apart from the planner's."""

from __future__ import annotations

from collections.abc import Callable
from threading import Event, Thread
from typing import Any

from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile

from ..worker.solve_errors import for_the_log, unexpected

# Time until the end of the context is noticed if nothing else happens [s].
_SPIN_PERIOD = 0.25


class Listener:
    """Receives maps, transforms and paths to check in a thread; ``start`` it once all are set.

    They then do not keep the planner's executor from answering. The ``node``, ``_NAME_listener``,
    is hidden from ``ros2 node list`` and in the planner's context and enclave. The thread ends with
    ``close`` or with the context.
    """

    def __init__(self, planner: Node) -> None:
        self._planner = planner
        self.node = Node(
            f'_{planner.get_name()}_listener', context=planner.context,
            namespace=planner.get_namespace(),
            # Command line arguments belong to the planner's node, which resolves the names.
            use_global_arguments=False, enable_rosout=False, start_parameter_services=False,
            # The SROS2 policy does not grant it these services.
            parameter_overrides=[Parameter('start_type_description_service', value=False),
                                 Parameter('use_sim_time', value=False)],
        )
        self._executor = SingleThreadedExecutor(context=planner.context)
        self._executor.add_node(self.node)
        self._closed = Event()
        self._thread = Thread(target=self._spin, name=self.node.get_name(), daemon=True)

    def subscribe(self, kind: type, topic: str, qos: QoSProfile,
                  receive: Callable[..., None]) -> None:
        """Have ``receive`` called with each serialised message and what DDS says of it."""
        self.node.create_subscription(kind, self._planner.resolve_topic_name(topic), receive, qos,
                                      raw=True)

    def serve(self, kind: Any, name: str, respond: Callable[[Any], Any]) -> None:
        """Serve requests, each with what ``respond`` returns."""
        self.node.create_service(kind, self._planner.resolve_service_name(name),
                                 lambda request, _: respond(request))

    def start(self) -> None:
        """Begin to receive."""
        self._thread.start()

    def close(self) -> None:
        """End the thread; a second call does nothing."""
        if not self._closed.is_set():
            self._closed.set()
            self._executor.wake()
            if self._thread.is_alive():
                self._thread.join()
            self._executor.shutdown()
            self.node.destroy_node()

    def _spin(self) -> None:
        while self._executor.context.ok() and not self._closed.is_set():
            try:
                self._executor.spin_once(timeout_sec=_SPIN_PERIOD)
            except ExternalShutdownException:
                return
            except Exception as error:  # unreadable bytes, for instance
                self._planner.get_logger().error(f'listener: {for_the_log(unexpected(error))}',
                                                 throttle_duration_sec=10.0)
