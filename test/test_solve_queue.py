"""Solves in a real worker process: shared, queued, cancelled, timed out, killed."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from waiting import TIMEOUT, wait_until

from ambush_planner.core.construction import NetworkOptions
from ambush_planner.core.errors import GoalBlocked, TimeLimit
from ambush_planner.core.planner import PlanningOptions, PlanRequest, plan_from_request
from ambush_planner.core.risk_map import OccupancyOptions
from ambush_planner.core.strategy import StrategyOptions
from ambush_planner.worker.errors import SolveCancelled, Unexpected, WorkerFailed
from ambush_planner.worker.process import WorkerProcess
from ambush_planner.worker.solve_queue import SolveQueue


def request(goal=(18.5, 10.5), values=None, **strategy):
    """A small game: solved in some ten milliseconds."""
    if values is None:
        values = np.random.default_rng(1).integers(0, 60, (20, 20), dtype=np.int8)
    options = PlanningOptions(NetworkOptions(spacing=1.0), strategy=StrategyOptions(**strategy))
    return PlanRequest(
        values, 1.0, (0.0, 0.0, 0.0), OccupancyOptions(), (1.5, 10.5), goal, 0.0, options
    )


def slow_request(time_limit=600.0):
    """A game that takes the paper's simplex method minutes."""
    values = np.random.default_rng(2).integers(0, 60, (200, 200), dtype=np.int8)
    return replace(
        request((198.5, 100.5), values, solver='simplex', time_limit=time_limit),
        start_xy=(1.5, 100.5),
    )


@pytest.fixture
def queue():
    queue = SolveQueue()
    yield queue
    queue.close()


def workers():
    """Process ids of the worker processes that this process has started."""
    found = []
    for folder in Path('/proc').glob('[0-9]*'):
        try:
            parent = int((folder / 'stat').read_text().rsplit(')', 1)[1].split()[1])
            command = (folder / 'cmdline').read_bytes()
        except OSError:
            continue
        if parent == os.getpid() and b'ambush_planner.worker' in command:
            found.append(int(folder.name))
    return found


def begun(queue):
    """Wait until the worker has been busy with a solve for a while."""
    def worked():
        try:
            return sum(cpu_seconds(pid) for pid in workers()) > 1.5
        except OSError:
            return False

    wait_until(lambda: queue.busy, 'a solve')
    wait_until(worked, 'the worker to work')


def cpu_seconds(pid):
    ticks = Path(f'/proc/{pid}/stat').read_text().rsplit(')', 1)[1].split()[11:13]
    return sum(map(int, ticks)) / os.sysconf('SC_CLK_TCK')


def test_the_worker_finds_what_this_process_would(queue):
    asked = request()
    ours, theirs = plan_from_request(asked), queue.submit('key', asked).result(TIMEOUT)
    for name in ('edge_probability', 'ambush_probability', 'visit_probability'):
        np.testing.assert_array_equal(
            getattr(theirs.strategy, name), getattr(ours.strategy, name))
    np.testing.assert_array_equal(theirs.network.points, ours.network.points)
    assert theirs.strategy.value == ours.strategy.value
    assert (theirs.spacing, theirs.goal_xy) == (ours.spacing, ours.goal_xy)
    assert not theirs.strategy.edge_probability.flags.writeable, 'records stay frozen on the way'
    np.testing.assert_array_equal(
        theirs.strategy.sample_route(np.random.default_rng(5)),
        ours.strategy.sample_route(np.random.default_rng(5)))


def test_errors_of_the_planner_come_through(queue):
    values = np.zeros((20, 20), dtype=np.int8)
    values[10, 18] = 100
    with pytest.raises(GoalBlocked, match=r'goal \(18.500, 10.500\) lies in an obstacle'):
        queue.submit('key', request(values=values)).result(TIMEOUT)
    assert queue.submit('key', request()).result(TIMEOUT), 'the same worker goes on'


def test_an_error_that_the_planner_does_not_know_tells_where_but_no_values(queue):
    odd = replace(request(), start_xy='nowhere near')
    with pytest.raises(Unexpected) as caught:
        queue.submit('key', odd).result(TIMEOUT)
    assert str(caught.value).startswith('internal error (')
    assert 'plan_from_request' in caught.value.frames
    assert 'nowhere' not in str(caught.value) + caught.value.frames


def test_a_goal_is_moved_within_its_tolerance(queue):
    values = np.zeros((20, 20), dtype=np.int8)
    values[10, 18] = 100
    moved = replace(request(values=values), goal_tolerance=1.5)
    assert queue.submit('key', moved).result(TIMEOUT).goal_xy in {
        (17.5, 10.5), (18.5, 9.5), (18.5, 11.5), (19.5, 10.5)}


def test_equal_solves_are_shared_and_others_wait_their_turn(queue):
    first = queue.submit('slow', slow_request())
    assert queue.submit('slow', slow_request()) is first
    other = queue.submit('other', request())
    assert queue.submit('other', request()) is other
    begun(queue)
    assert queue.submit('slow', slow_request()) is first, 'also when it runs'
    assert not other.done()
    assert queue.cancel()
    assert other.result(TIMEOUT)
    with pytest.raises(SolveCancelled):
        first.result(TIMEOUT)


def test_cancel_ends_a_solve_of_minutes_and_the_next_one_works(queue):
    future = queue.submit('slow', slow_request())
    begun(queue)
    assert queue.cancel()
    with pytest.raises(SolveCancelled, match='the solve was cancelled'):
        future.result(TIMEOUT)
    wait_until(lambda: not queue.cancel(), 'no solve to cancel')
    assert queue.submit('key', request()).result(TIMEOUT)


def test_cancel_before_the_worker_has_started():
    queue = SolveQueue()
    try:
        future = queue.submit('slow', slow_request())
        assert queue.cancel()
        with pytest.raises(SolveCancelled):
            future.result(TIMEOUT)
        assert queue.submit('key', request()).result(TIMEOUT)
    finally:
        queue.close()


def test_what_was_submitted_can_be_cancelled_at_once(queue):
    for attempt in range(8):
        first, second = queue.submit('first', slow_request()), queue.submit('second', request())
        assert queue.cancel(), attempt
        with pytest.raises(SolveCancelled):
            first.result(TIMEOUT)
        assert second.result(TIMEOUT), 'who waits behind it goes on'


def test_the_time_limit_is_hard(queue):
    queue.submit('key', request()).result(TIMEOUT)  # the worker has started
    begin = time.monotonic()
    with pytest.raises(TimeLimit, match='no plan after max_planning_time, 0.7 s'):
        queue.submit('slow', slow_request(0.7)).result(TIMEOUT)
    assert time.monotonic() - begin >= 0.7
    assert queue.submit('key', request()).result(TIMEOUT)


def test_the_time_limit_holds_for_a_worker_that_reads_nothing(queue):
    queue.submit('key', request()).result(TIMEOUT)
    (pid,) = workers()
    os.kill(pid, signal.SIGSTOP)
    large = np.zeros((2000, 2000), dtype=np.int8)  # more than the pipe holds
    with pytest.raises(TimeLimit):
        queue.submit('large', request(values=large, time_limit=0.7)).result(TIMEOUT)
    assert queue.submit('key', request()).result(TIMEOUT)


def test_an_error_on_this_side_is_answered_too(queue, monkeypatch):
    def broken(*_):
        raise MemoryError

    with monkeypatch.context() as patch:
        patch.setattr(WorkerProcess, 'solve', broken)
        with pytest.raises(Unexpected, match='MemoryError'):
            queue.submit('key', request()).result(TIMEOUT)
    assert queue.submit('key', request()).result(TIMEOUT)


def test_a_worker_that_is_killed_is_an_error_and_a_new_worker(queue):
    future = queue.submit('slow', slow_request())
    begun(queue)
    (pid,) = workers()
    os.kill(pid, signal.SIGKILL)
    with pytest.raises(WorkerFailed, match='the worker process ended by signal 9'):
        future.result(TIMEOUT)
    assert queue.submit('key', request()).result(TIMEOUT)
    assert pid not in workers()


def test_a_worker_that_died_while_idle_is_not_missed(queue):
    queue.submit('key', request()).result(TIMEOUT)
    (pid,) = workers()
    os.kill(pid, signal.SIGKILL)
    wait_until(lambda: _is_zombie(pid), 'the end of the worker')
    assert queue.submit('key', request()).result(TIMEOUT)


def test_close_ends_everything_at_once():
    queue = SolveQueue()
    running, waiting = queue.submit('slow', slow_request()), queue.submit('key', request())
    begun(queue)
    queue.close()
    for future in (running, waiting):
        with pytest.raises(SolveCancelled, match='shutting down'):
            future.result(0)
    assert workers() == []
    with pytest.raises(SolveCancelled, match='shutting down'):
        queue.submit('key', request())


ORPHAN = """
import sys
from test_solve_queue import begun, slow_request, workers
from ambush_planner.worker.process import WorkerProcess
from ambush_planner.worker.solve_queue import SolveQueue
queue = SolveQueue()
queue.submit('slow', slow_request())
begun(queue)
print(*workers(), flush=True)
sys.stdin.read()
"""


def test_no_orphan_is_left_when_the_owner_is_killed_in_the_middle_of_a_solve():
    with subprocess.Popen(
        [sys.executable, '-c', ORPHAN], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        env={**os.environ, 'PYTHONPATH': os.pathsep.join(sys.path)},
    ) as owner:
        pid = int(owner.stdout.readline())
        assert Path(f'/proc/{pid}').exists()
        owner.kill()
    wait_until(lambda: _is_zombie(pid), 'the end of the worker')


def _is_zombie(pid):
    # Or gone altogether: who waits for it is not this process's matter.
    try:
        return Path(f'/proc/{pid}/stat').read_text().rsplit(')', 1)[1].split()[0] == 'Z'
    except OSError:
        return True
