# SPDX-License-Identifier: Apache-2.0
"""Solves in a real worker process: queued behind others, overtaken, withdrawn, killed."""

import math
import os
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from handed_on import HandedOn, halt_workers, process_id
from waiting import TIMEOUT, wait_until

from ambush_planner.errors import TimeLimit
from ambush_planner.game.strategy import StrategyOptions
from ambush_planner.maps.occupancy import OccupancyMap, OccupancyOptions
from ambush_planner.network.construction import NetworkOptions
from ambush_planner.planning.options import PlanningOptions
from ambush_planner.planning.plan import PlanRequest
from ambush_planner.planning.trip import plan_from_request
from ambush_planner.worker import process, solve_queue
from ambush_planner.worker.process import WorkerParent, WorkerProcess
from ambush_planner.worker.solve_errors import SolveCancelled, Unexpected, WorkerFailed
from ambush_planner.worker.solve_queue import SolveQueue


def request(goal=(18.5, 10.5), values=None, **strategy):
    """A small game, solved in about ten milliseconds."""
    if values is None:
        values = np.random.default_rng(1).integers(0, 60, (20, 20), dtype=np.int8)
    options = PlanningOptions(network=NetworkOptions(spacing=1.0),
                              strategy=StrategyOptions(**strategy))
    return PlanRequest(OccupancyMap(values, 1.0), OccupancyOptions(), (1.5, 10.5), goal, 0.0,
                       options)


def slow_request(time_limit=600.0):
    """A game that takes the simplex method minutes."""
    values = np.random.default_rng(2).integers(0, 60, (200, 200), dtype=np.int8)
    return replace(
        request((198.5, 100.5), values, solver='simplex', time_limit=time_limit),
        start_xy=(1.5, 100.5),
    )


def submit(queue, key, asked, background=False):
    """Queue a solve whose outcome is the plan."""
    return queue.submit(key, asked, lambda plan: plan, background)


def test_a_worker_that_cannot_be_forked_is_not_said_to_have_been_killed():
    class NoRoom(WorkerParent):
        def fork(self, connection):
            """As when the system allows no more processes."""

    with (closing(WorkerProcess(NoRoom())) as worker,
          pytest.raises(WorkerFailed, match='could not be started; check the limits')):
        worker.solve(request())


@pytest.fixture
def queue(monkeypatch):
    """A queue whose worker may be one that an earlier test left idle."""
    monkeypatch.setattr(solve_queue, 'WorkerProcess', HandedOn.take)
    queue = SolveQueue(lambda: None)
    yield queue
    queue.close()


def begun(queue):
    """Wait until a ready worker has been given a solve, and halt it."""
    wait_until(lambda: queue._running and queue._worker and queue._worker._pidfd, 'a solve')
    halt_workers()


def test_the_worker_finds_the_same_plan_as_this_process(queue):
    asked = request()
    ours, theirs = plan_from_request(asked), submit(queue, 'key', asked).result(TIMEOUT)
    for name in ('edge_probability', 'ambush_probability', 'visit_probability'):
        np.testing.assert_array_equal(getattr(theirs.strategy, name), getattr(ours.strategy, name))
    np.testing.assert_array_equal(theirs.network.points, ours.network.points)
    assert theirs.strategy.value == ours.strategy.value
    assert not theirs.strategy.edge_probability.flags.writeable, 'arrays stay read-only'


def test_an_internal_error_has_frames_but_no_values(queue):
    odd = replace(request(), grid=OccupancyMap(np.zeros((2, 2), np.int8), 'nowhere near'))
    with pytest.raises(Unexpected) as caught:
        submit(queue, 'key', odd).result(TIMEOUT)
    assert str(caught.value).startswith('internal error (')
    assert 'plan_from_request' in caught.value.frames
    assert 'nowhere' not in str(caught.value) + caught.value.frames


def test_a_background_solve_runs_last_and_gives_way_to_the_next_solve(queue, monkeypatch):
    monkeypatch.setattr(solve_queue, '_MAX_WAITING', 1)
    submit(queue, 'slow', slow_request())
    begun(queue)
    first, last = (submit(queue, k, request(), background=True) for k in ('first', 'last'))
    with pytest.raises(SolveCancelled, match='a newer solve'):
        first.result(0.0)
    asked = submit(queue, 'asked', request())
    with pytest.raises(SolveCancelled, match='a newer solve'):
        last.result(0.0)
    os.kill(process_id(queue._worker), signal.SIGKILL)
    assert asked.result(TIMEOUT)


def test_a_request_overtakes_a_running_background_solve(queue):
    background = submit(queue, 'background', slow_request(), background=True)
    begun(queue)
    assert submit(queue, 'asked', request()).result(TIMEOUT), 'long before the other one'
    with pytest.raises(SolveCancelled, match='a newer solve'):
        background.result(0.0)
    shared = submit(queue, 'shared', slow_request(), background=True)
    begun(queue)
    assert submit(queue, 'shared', slow_request()) is shared, 'a request for the same plan'
    queue.cancel('enough')
    with pytest.raises(SolveCancelled, match='enough'):
        shared.result(TIMEOUT)


def test_a_first_plan_is_the_outcome_and_a_request_overtakes_its_refinement(queue):
    quick, plans = request(), []

    def ask(last):
        return queue.submit('trip', replace(last, first=quick.options), plans.append)

    ask(quick).result(TIMEOUT)
    wait_until(lambda: len(plans) == 2, 'both plans')
    assert plans[0].value == plans[1].value
    wait_until(lambda: queue.activity == (False, False), 'the end')
    queue._report = reported = Mock()
    ask(replace(quick, options=replace(quick.options, network=NetworkOptions(spacing=1e-3)))
        ).result(TIMEOUT)
    wait_until(lambda: reported.called, 'why there is no refined plan')
    outcome = ask(slow_request())
    assert outcome.result(TIMEOUT) is None and len(plans) == 4
    wait_until(lambda: queue.activity == (False, True), 'the refinement')
    assert not queue.keys, 'nobody is to wait for it'
    assert queue.submit('trip', quick, plans.append, background=True) is outcome
    queue.withdraw(outcome)
    assert queue.activity == (False, True)
    assert submit(queue, 'trip', quick).result(TIMEOUT) is not outcome.result()


def test_a_worker_that_refines_has_low_priority_and_solves_nothing_else():
    quick, own = request(), os.getpriority(os.PRIO_PROCESS, 0)
    worker = HandedOn.take(None)
    assert worker.solve(replace(quick, first=quick.options)).value == worker.next_plan(quick).value
    assert not worker.alive
    worker.close()
    worker, asked = HandedOn.take(None), replace(slow_request(), first=quick.options)
    worker.solve(asked)
    with ThreadPoolExecutor(1) as thread:
        solve = thread.submit(worker.next_plan, asked)
        wait_until(lambda: os.getpriority(os.PRIO_PROCESS, process_id(worker)) > own, 'nice')
        worker.kill()
    worker.close()
    assert isinstance(solve.exception(), WorkerFailed)


def test_a_worker_that_overruns_the_time_limit_is_killed(monkeypatch):
    worker = HandedOn.take(None)
    worker.solve(request(time_limit=math.inf))
    monkeypatch.setattr(process, '_GRACE', 0.001)
    monkeypatch.setattr(process, '_MARGIN', 0.0)
    with pytest.raises(TimeLimit, match='no plan after max_planning_time, 600 s'):
        worker.solve(slow_request())
    assert not worker.alive
    worker.close()


def test_a_solve_ends_when_the_last_request_for_it_is_withdrawn(queue):
    submit(queue, 'slow', slow_request())
    begun(queue)
    one, other = (submit(queue, 'asked', request()) for _ in range(2))
    queue.withdraw(one)
    assert not other.done()
    queue.withdraw(other)
    with pytest.raises(SolveCancelled, match='all callers'):
        other.result(0.0)


def test_an_idle_worker_that_dies_is_replaced_before_the_next_solve(queue):
    submit(queue, 'first', request()).result(TIMEOUT)
    used = queue._worker
    os.kill(process_id(used), signal.SIGKILL)
    wait_until(lambda: not used.alive, 'the end of the worker')
    assert submit(queue, 'next', request()).result(TIMEOUT)
    assert queue._worker is not used


def test_solves_are_refused_by_a_closed_gate_and_after_the_end(queue):
    queue._check = Mock(side_effect=SolveCancelled('not now'))
    with pytest.raises(SolveCancelled, match='not now'):
        submit(queue, 'refused', request(), background=True)
    queue._check = lambda: None
    solves = [submit(queue, name, slow_request()) for name in ('runs', 'waits')]
    queue.close()
    assert {str(each.exception(TIMEOUT)) for each in solves} == {'the planner is shutting down'}
    with pytest.raises(SolveCancelled, match='shutting down'):
        submit(queue, 'late', request())


ORPHAN = """
import sys
from handed_on import process_id
from test_solve_queue import begun, slow_request, submit
from ambush_planner.worker.solve_queue import SolveQueue
queue = SolveQueue(lambda: None)
submit(queue, 'slow', slow_request())
begun(queue)
print(process_id(queue._worker), flush=True)
sys.stdin.read()
"""


def test_the_worker_dies_when_its_owner_is_killed_during_a_solve():
    with subprocess.Popen(
        [sys.executable, '-c', ORPHAN], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        env={**os.environ, 'PYTHONPATH': os.pathsep.join(sys.path)},
    ) as owner:
        pid = int(owner.stdout.readline())
        assert Path(f'/proc/{pid}').exists()
        owner.kill()
    wait_until(lambda: _is_zombie(pid), 'the end of the worker')


def _is_zombie(pid):
    # Or gone altogether.
    try:
        return Path(f'/proc/{pid}/stat').read_text().rsplit(')', 1)[1].split()[0] == 'Z'
    except OSError:
        return True
