# SPDX-License-Identifier: Apache-2.0
"""SerialExecutor: an error of any work reaches somebody, and so does the end."""

from concurrent.futures import Future

import pytest

from ambush_planner.ros.serial_executor import SerialExecutor
from ambush_planner.worker.solve_errors import SolveCancelled


@pytest.fixture
def errors():
    return []


@pytest.fixture
def executor(errors):
    made = SerialExecutor('work', errors.append)
    yield made
    made.close()


def test_an_error_goes_to_the_future_or_is_reported(executor, errors):
    future = Future()
    executor.submit(lambda: 1 / 0, future)
    executor.submit(lambda: 1 / 0)
    executor.finish()
    assert isinstance(future.exception(0.0), ZeroDivisionError)
    assert [type(each) for each in errors] == [ZeroDivisionError]


def test_work_is_refused_after_the_end_and_a_cancelled_future_stays_cancelled(executor, errors):
    future, cancelled = Future(), Future()
    cancelled.cancel()
    executor.submit(lambda: 1 / 0, cancelled)
    executor.close()
    executor.submit(lambda: None, future)
    assert isinstance(future.exception(0.0), SolveCancelled)
    assert cancelled.cancelled() and not errors
