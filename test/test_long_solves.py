# SPDX-License-Identifier: Apache-2.0
"""Long solves: the node keeps answering, and requests can be cancelled."""

import signal
import threading
from contextlib import contextmanager
from unittest import mock

import numpy as np
from handed_on import halt_workers, signal_workers
from nav_msgs.srv import GetPlan
from ros_harness import pose, risk_grid, stage, wait_until

from ambush_planner.worker.process import WorkerProcess

# The paper's simplex method needs minutes for 40 000 nodes.
SLOW = {'strategy.solver': 'simplex', 'network.spacing': 0.5}
QUICK = {'strategy.solver': 'max_entropy', 'network.spacing': 5.0}
START, GOAL, NORTH = pose(5.0, 50.0), pose(95.0, 50.0), pose(95.0, 80.0)


def field(seed=1):
    """A map of 100 m x 100 m without obstacles."""
    return risk_grid(np.random.default_rng(seed).integers(0, 60, (200, 200), dtype=np.int8))


@contextmanager
def solving(parameters=SLOW, halted=True):
    """A node in the middle of a long solve, and the future of the answer that waits for it.

    The worker is halted if ``halted``, to save processor time.
    """
    with stage(parameters=QUICK) as running:
        running.give(field(), (5.0, 50.0), (95.0, 50.0))
        assert running.client.call('new_route').success
        # Wait for all output of the first solve.
        running.client.diagnostics(departures='1', state='ready')
        running.use(parameters)
        begun, solve = threading.Event(), WorkerProcess.solve
        with mock.patch.object(
                WorkerProcess, 'solve', lambda *given: (begun.set(), solve(*given))[1]):
            future = running.client.send('new_route')
            # The diagnostics report a solve before a worker has it.
            wait_until(begun.is_set, 'a worker to begin')
        if halted:
            halt_workers()
            running.client.diagnostics(state='solving')
        yield running, future


def kill_workers():
    signal_workers(signal.SIGKILL)


def answer(future):
    wait_until(future.done, 'the answer')
    return future.result()


def test_everything_else_answers_during_a_solve(submitted):
    with solving(halted=False) as (running, future):
        client, before = running.client, len(submitted)
        waiting = [future, *(client.send('new_route') for _ in range(20))]
        wait_until(lambda: len(submitted) == before + 20, 'the requests')
        client.publish('alpha_map', risk_grid(np.array([[101]])))
        client.diagnostics(code='INVALID_MAP', state='solving')
        running.use(QUICK)
        assert client.get_plan(START, GOAL).poses, 'its strategy is cached'
        client.diagnostics(departures='2', state='solving')
        assert not any(each.done() for each in waiting)
        assert client.call('cancel').success
        assert {answer(each).message for each in waiting} == {'the request was cancelled'}
        client.diagnostics(code='CANCELLED', state='ready')


def test_starts_that_differ_little_share_a_solve():
    with stage(parameters=QUICK) as running:
        client = running.give(field(), (5.0, 50.0), (95.0, 50.0))
        starts = [pose(5.0 + jitter, 50.0) for jitter in (0.0, 0.0001, 0.3, 2.4)]
        futures = [client.send('get_plan', GetPlan.Request(start=each, goal=GOAL))
                   for each in starts]
        paths = [answer(each).plan for each in futures]
        assert [path.poses[0].pose for path in paths] == [each.pose for each in starts]
        assert client.get_plan(pose(5.0, 52.6), GOAL).poses, 'more than half the spacing'
        client.last('edge_probabilities', 2)
        assert client.get_plan(starts[0], GOAL).poses
        assert len(client.received['edge_probabilities']) == 3, 'one for each change of the plan'


def test_a_queued_request_keeps_the_goal_at_the_time_of_the_request(submitted):
    with solving() as (running, future):
        client, before = running.client, len(submitted)
        running.use({**QUICK, 'network.spacing': 4.0})
        queued = client.send('new_route')
        wait_until(lambda: len(submitted) == before + 1, 'the request')
        client.publish('goal_pose', NORTH)
        client.publish('alpha_map', field(2))
        kill_workers()
        assert not answer(future).success
        assert answer(queued).success
        assert client.last('path', 2).poses[-1].pose.position.y == GOAL.pose.position.y
        client.call_until('new_route', lambda _: client.last('path').poses[-1].pose == NORTH.pose)


def test_a_killed_worker_fails_the_request_and_is_replaced():
    with solving() as (running, future):
        client = running.client
        kill_workers()
        assert 'the worker process was killed' in answer(future).message
        client.diagnostics(code='WORKER_FAILED', level=b'\2', state='ready')
        running.use({**QUICK, 'network.spacing': 4.0})
        assert client.call('new_route').success
