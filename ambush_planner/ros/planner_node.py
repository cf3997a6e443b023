# SPDX-License-Identifier: Apache-2.0
"""The node: its lifecycle states, and the parts that exist in each of them."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from typing import Any

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import ParameterException
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from ..errors import InvalidOption
from ..game.value.growing_program import HAS_HIGHSPY
from ..recordings.metadata import software_versions
from .bond import Bond
from .compute_path import ACTIONS, ComputePath
from .conversions import installed_type
from .diagnostics import Reporter
from .dispatcher import Dispatcher
from .errors import ErrorBoundary, protect_services
from .gate import ACTIVE, Gate
from .inputs import Inputs
from .listener import Listener
from .parameter_changes import NodeSettings
from .path_checks import PathChecks
from .plan_from_file import inputs_of
from .recordings import Recordings
from .requests import Requests
from .shared_memory import hide_segments
from .subscriptions import Subscriptions
from .topics import PLAN_TOPICS, STATUS_TOPICS, Publishers
from .transforms import FrameTransforms

NODE_NAME = 'ambush_planner'
_REPORT_PERIOD = 1.0  # of the diagnostics [s]
_SPIN_PERIOD = 0.25  # time until a signal is noticed if nothing else happens [s]
_LAST_ANSWERS_TIME = 0.5  # for which the node stays to send its last answers [s]
_LAST_RECORDINGS_TIME = 0.5  # for which it then stays to write its last recordings [s]
_HELP_EPILOG = """topics, services, actions and parameters: docs/ros_interface.md, or
  ros2 node info /ambush_planner; ros2 param describe /ambush_planner NAME"""


class PlannerNode(LifecycleNode):
    """The ambush planner; keyword arguments go to ``rclpy.node.Node``.

    Unconfigured it has parameters, diagnostics, and services that refuse; inactive it also listens;
    active it answers. It activates itself at the start unless ``autostart`` is false.

    Callbacks never wait, so a single-threaded executor is enough and answers soonest. With several
    threads rclpy can raise ``InvalidHandle`` if the node is cleaned up while messages arrive.

    Raises InvalidOption or rclpy.exceptions.ParameterException if initial parameters are invalid.
    """

    def __init__(self, **node_arguments: Any) -> None:
        super().__init__(NODE_NAME, **node_arguments)
        self._at_cleanup, self._at_end = ExitStack(), ExitStack()
        with ExitStack() as on_error:
            on_error.enter_context(self._at_end)
            self._at_end.callback(super().destroy_node)
            self._build()
            if self._settings.current.values['autostart']:
                for transition in (self.trigger_configure, self.trigger_activate):
                    if transition() != TransitionCallbackReturn.SUCCESS:
                        raise self._transition_error or RuntimeError('the node failed to start')
            on_error.pop_all()

    def _build(self) -> None:
        """Make the parts that exist in every state."""
        hide_segments()
        protect_services(self)
        self._dispatcher: Dispatcher | None = None  # while the node is configured
        self._recordings: list[Recordings] = []  # those of earlier configurations may still write
        self._transition_error: Exception | None = None
        self._gate = Gate()
        self._settings = NodeSettings(self, self._gate)
        Bond(self, self._gate)
        current, logger = self._settings.current, self.get_logger()
        if current.values['seed'] >= 0:
            logger.warning('the parameter seed is set: every run draws the same sequence of '
                           'routes, which can be predicted; use it for tests and replay only')
        if not HAS_HIGHSPY:
            logger.info('plans are solved sooner with the Python package highspy: '
                        'pip install highspy')
        self._reporter = Reporter(self.get_fully_qualified_name().lstrip('/'),
                                  Publishers(self, STATUS_TOPICS), self._present)
        self._reporter.set(records=current.recording.enabled)
        self._error_boundary = ErrorBoundary(self.context, logger, self._reporter.note)
        self._at_end.callback(self._error_boundary.log_repeated)
        self._requests = Requests(self, self._error_boundary, self._configured_dispatcher)
        for name, kind in ACTIONS.items():
            if action := installed_type('nav2_msgs.action', kind):
                serving = ComputePath(self, self._error_boundary, self._requests, self._settings,
                                      name, action)
                self._at_end.callback(serving.server.destroy)
        self._at_end.callback(self._wait_for_recordings)
        self._at_end.callback(lambda: self._at_cleanup.close())
        # A steady clock: diagnostics go on while simulated time is paused.
        self.create_timer(
            _REPORT_PERIOD, clock=Clock(clock_type=ClockType.STEADY_TIME),
            callback=lambda: self._error_boundary.attempt('diagnostics', 'request', self._report),
        )

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Listen, and get ready to plan."""
        return self._changed('configure', self._configure, TransitionCallbackReturn.FAILURE)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Answer requests."""
        return self._changed('activate', self._activate)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Refuse requests and cancel solves; plans and inputs are kept."""
        return self._changed('deactivate', self._deactivate)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget everything except the parameters."""
        return self._changed('cleanup', self._unconfigure)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Refuse requests for good."""
        return self._changed('shutdown', lambda: self._unconfigure('finalized'))

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Be unconfigured after a transition that failed, whose error stays reported."""
        error, result = self._transition_error, self._changed('error', self._unconfigure)
        if error is not None:
            self._reporter.note('request', error)
        return result

    def _changed(self, name: str, change: Callable[[], None],
                 failed: TransitionCallbackReturn = TransitionCallbackReturn.ERROR,
                 ) -> TransitionCallbackReturn:
        """Make a transition, which never waits for a disk or a solve; errors are reported.

        rclpy would swallow them.
        """
        _, self._transition_error = self._error_boundary.attempt(name, 'request', change)
        return failed if self._transition_error else TransitionCallbackReturn.SUCCESS

    def _configure(self) -> None:
        with ExitStack() as made:
            publishers = Publishers(self, PLAN_TOPICS)
            made.callback(publishers.close)
            self._listener = listener = Listener(self)
            made.callback(listener.close)
            transforms = FrameTransforms(self, listener)
            made.callback(transforms.close)
            inputs = Inputs(transforms, self.resolve_topic_name, self._settings)
            recordings = Recordings(self._settings.current.recording, self._reporter,
                                    self.get_logger(), self.resolve_topic_name)
            made.callback(recordings.finish)
            self._recordings = [recordings, *(each for each in self._recordings if each.alive)]
            dispatcher = Dispatcher(self._settings, inputs, publishers, recordings,
                                    self._reporter, self.get_logger(), self._gate)
            made.callback(dispatcher.close)
            if (saved := self._settings.saved) is not None:  # before newer maps arrive
                dispatcher.adopt(saved, *inputs_of(saved, self._settings.current,
                                                   self.resolve_topic_name))
            self._listening = Subscriptions(self, listener, inputs, self._settings,
                                            self._error_boundary, self._reporter, dispatcher)
            made.callback(self._listening.close)
            PathChecks(listener, inputs, self._settings, self._error_boundary)
            made.callback(listener.close)  # first: nothing is received any more
            listener.start()
            self._at_cleanup = made.pop_all()
        self._dispatcher = dispatcher
        self._move('inactive')

    def _configured_dispatcher(self) -> Dispatcher:
        if (dispatcher := self._dispatcher) is None:  # read once: a cleanup may forget it
            raise self._gate.refusal
        return dispatcher

    def _activate(self) -> None:
        dispatcher = self._configured_dispatcher()
        self._move(ACTIVE)
        dispatcher.map_changed()

    def _deactivate(self) -> None:
        self._move('inactive')
        self._configured_dispatcher().cancel(self._gate.refusal)

    def _unconfigure(self, state: str = 'unconfigured') -> None:
        self._move(state)
        try:
            self._at_cleanup.close()
        finally:
            self._dispatcher = None
            self._reporter.forget()

    def _move(self, state: str) -> None:
        """Be in a lifecycle state."""
        self._gate.move(state)
        self._reporter.set()

    def stop_solving(self, executor: Executor) -> None:
        """Cancel all solves and refuse waiting requests; action goals by spinning ``executor``.

        The executor spins for a moment: the answer to a goal takes several tasks, and answers are
        lost if DDS announces first that the node has gone.
        """
        self._move('finalized')
        if self._dispatcher is not None:
            self._dispatcher.stop()
        end = time.monotonic() + _LAST_ANSWERS_TIME
        with suppress(ExternalShutdownException):
            while time.monotonic() < end:
                executor.spin_once(timeout_sec=0.05)

    def destroy_node(self) -> None:
        """Answer waiting requests, write the last recordings, and end all parts of the node."""
        self._at_end.close()

    def _wait_for_recordings(self) -> None:
        for each in self._recordings:
            each.wait(_LAST_RECORDINGS_TIME)

    def _present(self) -> dict[str, Any]:
        present: dict[str, Any] = {'lifecycle': self._gate.state}
        if (dispatcher := self._dispatcher) is not None:
            present['solving'], present['refining'] = dispatcher.activity
            present['missing'] = dispatcher.inputs.missing()
        return present

    def _report(self) -> None:
        self._error_boundary.log_repeated()
        if (dispatcher := self._dispatcher) is not None:
            self._listening.check()
            dispatcher.follow()
        self._reporter.report()


def check_arguments(arguments: list[str] | None) -> None:
    """Print the help if asked for; exit with 2 at an argument that is not one of ROS."""
    parser = argparse.ArgumentParser(
        prog=NODE_NAME, usage='ros2 run ambush_planner ambush_planner [--help] [--ros-args ...]',
        description='Draws a fresh route for every departure of a convoy.', epilog=_HELP_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    given = sys.argv if arguments is None else ['', *arguments]
    with suppress(RuntimeError):  # malformed ROS arguments: rclpy.init names them
        parser.parse_args(remove_ros_args(given)[1:])


def main(args: list[str] | None, received: list[int]) -> int:
    """Run the node until a signal has been ``received`` or its context ends; return the code."""
    check_arguments(args)
    os.umask(0o077)  # for logs, and whatever else libraries write
    try:
        with ExitStack() as ending:
            ending.callback(rclpy.try_shutdown)
            try:
                rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
            except RuntimeError as error:  # a missing parameter file, for instance
                raise InvalidOption(str(error)) from error
            if received:
                return 0
            node = PlannerNode()
            ending.callback(node.destroy_node)
            executor = SingleThreadedExecutor()
            ending.callback(executor.shutdown)
            ending.callback(node.stop_solving, executor)
            executor.add_node(node)
            names = map(node.resolve_topic_name, ('alpha_map', 'start_pose', 'goal_pose'))
            node.get_logger().info(
                f'version {software_versions()["ambush_planner"]}: publish {", ".join(names)}; '
                f'each call of {node.resolve_service_name("~/new_route")} is then a departure')
            while rclpy.ok() and not received:
                executor.spin_once(timeout_sec=_SPIN_PERIOD)
    except ExternalShutdownException:
        pass
    except (InvalidOption, ParameterException) as error:
        print(f'{NODE_NAME}: cannot start: {error}', file=sys.stderr)
        return 1
    return 0
