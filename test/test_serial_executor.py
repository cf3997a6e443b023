# SPDX-License-Identifier: Apache-2.0
"""SerialExecutor: order, one thread, and errors that reach somebody."""

import threading
from concurrent.futures import Future

import pytest

from ambush_planner.worker.serial_executor import SerialExecutor, completed, started


class Closed(Exception):
    pass


@pytest.fixture
def errors():
    return []


@pytest.fixture
def executor(errors):
    made = SerialExecutor('work', lambda: None, errors.append, Closed)
    yield made
    made.close()


def test_a_future_of_work_that_does_not_start_has_its_error():
    assert started(lambda: completed(8)).result(0.0) == 8
    with pytest.raises(ZeroDivisionError):
        started(lambda: 1 / 0).result(0.0)


def test_work_is_done_in_order_by_one_thread(executor):
    done = []
    for k in range(20):
        executor.submit(lambda k=k: done.append((k, threading.current_thread().name)))
    executor.finish()
    assert [k for k, _ in done] == list(range(20))
    assert len({name for _, name in done}) == 1


def test_an_error_goes_to_the_future_or_is_reported(executor, errors):
    future = Future()
    executor.submit(lambda: 1 / 0, future)
    executor.submit(lambda: 1 / 0)
    executor.finish()
    assert isinstance(future.exception(0.0), ZeroDivisionError)
    assert [type(each) for each in errors] == [ZeroDivisionError]


def test_an_error_before_the_work_goes_to_the_future(errors):
    executor, future = SerialExecutor('work', lambda: 1 / 0, errors.append, Closed), Future()
    executor.submit(lambda: future.set_result(1), future)
    executor.close()
    assert isinstance(future.exception(0.0), ZeroDivisionError)


def test_work_is_refused_after_the_end_and_a_cancelled_future_stays_cancelled(executor, errors):
    future, cancelled = Future(), Future()
    cancelled.cancel()
    executor.submit(lambda: 1 / 0, cancelled)
    executor.close()
    executor.submit(lambda: None, future)
    assert isinstance(future.exception(0.0), Closed)
    assert cancelled.cancelled() and not errors
