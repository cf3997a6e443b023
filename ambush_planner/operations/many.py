# SPDX-License-Identifier: Apache-2.0
"""Many games at once, on any ``concurrent.futures.Executor``: threads, processes, a cluster."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Executor, Future, wait
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import Any

from ..errors import InvalidOption, warn
from ..maps.risk_map import RiskMap
from ..planning.concerns import concerns
from ..planning.options import PlanningOptions
from ..planning.plan import Plan
from ..planning.trip import plan_quietly


@dataclass(frozen=True, eq=False)
class Problem:
    """A map, a start, a goal and stops (x, y) [m], and options, as ``plan_trip`` takes them."""

    risk_map: RiskMap
    start_xy: tuple[float, float]
    goal_xy: tuple[float, float]
    options: PlanningOptions = field(default_factory=PlanningOptions)
    stops: Sequence[tuple[float, float]] = ()


@dataclass(frozen=True, eq=False)
class Solved:
    """The answer to the problem at ``index``, or its error."""

    index: int
    answer: Any = None
    error: BaseException | None = None


def solve_many(problems: Iterable[Problem], executor: Executor, *,
               answer: Callable[[Plan], Any] | None = None,
               on_result: Callable[[Solved], None] | None = None,
               in_flight: int = 0) -> list[Solved]:
    """Solve problems in parallel, as ``plan_trip`` does; the results have the problems' order.

    An error replaces only its own result. If the executor breaks (a process of a pool was killed),
    the unsolved problems get its error.

    Parameters
    ----------
    problems
        Consumed as capacity becomes free.
    answer
        Applied to each plan where it was made, so that only the answer is sent back (by default
        the plan). It must be picklable: a function of a module, not a lambda.
    on_result
        Called in this thread with each result as it comes, in any order. If it raises, the pending
        problems are cancelled.
    in_flight
        Number of problems that the executor holds at once, at least its number of workers; 0:
        twice the number of processors.

    Raises
    ------
    InvalidOption
        ``in_flight`` is negative.

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
    if in_flight < 0:
        raise InvalidOption(f'in_flight must be >= 0, got {in_flight}')
    capacity = in_flight or 2 * (os.cpu_count() or 1)
    results: dict[int, Solved] = {}
    pending: dict[Future[Any], tuple[int, Problem]] = {}
    waiting = iter(enumerate(problems))

    def send(index: int, problem: Problem) -> None:
        try:
            future = executor.submit(_solve, problem, answer)
        except Exception as error:  # the pool broke or was shut down
            future = Future()
            future.set_exception(error)
        pending[future] = index, problem

    try:
        while True:
            for index, problem in islice(waiting, capacity - len(pending)):
                send(index, problem)
            if not pending:
                break
            done, _ = wait(pending, return_when=FIRST_COMPLETED)
            for future in done:
                index, problem = pending.pop(future)
                error: BaseException | None = (
                    CancelledError() if future.cancelled() else future.exception())
                found = None if error else future.result()
                if isinstance(found, Plan):  # which was sent without its map
                    found = replace(found, risk_map=problem.risk_map)
                    for text in concerns(found):
                        warn(f'problem {index}: {text}')
                results[index] = Solved(index, found, error)
                if on_result is not None:
                    on_result(results[index])
    finally:
        for future in pending:
            future.cancel()
    return [results[index] for index in sorted(results)]


def _solve(problem: Problem, answer: Callable[[Plan], Any] | None) -> Any:
    """Solve one problem in the executor's process."""
    plan = plan_quietly(problem.risk_map, problem.start_xy, problem.goal_xy, problem.options,
                        list(problem.stops))
    return replace(plan, risk_map=None) if answer is None else answer(plan)
