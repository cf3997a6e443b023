"""Poses into another frame, by TF where it is installed."""

from __future__ import annotations

from threading import Event, Thread

from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion, TransformStamped
from rclpy.clock import JumpHandle, JumpThreshold
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.time import Time
from scipy.spatial.transform import Rotation

from .conversions import position_from_ros
from .errors import FrameMismatch

try:
    import tf2_ros
except ImportError:
    tf2_ros = None

_LONGEST_SHOWN = 80  # letters of a frame's name
_LOOK_UP = 0.25  # s; how soon the end of the context is noticed when nothing else happens


class FrameTransforms:
    """How frames lie to each other, as TF tells; nothing if ``tf2_ros`` is missing.

    ``to_frame`` may be called from any thread. ``close`` before the node is destroyed.
    """

    def __init__(self, node: Node) -> None:
        self._tf = None if tf2_ros is None else _TfListener(node)

    def close(self) -> None:
        """Stop listening."""
        if self._tf is not None:
            self._tf.close()

    def to_frame(self, pose: PoseStamped, name: str, frame: str) -> PoseStamped:
        """Return the pose called ``name`` in ``frame``; unchanged if it is given there.

        The latest transform that is known counts, whatever the pose's stamp: a pose in
        ``base_link`` is where the robot is now. The result has that transform's stamp. Never
        waits for a transform.

        Raises
        ------
        FrameMismatch
            The pose has no frame, or nothing tells how its frame lies to ``frame``.
        InvalidPose
            The pose would have to be transformed, and its numbers are no pose.
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
        if self._tf is None:
            raise FrameMismatch(f'{problem}, or install tf2_ros to have it transformed')
        # As given: a rotation normalises, or refuses, an orientation that is none.
        position_from_ros(pose, name)
        try:
            return _transformed(pose, self._tf.buffer.lookup_transform(frame, given, Time()))
        except tf2_ros.TransformException as error:
            reason = str(error).strip()
            raise FrameMismatch(
                f'{problem}, or publish the transform between the two on /tf: {reason}'
            ) from error


class _TfListener:
    """Fills a buffer in a thread, with a node and an executor of its own, as in C++.

    TF comes often: each message costs an executor of many threads and subscriptions ten times
    what it costs this one. The thread ends with ``close`` or with the node's context.
    """

    def __init__(self, node: Node) -> None:
        self.buffer = tf2_ros.Buffer()
        self._jumps = _forget_when_time_jumps_back(self.buffer, node)
        self._node = _hidden_node(node)
        self._listener = tf2_ros.TransformListener(self.buffer, self._node, spin_thread=False)
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(self._node)
        self._closed = Event()
        self._thread = Thread(target=self._spin, name=self._node.get_name())
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


def _hidden_node(node: Node) -> Node:
    """Return a node beside ``node``: remapped like it, in the same namespace, without services."""
    name = f'_{node.get_name()}_tf'
    return Node(
        name,
        context=node.context,
        namespace=node.get_namespace(),
        # Or a name on the command line, which is meant for the other node, would be its too.
        cli_args=['--ros-args', '-r', f'__node:={name}'],
        enable_rosout=False,
        start_parameter_services=False,
        parameter_overrides=[Parameter('use_sim_time', value=False)],
    )


def _forget_when_time_jumps_back(buffer: tf2_ros.Buffer, node: Node) -> JumpHandle:
    """Clear the buffer when a simulation or a bag starts anew.

    TF would ignore the new transforms, older than what it knows, and the old ones would stay
    the latest.
    """
    threshold = JumpThreshold(
        min_forward=None, min_backward=Duration(seconds=-1), on_clock_change=True
    )
    return node.get_clock().create_jump_callback(
        threshold, post_callback=lambda _: buffer.clear()
    )


def _transformed(pose: PoseStamped, transform: TransformStamped) -> PoseStamped:
    """Return the pose, given in the transform's child frame, in its parent frame."""
    t, r = transform.transform.translation, transform.transform.rotation
    p, q = pose.pose.position, pose.pose.orientation
    turn = Rotation.from_quat((r.x, r.y, r.z, r.w))
    position = turn.apply((p.x, p.y, p.z)) + (t.x, t.y, t.z)
    orientation = (turn * Rotation.from_quat((q.x, q.y, q.z, q.w))).as_quat()
    return PoseStamped(
        header=transform.header,
        pose=Pose(
            position=Point(**dict(zip('xyz', position.tolist(), strict=True))),
            orientation=Quaternion(**dict(zip('xyzw', orientation.tolist(), strict=True))),
        ),
    )
