"""Many games at once, on any ``concurrent.futures.Executor``: threads, processes, a cluster.

A map is much larger than the rest of a problem, and many problems share it. So problems carry only
the map's hash; a process without the map says so and gets the problem again with the map, which it
keeps for the next ones. This needs only the executor's ``submit``.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import threading
import zlib
from collections import OrderedDict, deque
from collections.abc import Callable, Iterable
from concurrent.futures import FIRST_COMPLETED, CancelledError, Executor, Future, wait
from dataclasses import dataclass, field
from typing import Any

from ..errors import InvalidOption
from ..game.game import GameOptions
from ..game.strategy import Strategy, StrategyOptions, solve
from ..maps.risk_map import RiskMap
from ..network.construction import NetworkOptions, build_network

# Number of maps that a process keeps.
_KEPT_MAPS = 4
# Interval [s] at which cancellation is checked.
_CHECK_INTERVAL = 0.2


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
    cancelled: threading.Event | None = None,
    in_flight: int = 0,
) -> list[Solved]:
    """Solve problems in parallel; the results have the problems' order.

    An error replaces only its own result. If the executor breaks (a process of a pool was killed),
    the unsolved problems get its error.

    Parameters
    ----------
    problems
        Consumed as capacity becomes free. Share ``RiskMap`` objects, so that each is sent once.
    answer
        Applied to each strategy where it was solved, so that only the answer is sent back (by
        default the strategy). It must be picklable: a function of a module, not a lambda.
    on_result
        Called in this thread with each result as it comes, in any order. If it raises, the pending
        problems are cancelled.
    cancelled
        Once it is set, no more problems are submitted and unsolved ones get ``CancelledError``.
        Running solves are not waited for.
    in_flight
        Number of problems that the executor holds at once, at least its number of workers; 0:
        twice the number of processors. Raises InvalidOption if negative.
    """
    if in_flight < 0:
        raise InvalidOption(f'in_flight must be >= 0, got {in_flight}')
    capacity = in_flight or 2 * (os.cpu_count() or 1)
    in_hand = _ProblemsInFlight(executor, answer, capacity)
    stopped = cancelled or threading.Event()
    results: dict[int, Solved] = {}
    waiting = iter(enumerate(problems))
    try:
        while not stopped.is_set():
            while len(in_hand) < capacity and (following := next(waiting, None)) is not None:
                in_hand.send(*following)
            if not len(in_hand):
                break
            for result in in_hand.receive():
                results[result.index] = result
                if on_result is not None:
                    on_result(result)
    finally:
        unsolved = in_hand.cancel()
    rest = [*unsolved, *(index for index, _ in waiting)] if stopped.is_set() else []
    for index in rest:
        results[index] = Solved(index, error=CancelledError('cancelled before it was solved'))
    return [results[index] for index in sorted(results)]


class _ProblemsInFlight:
    """Problems that an executor holds."""

    def __init__(
        self, executor: Executor, answer: Callable[[Strategy], Any] | None, capacity: int
    ) -> None:
        self._executor = executor
        self._answer = answer
        # Number of a map's first problems that are sent with it, so that each worker gets one.
        self._first_copies = max(1, capacity // 2)
        self._pending: dict[Future[Any], tuple[int, Problem]] = {}
        self._failed: deque[Solved] = deque()
        self._packed: dict[int, _PackedMap] = {}

    def __len__(self) -> int:
        return len(self._pending) + len(self._failed)

    def send(self, index: int, problem: Problem, with_map: bool = False) -> None:
        """Submit a problem, with its map if requested or if few copies were sent."""
        packed = self._packed.get(id(problem.risk_map))
        if packed is None:
            packed = self._packed[id(problem.risk_map)] = _PackedMap(problem.risk_map)
        with_map = with_map or packed.copies < self._first_copies
        packed.copies += with_map
        content = packed.content if with_map else None
        rest = (problem.start_xy, problem.goal_xy, problem.network, problem.game, problem.strategy)
        try:
            future = self._executor.submit(_solve, packed.key, content, rest, self._answer)
        except Exception as error:  # the pool broke or was shut down
            self._failed.append(Solved(index, error=error))
        else:
            self._pending[future] = index, problem

    def receive(self) -> list[Solved]:
        """Wait briefly for results."""
        results = list(self._failed)
        self._failed.clear()
        if not self._pending:
            return results
        timeout = 0.0 if results else _CHECK_INTERVAL
        done, _ = wait(self._pending, timeout=timeout, return_when=FIRST_COMPLETED)
        for future in done:
            index, problem = self._pending.pop(future)
            error = _error_of(future)
            found = None if error else future.result()
            if isinstance(found, _MapMissing):
                self.send(index, problem, with_map=True)
            else:
                results.append(Solved(index, found, error))
        return results

    def cancel(self) -> list[int]:
        """Cancel pending problems; return the indices of all without a result."""
        for future in self._pending:
            future.cancel()
        return [index for index, _ in self._pending.values()]


def _error_of(future: Future[Any]) -> BaseException | None:
    try:
        return future.exception()
    except CancelledError as error:
        return error


class _PackedMap:
    """A compressed map, and the number of its copies that were sent."""

    def __init__(self, risk_map: RiskMap) -> None:
        self.risk_map = risk_map  # keeps its id from being reused
        content = pickle.dumps(risk_map, protocol=pickle.HIGHEST_PROTOCOL)
        self.key = hashlib.sha256(content).digest()
        self.content = zlib.compress(content, 1)
        self.copies = 0


class _MapMissing:
    """Answer of a process that does not have the map."""


# Maps by hash that this process, possibly a worker, keeps for the next problems.
_maps: OrderedDict[bytes, RiskMap] = OrderedDict()
_maps_lock = threading.Lock()


def _solve(
    key: bytes,
    content: bytes | None,
    rest: tuple[Any, ...],
    answer: Callable[[Strategy], Any] | None,
) -> Any:
    """Solve one problem in the executor's process."""
    risk_map: Any = _map_of(key, content)
    if risk_map is None and content is None:
        return _MapMissing()
    start_xy, goal_xy, network_options, game, options = rest
    network = build_network(risk_map, start_xy, goal_xy, network_options)
    strategy = solve(network, game, options)
    return strategy if answer is None else answer(strategy)


def _map_of(key: bytes, content: bytes | None) -> RiskMap | None:
    with _maps_lock:
        risk_map = _maps.get(key)
        if risk_map is None and content is not None:
            risk_map = pickle.loads(zlib.decompress(content))
        if risk_map is not None:
            _maps[key] = risk_map
            _maps.move_to_end(key)
            while len(_maps) > _KEPT_MAPS:
                _maps.popitem(last=False)
        return risk_map
