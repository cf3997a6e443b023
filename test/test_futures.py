"""Outcomes that come later: whatever happens is told."""

from concurrent.futures import Future

import pytest

from ambush_planner.ros.futures import done, settle


def test_the_outcome_is_what_the_work_returns():
    outcome = Future()
    settle(outcome, lambda: 8)
    assert outcome.result(0.0) == 8


def test_the_outcome_is_what_the_work_raises():
    with pytest.raises(ZeroDivisionError):
        done(lambda: 1 / 0).result(0.0)
