"""Poses into another frame, by what /tf and /tf_static tell."""

from __future__ import annotations

from functools import partial
from threading import Event, Thread

from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion
from rclpy.clock import JumpHandle, JumpThreshold
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.time import Time
from std_msgs.msg import Header

from ..maps.ros_messages import position_from_ros
from ..worker.solve_errors import for_the_log, unexpected
from .cdr import read_transforms
from .error_codes import FrameMismatch
from .qos import TF, TF_STATIC
from .tf_buffer import Found, Rigid, TransformBuffer, TransformUnknown, normalised

try:
    from tf2_msgs.msg import TFMessage  # comes with ROS, not from PyPI
except ImportError:
    TFMessage = None

_LONGEST_SHOWN = 80  # letters of a frame's name
_LOOK_UP = 0.25  # s; how soon the end of the context is noticed when nothing else happens


class FrameTransforms:
    """How frames lie to each other, as TF tells; nothing if ``tf2_msgs`` is missing.

    ``to_frame`` may be called from any thread. ``close`` before the node is destroyed.
    """

    def __init__(self, node: Node) -> None:
        self._clock = node.get_clock()
        self._buffer = TransformBuffer()
        self._listener = None if TFMessage is None else _TfListener(node, self._buffer)

    def close(self) -> None:
        """Stop listening."""
        if self._listener is not None:
            self._listener.close()

    def to_frame(self, pose: PoseStamped, name: str, frame: str, max_age: float) -> PoseStamped:
        """Return the pose called ``name`` in ``frame``; unchanged if it is given there.

        The latest transform that is known counts, whatever the pose's stamp: a pose in
        ``base_link`` is where the robot is now. The result has that transform's stamp, or none
        where it is static. Never waits for a transform.

        Raises
        ------
        FrameMismatch
            The pose has no frame, nothing tells how its frame lies to ``frame``, or what tells it
            is older than ``max_age`` [s].
        InvalidPose
            The pose would have to be transformed, and its numbers are not a pose.
        """
        given = pose.header.frame_id
        if given and given == frame:
            return pose
        shown = given if len(given) <= _LONGEST_SHOWN else f'{given[:_LONGEST_SHOWN]}...'
        problem = (
            f"{name} is given in the frame {shown!r}, the map in {frame!r}; give it in the map's "
            'frame'
        )
        if not given:
            raise FrameMismatch(f'{problem}: its header.frame_id is empty')
        if self._listener is None:
            raise FrameMismatch(f'{problem}, or install tf2_msgs to have it transformed')
        # As given: a rotation normalises, or refuses, an orientation that is not one.
        position_from_ros(pose, name)
        try:
            found = self._buffer.lookup(frame, given)
        except TransformUnknown as error:
            raise FrameMismatch(
                f'{problem}, or publish the transform between the two on /tf: {error}'
            ) from error
        self._check_age(found, name, shown, frame, max_age)
        return _transformed(pose, found, frame)

    def _check_age(self, found: Found, name: str, given: str, frame: str, max_age: float) -> None:
        if found.stamp_ns is None:
            return
        age = (self._clock.now().nanoseconds - found.stamp_ns) / 1e9
        if age > max_age:
            raise FrameMismatch(
                f'{name}: the transform from {given!r} to {frame!r} is {age:.3g} s old, more than '
                f'transform.max_age, {max_age:g} s; see that /tf is still published, and that its '
                "stamps are of this node's clock"
            )


class _TfListener:
    """Fills a buffer in a thread, with a node and an executor of its own, as in C++.

    TF comes often: each message costs an executor of many threads and subscriptions ten times
    what it costs this one, and a message read by rclpy as many times what its bytes cost here.
    The thread ends with ``close`` or with the node's context.
    """

    def __init__(self, node: Node, buffer: TransformBuffer) -> None:
        self._buffer, self._logger = buffer, node.get_logger()
        self._jumps = _forget_when_time_jumps_back(buffer, node)
        self._node = _hidden_node(node)
        for topic, qos, static in (('/tf', TF, False), ('/tf_static', TF_STATIC, True)):
            self._node.create_subscription(
                TFMessage,
                node.resolve_topic_name(topic),  # as the node itself is remapped
                partial(self._receive, static),
                qos,
                raw=True,
            )
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(self._node)
        self._closed = Event()
        # A daemon, in case nobody calls close.
        self._thread = Thread(target=self._spin, name=self._node.get_name(), daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread; a second time does nothing."""
        if not self._closed.is_set():
            self._closed.set()
            self._executor.wake()
            self._thread.join()
            self._jumps.unregister()
            self._executor.shutdown()
            self._node.destroy_node()

    def _spin(self) -> None:
        try:
            while self._executor.context.ok() and not self._closed.is_set():
                self._executor.spin_once(timeout_sec=_LOOK_UP)
        except ExternalShutdownException:
            pass
        except Exception as error:
            self._tell(error)
            if self._executor.context.ok() and not self._closed.is_set():
                self._closed.wait(_LOOK_UP)
                self._spin()

    def _receive(self, static: bool, data: bytes) -> None:
        try:
            for transform in read_transforms(data):
                self._buffer.add(transform, static)
        except ValueError as error:
            self._logger.warning(f'TF: {error}', throttle_duration_sec=10.0)
        except Exception as error:  # one that leaves a callback is printed with its own words
            self._tell(error)

    def _tell(self, error: Exception) -> None:
        self._logger.error(
            f'TF: {for_the_log(unexpected(error))}', throttle_duration_sec=10.0
        )


def _hidden_node(node: Node) -> Node:
    """Return a node beside ``node``, in the same namespace, without services."""
    return Node(
        f'_{node.get_name()}_tf',
        context=node.context,
        namespace=node.get_namespace(),
        # What is said on the command line is meant for the other node, which resolves the names.
        use_global_arguments=False,
        enable_rosout=False,
        start_parameter_services=False,
        parameter_overrides=[Parameter('use_sim_time', value=False)],
    )


def _forget_when_time_jumps_back(buffer: TransformBuffer, node: Node) -> JumpHandle:
    """Clear the buffer when a simulation or a bag starts anew.

    The new transforms would be older than what is known, and the old ones would stay the latest.
    """
    threshold = JumpThreshold(
        min_forward=None, min_backward=Duration(seconds=-1), on_clock_change=True
    )
    return node.get_clock().create_jump_callback(
        threshold, post_callback=lambda _: buffer.clear()
    )


def _transformed(pose: PoseStamped, found: Found, frame: str) -> PoseStamped:
    """Return the pose in ``frame``, to which ``found`` leads from its own."""
    p, q = pose.pose.position, pose.pose.orientation
    moved = found.rigid @ Rigid((p.x, p.y, p.z), normalised((q.x, q.y, q.z, q.w)))
    stamp = Time(nanoseconds=found.stamp_ns or 0).to_msg()
    return PoseStamped(
        header=Header(frame_id=frame, stamp=stamp),
        pose=Pose(
            position=Point(**dict(zip('xyz', moved.translation, strict=True))),
            orientation=Quaternion(**dict(zip('xyzw', moved.rotation, strict=True))),
        ),
    )
