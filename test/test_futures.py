"""Outcomes that come later: whatever happens is told."""

import threading
from concurrent.futures import Future

import pytest

from ambush_planner.ros.serial_executor import SerialExecutor, done


class Ended(Exception):
    pass


@pytest.fixture
def failed():
    return []


@pytest.fixture
def turns(failed):
    made = SerialExecutor('turns', lambda: None, failed.append, lambda: Ended('over'))
    yield made
    made.close()


def test_the_outcome_is_what_the_work_returns():
    assert done(lambda: 8).result(0.0) == 8


def test_the_outcome_is_what_the_work_raises():
    with pytest.raises(ZeroDivisionError):
        done(lambda: 1 / 0).result(0.0)


def test_work_is_done_in_turn_and_by_one_thread(turns):
    found = []
    for k in range(100):
        turns.do(lambda k=k: found.append((k, threading.current_thread().name)))
    turns.finish()
    assert [k for k, _ in found] == list(range(100))
    assert len({name for _, name in found}) == 1


def test_an_error_is_the_outcome_or_told(turns, failed):
    outcome = Future()
    turns.do(lambda: 1 / 0, outcome)
    turns.do(lambda: 1 / 0)
    turns.finish()
    assert isinstance(outcome.exception(0.0), ZeroDivisionError)
    assert [type(each) for each in failed] == [ZeroDivisionError]


def test_so_is_one_of_what_is_done_first(failed):
    turns, outcome = SerialExecutor('turns', lambda: 1 / 0, failed.append, Ended), Future()
    turns.do(lambda: outcome.set_result(1), outcome)
    turns.close()
    assert isinstance(outcome.exception(0.0), ZeroDivisionError)


def test_work_that_comes_too_late_is_refused(turns, failed):
    turns.close()
    outcome = Future()
    turns.do(lambda: None, outcome)
    turns.do(lambda: None)
    assert isinstance(outcome.exception(0.0), Ended)
    assert not failed


@pytest.mark.parametrize('late', [False, True])
def test_an_outcome_that_was_cancelled_stays_it(turns, failed, late):
    outcome = Future()
    outcome.cancel()
    if late:
        turns.close()
    turns.do(lambda: 1 / 0, outcome)
    turns.close()
    assert outcome.cancelled() and not failed
