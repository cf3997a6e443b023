"""The node: its states, and what it is made of in each of them."""

from __future__ import annotations

import ctypes
import gc
import signal
import sys
import time
from contextlib import ExitStack, suppress
from threading import Event
from typing import Any, TypeVar

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import ParameterException
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.signals import SignalHandlerOptions

from ..errors import InvalidOption
from ..planning.node_parameters import NodeParameters
from .compute_path import ComputePath
from .departure_record import software_versions
from .dispatcher import Dispatcher
from .error_boundary import ErrorBoundary, guard_services
from .error_codes import NotActive
from .inputs import Inputs
from .parameter_changes import declare_parameters
from .publishers import PLANS, STATUS, Publishers
from .reporter import Reporter
from .requests import Requests
from .subscriptions import Subscriptions
from .transforms import FrameTransforms
from .usage import check_arguments

NODE_NAME = 'ambush_planner'
_REPORT_PERIOD = 1.0  # s
_LOOK_UP = 0.25  # s; how soon the end is noticed when nothing else happens
_LAST_ANSWERS, _SPIN = 0.5, 0.05  # s

_M_MMAP_THRESHOLD, _LARGE = -3, 2**20  # malloc.h

_Part = TypeVar('_Part')


class PlannerNode(LifecycleNode):
    """The ambush planner; keyword arguments go to ``rclpy.node.Node``.

    Unconfigured it has parameters, diagnostics, and services that refuse; inactive it listens as
    well; active it answers. It is active from the start unless ``autostart`` is false.

    Callbacks never wait, so one thread is enough for them, and answers soonest. With several,
    rclpy's executor can raise ``InvalidHandle`` when the node is cleaned up while messages arrive.

    Raises
    ------
    InvalidOption, rclpy.exceptions.ParameterException
        The parameters that it was started with are not usable.
    """

    def __init__(self, **node_arguments: Any) -> None:
        super().__init__(NODE_NAME, **node_arguments)
        self._configured, self._closing = ExitStack(), ExitStack()
        self._closing.callback(self._leave_graph)
        self._closing.callback(super().destroy_node)
        with ExitStack() as unless_built:
            unless_built.enter_context(self._closing)
            self._build()
            if self._settings.values['autostart']:
                self._start()
            unless_built.pop_all()

    def _build(self) -> None:
        """Make what is there in every state."""
        guard_services(self)
        self._dispatcher: Dispatcher | None = None
        self._inputs: Inputs | None = None
        self._listening: Subscriptions | None = None
        self._contradiction: InvalidOption | None = None
        self._settings = declare_parameters(self, self._reconfigure, self._contradicted)
        if self._settings.seed >= 0:
            self.get_logger().warning(
                'the parameter seed is fixed: the sequence of routes is always the same and can '
                'be foreseen; only for tests and replay'
            )
        self._reporter = Reporter(
            self.get_fully_qualified_name().lstrip('/'),
            Publishers(self, STATUS),
            self.get_clock(),
            lambda: self._dispatcher is not None and self._dispatcher.solving,
            self._settings.error_hold,
        )
        self._guard = ErrorBoundary(self.context, self.get_logger(), self._reporter.failed)
        self._reporter.recording(self._settings.recording.enabled)
        self._serve()
        self._closing.callback(lambda: self._configured.close())
        # Steady: a simulation's clock that stands still must not silence the diagnostics.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(_REPORT_PERIOD, self._on_timer, clock=steady)

    def _serve(self) -> None:
        requests = Requests(
            self, self._guard, lambda: _there(self._dispatcher), lambda: _there(self._inputs),
            lambda: self._settings.robot,
        )
        self._goals = ComputePath(self, self._guard, requests)
        self._closing.callback(self._goals.close)

    def _start(self) -> None:
        for transition in (self.trigger_configure, self.trigger_activate):
            if transition() != TransitionCallbackReturn.SUCCESS:
                raise self._trouble or RuntimeError('the node does not start')

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Listen, and be ready to plan."""
        _, self._trouble = self._guard.attempt('configure', 'request', self._configure)
        if self._trouble is not None:
            return TransitionCallbackReturn.FAILURE
        self._reporter.lifecycle('inactive')
        self._tell_missing()
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Answer from now on."""
        _there(self._dispatcher).resume()
        self._reporter.lifecycle('active')
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Refuse from now on; end what runs. Plans and inputs are kept."""
        _there(self._dispatcher).pause()
        self._reporter.lifecycle('inactive')
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget everything but the parameters."""
        self._configured.close()
        self._reporter.lifecycle('unconfigured')
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Refuse for good."""
        self._configured.close()
        self._reporter.lifecycle('finalized')
        return TransitionCallbackReturn.SUCCESS

    def _configure(self) -> None:
        with ExitStack() as made:
            made.callback(self._forget)
            outbox = Publishers(self, PLANS)
            made.callback(outbox.close)
            self._transforms = FrameTransforms(self)
            made.callback(self._transforms.close)
            self._inputs = Inputs(self._transforms, self.resolve_topic_name('start_pose'))
            self._dispatcher = Dispatcher(
                self._settings, self._inputs, outbox, self._reporter, self.get_clock(),
                self.get_logger(),
            )
            made.callback(self._dispatcher.close)
            if self._contradiction is not None:
                self._dispatcher.refuse(self._contradiction)
            self._listening = Subscriptions(
                self, self._inputs, self._guard, self._tell_missing, self._map_accepted
            )
            made.callback(self._listening.close)
            self._configured = made.pop_all()

    def _forget(self) -> None:
        self._dispatcher, self._inputs, self._listening = None, None, None

    def stop_solving(self, executor: Executor | None = None) -> None:
        """End all solves for good; answer waiting requests, and action goals by ``executor``.

        With an executor the node stays for a moment: an answer is lost where DDS tells first that
        the node has gone, and a goal's answer is several tasks of the executor, one a spin.
        """
        if self._dispatcher is not None:
            self._dispatcher.stop_solving()
        if executor is not None:
            end = time.monotonic() + _LAST_ANSWERS
            with suppress(ExternalShutdownException):
                while time.monotonic() < end:
                    executor.spin_once(timeout_sec=_SPIN)

    def destroy_node(self) -> None:
        """Answer waiting requests, write the last recordings, and end all parts of the node."""
        self._closing.close()

    def _leave_graph(self) -> None:
        # The state machine would keep the node in the graph until Python looks for cycles.
        self._state_machine = None

    def _reconfigure(self, parameters: NodeParameters) -> None:
        before, self._settings = self._settings, parameters
        self._reporter.error_hold = parameters.error_hold
        self._reporter.warn('parameters', '')
        self._contradiction = None
        if self._dispatcher is not None:
            self._dispatcher.reconfigure(parameters)
        if parameters.recording != before.recording:
            self._reporter.recording(parameters.recording.enabled)
        self._tell_missing()

    def _contradicted(self, error: InvalidOption) -> None:
        self._contradiction = error
        if self._dispatcher is not None:
            self._dispatcher.refuse(error)
        self._reporter.warn(
            'parameters', f'parameters contradict each other, and requests are refused: {error}'
        )

    def _tell_missing(self) -> None:
        if self._inputs is not None:
            self._reporter.inputs(self._inputs.missing(self._settings.robot))

    def _map_accepted(self) -> None:
        self._reporter.map_accepted()
        self._tell_missing()
        _there(self._dispatcher).ground_changed()

    def _on_timer(self) -> None:
        self._guard.attempt('diagnostics', 'request', self._report)

    def _report(self) -> None:
        listening = self._listening
        self._reporter.warn('alpha_map', listening.unheard_maps() if listening else '')
        self._reporter.report()


def _there(part: _Part | None) -> _Part:
    """Return what there is of a node that is configured."""
    if part is None:
        raise NotActive(
            'the node is not configured: nobody departs before it is configured and activated '
            '(ros2 lifecycle set)'
        )
    return part


def _init(args: list[str] | None) -> None:
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # say, a parameter file that is not there
        raise InvalidOption(str(error)) from error


def _give_back_large_blocks() -> None:
    """Have glibc return the memory of a map when it is freed, in this process of our own.

    By itself it keeps blocks of up to 32 MB once it has freed one, in a heap for each thread.
    """
    with suppress(AttributeError, OSError):
        ctypes.CDLL(None).mallopt(_M_MMAP_THRESHOLD, _LARGE)


def main(args: list[str] | None = None) -> int:
    """Run the node until SIGINT, SIGTERM or the end of its context; return the exit code."""
    check_arguments(args)
    # Our own handlers, which only raise a flag: rclpy's end the context at once, wherever the
    # threads are, which crashes a node that is just starting. They stay to the end, so that a
    # second Ctrl-C does not cut the clean-up short.
    stop = Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    _give_back_large_blocks()
    executor, node = None, None
    try:
        _init(args)
        node = PlannerNode()
        node.get_logger().info(
            f'version {software_versions()["ambush_planner"]}; it needs alpha_map, start_pose and '
            'goal_pose; ~/new_route is a departure, once the node is active'
        )
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        # What is there by now stays: the collector need not look at it, which took 50 ms a time.
        gc.collect()
        gc.freeze()
        while rclpy.ok() and not stop.is_set():
            executor.spin_once(timeout_sec=_LOOK_UP)
    except ExternalShutdownException:
        pass
    except (InvalidOption, ParameterException) as error:
        print(f'{NODE_NAME}: cannot start: {error}', file=sys.stderr)
        return 1
    finally:
        # Waiting requests are answered, and the last recordings written, as the node is destroyed.
        if node is not None:
            node.stop_solving(executor)
        if executor is not None:
            executor.shutdown()
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
        # At its own end, Python would put the default back, by which a second Ctrl-C kills.
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)
    return 0


if __name__ == '__main__':
    sys.exit(main())
