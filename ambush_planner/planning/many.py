"""Many games at once, on any ``concurrent.futures.Executor``: threads, processes, a cluster.

Problems carry their map compressed, and processes keep the last ones: many problems share a map.
"""

from __future__ import annotations

import os
import pickle
import zlib
from collections.abc import Callable, Iterable
from concurrent.futures import FIRST_COMPLETED, CancelledError, Executor, Future, wait
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import islice
from typing import Any

from ..errors import InvalidOption
from ..game.game import GameOptions
from ..game.strategy import Strategy, StrategyOptions, solve
from ..maps.risk_map import RiskMap
from ..network.construction import NetworkOptions, build_network

# Number of maps that a process keeps.
_KEPT_MAPS = 4


@dataclass(frozen=True, eq=False)
class Problem:
    """A map, a start and a goal (x, y) [m], and the options."""

    risk_map: RiskMap
    start_xy: tuple[float, float]
    goal_xy: tuple[float, float]
    network: NetworkOptions = field(default_factory=NetworkOptions)
    game: GameOptions = field(default_factory=GameOptions)
    strategy: StrategyOptions = field(default_factory=StrategyOptions)


@dataclass(frozen=True, eq=False)
class Solved:
    """The answer to the problem at ``index``, or its error."""

    index: int
    answer: Any = None
    error: BaseException | None = None


def solve_many(
    problems: Iterable[Problem],
    executor: Executor,
    *,
    answer: Callable[[Strategy], Any] | None = None,
    on_result: Callable[[Solved], None] | None = None,
    in_flight: int = 0,
) -> list[Solved]:
    """Solve problems in parallel; the results have the problems' order.

    An error replaces only its own result. If the executor breaks (a process of a pool was killed),
    the unsolved problems get its error.

    Parameters
    ----------
    problems
        Consumed as capacity becomes free. Share ``RiskMap`` objects, so that each is packed once.
    answer
        Applied to each strategy where it was solved, so that only the answer is sent back (by
        default the strategy). It must be picklable: a function of a module, not a lambda.
    on_result
        Called in this thread with each result as it comes, in any order. If it raises, the pending
        problems are cancelled.
    in_flight
        Number of problems that the executor holds at once, at least its number of workers; 0:
        twice the number of processors. Raises InvalidOption if negative.
    """
    if in_flight < 0:
        raise InvalidOption(f'in_flight must be >= 0, got {in_flight}')
    capacity = in_flight or 2 * (os.cpu_count() or 1)
    results: dict[int, Solved] = {}
    pending: dict[Future[Any], int] = {}
    packed: dict[RiskMap, bytes] = {}
    waiting = iter(enumerate(problems))
    try:
        while True:
            for index, problem in islice(waiting, capacity - len(pending)):
                pending[_submit(executor, problem, packed, answer)] = index
            if not pending:
                break
            done, _ = wait(pending, return_when=FIRST_COMPLETED)
            for future in done:
                index = pending.pop(future)
                error = _error_of(future)
                results[index] = Solved(index, None if error else future.result(), error)
                if on_result is not None:
                    on_result(results[index])
    finally:
        for future in pending:
            future.cancel()
    return [results[index] for index in sorted(results)]


def _submit(
    executor: Executor,
    problem: Problem,
    packed: dict[RiskMap, bytes],
    answer: Callable[[Strategy], Any] | None,
) -> Future[Any]:
    risk_map = problem.risk_map
    if risk_map not in packed:
        packed[risk_map] = zlib.compress(pickle.dumps(risk_map, pickle.HIGHEST_PROTOCOL), 1)
    rest = (problem.start_xy, problem.goal_xy, problem.network, problem.game, problem.strategy)
    try:
        return executor.submit(_solve, packed[risk_map], rest, answer)
    except Exception as error:  # the pool broke or was shut down
        failed: Future[Any] = Future()
        failed.set_exception(error)
        return failed


def _error_of(future: Future[Any]) -> BaseException | None:
    try:
        return future.exception()
    except CancelledError as error:
        return error


def _solve(
    content: bytes, rest: tuple[Any, ...], answer: Callable[[Strategy], Any] | None
) -> Any:
    """Solve one problem in the executor's process."""
    start_xy, goal_xy, network_options, game, options = rest
    network = build_network(_unpacked_map(content), start_xy, goal_xy, network_options)
    strategy = solve(network, game, options)
    return strategy if answer is None else answer(strategy)


@lru_cache(_KEPT_MAPS)
def _unpacked_map(content: bytes) -> RiskMap:
    risk_map: RiskMap = pickle.loads(zlib.decompress(content))
    return risk_map
