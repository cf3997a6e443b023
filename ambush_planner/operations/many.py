# SPDX-License-Identifier: Apache-2.0
"""Many plans at once, on any ``concurrent.futures.Executor``: threads, processes, a cluster."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from concurrent.futures import CancelledError, Executor, Future
from dataclasses import dataclass, field, replace

from ..errors import warn
from ..maps.risk_map import RiskMap
from ..planning.concerns import concerns
from ..planning.options import PlanningOptions
from ..planning.plan import Plan
from ..planning.trip import plan_quietly


@dataclass(frozen=True, eq=False)
class Problem:
    """Arguments of ``plan_trip``: a map, positions (x, y) of start, goal and stops [m], options."""

    risk_map: RiskMap
    start_xy: tuple[float, float]
    goal_xy: tuple[float, float]
    options: PlanningOptions = field(default_factory=PlanningOptions)
    stops: Sequence[tuple[float, float]] = ()


@dataclass(frozen=True, eq=False)
class Solved:
    """The plan of the problem at ``index``, or its error."""

    index: int
    answer: Plan | None = None
    error: BaseException | None = None


def solve_many(problems: Iterable[Problem], executor: Executor) -> list[Solved]:
    """Solve problems in parallel by ``plan_trip``; the results have the order of the problems.

    An error replaces only its own result. If the executor breaks, as when a process of a pool is
    killed, the unsolved problems get its error.

    Examples
    --------
    >>> from concurrent.futures import ThreadPoolExecutor
    >>> import numpy as np
    >>> from ambush_planner import Problem, RiskMap, solve_many
    >>> risk_map = RiskMap(np.ones((6, 12)), np.zeros((6, 12), bool), resolution=1.0)
    >>> problems = [Problem(risk_map, (1.0, 3.0), (11.0, y)) for y in (1.0, 5.0)]
    >>> with ThreadPoolExecutor() as pool:
    ...     results = solve_many(problems, pool)
    >>> [result.error for result in results]
    [None, None]
    """
    pending = [(problem, _submit(problem, executor)) for problem in problems]
    try:
        return [_result(index, *each) for index, each in enumerate(pending)]
    finally:
        for _, future in pending:
            future.cancel()


def _submit(problem: Problem, executor: Executor) -> Future[Plan]:
    try:
        return executor.submit(_solve, problem)
    except RuntimeError as error:  # the pool broke or was shut down
        future: Future[Plan] = Future()
        future.set_exception(error)
        return future


def _result(index: int, problem: Problem, future: Future[Plan]) -> Solved:
    """Wait for a result, and warn of the plan's concerns."""
    try:
        error = future.exception()
    except CancelledError as cancelled:
        error = cancelled
    if error is not None:
        return Solved(index, None, error)
    plan = replace(future.result(), risk_map=problem.risk_map)  # it was sent without its map
    for text in concerns(plan):
        warn(f'problem {index}: {text}')
    return Solved(index, plan)


def _solve(problem: Problem) -> Plan:
    """Solve one problem in the executor's process."""
    return replace(plan_quietly(problem.risk_map, problem.start_xy, problem.goal_xy,
                                problem.options, list(problem.stops)), risk_map=None)
