"""Errors in callbacks: each is reported, and repeated ones share a line of the log."""

from rclpy.context import Context
from rclpy.logging import get_logger

from ambush_planner.errors import InvalidOption, InvalidPose
from ambush_planner.ros.error_boundary import ErrorBoundary


def test_repeated_errors_are_reported_each_and_logged_with_their_number(capfd):
    context, reported = Context(), []
    context.init([])
    boundary = ErrorBoundary(context, get_logger('planner'), lambda *each: reported.append(each))

    def fail(kind, text):
        def action():
            raise kind(text)

        result, error = boundary.attempt('get_plan', 'request', action)
        assert result is None and str(error) == text

    def logged():
        return [line.partition('get_plan: ')[2] for line in capfd.readouterr().err.splitlines()]

    try:
        for number in range(30):
            fail(InvalidPose, f'request {number}')
        fail(InvalidOption, 'another kind')
        assert len(reported) == 31 and {concern for concern, _ in reported} == {'request'}
        assert logged() == ['request 0', 'another kind']
        boundary.log_repeated()
        assert logged() == ['request 29 (and 29 more like this)']
        fail(InvalidPose, 'later')
        boundary.log_repeated()
        assert logged() == ['later']
    finally:
        context.shutdown()
