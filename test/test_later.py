"""Work that goes on when something else is done: whoever waits is told, whatever happens."""

import gc
import weakref
from concurrent.futures import Future, ThreadPoolExecutor

import pytest

from ambush_planner.ros.later import then


def finished(result):
    first = Future()
    first.set_result(result)
    return first


def double(first):
    return 2 * first.result()


def test_the_work_has_what_came_first():
    with ThreadPoolExecutor(1) as executor:
        assert then(finished(4), double, executor.submit).result(5.0) == 8


def test_an_error_before_it_and_in_it_is_the_outcome():
    failed = Future()
    failed.set_exception(KeyError('first'))
    with ThreadPoolExecutor(1) as executor:
        with pytest.raises(KeyError):
            then(failed, double, executor.submit).result(5.0)
        with pytest.raises(TypeError):
            then(finished(None), double, executor.submit).result(5.0)


def test_nobody_waits_for_an_executor_that_has_ended():
    executor = ThreadPoolExecutor(1)
    executor.shutdown()
    with pytest.raises(RuntimeError, match='after shutdown'):
        then(finished(4), double, executor.submit).result(5.0)


def test_nothing_waits_for_the_garbage_collector():
    gc.disable()
    try:
        first = Future()
        with ThreadPoolExecutor(1) as executor:
            outcome = then(first, double, executor.submit)
            first.set_result(4)
            assert outcome.result(5.0) == 8
        gone = weakref.ref(first)
        del first
        assert gone() is None
    finally:
        gc.enable()
