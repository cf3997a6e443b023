"""Many games at once, over any ``concurrent.futures.Executor``: threads, processes, a cluster.

A map is large beside everything else that a problem consists of, and many problems share one. So
problems travel with the map's hash only, and a process that does not have the map yet says so;
then the problem goes out again together with the map. Whoever got a map keeps it for the problems
that follow. That takes nothing from the executor but ``submit``: no shared disk, no names of
workers, and a worker that takes another one's place is served in the same way.
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

# Maps that a process keeps for problems to come.
_KEPT_MAPS = 4
# Seconds between two looks whether the caller wants no more.
_PATIENCE = 0.2


@dataclass(frozen=True, eq=False)
class Problem:
    """A map, a start and a goal (x, y) [m], and the options of the way from there to a strategy."""

    risk_map: RiskMap
    start_xy: tuple[float, float]
    goal_xy: tuple[float, float]
    network: NetworkOptions = field(default_factory=NetworkOptions)
    game: GameOptions = field(default_factory=GameOptions)
    strategy: StrategyOptions = field(default_factory=StrategyOptions)


@dataclass(frozen=True, eq=False)
class Solved:
    """What became of the problem at ``index``: an answer, or else the error in its place."""

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
    """Solve problems side by side; the results come in the problems' order.

    An error stands in the place of its own result and stops nothing else. If the executor breaks (a
    process of a pool was killed), the problems that it had not solved get its error.

    Parameters
    ----------
    problems
        Taken one by one, as there is room. Those that share a ``RiskMap`` object share its journey.
    answer
        What is wanted of a strategy (by default all of it), worked out where it was solved, so that
        only that comes back. A function that the executor can send: of a module, no lambda.
    on_result
        Called in this thread with each result as it comes, in any order: progress. What it raises
        ends the whole, and cancels what has not begun.
    cancelled
        When it is set, nothing more is begun, and what was not solved gets ``CancelledError``. A
        solve that runs is not waited for; the executor may have to be told to end it.
    in_flight
        Problems that the executor holds at once, at least its number of workers to keep all busy;
        0: twice the number of processors here. A worker that meets a map for the first time
        seldom hands back more problems than this.

    Raises
    ------
    InvalidOption
        ``in_flight`` is negative.
    """
    if in_flight < 0:
        raise InvalidOption(f'in_flight must be >= 0, got {in_flight}')
    room = in_flight or 2 * (os.cpu_count() or 1)
    in_hand = _ProblemsInFlight(executor, answer, room)
    stopped = cancelled or threading.Event()
    results: dict[int, Solved] = {}
    waiting = iter(enumerate(problems))
    try:
        while not stopped.is_set():
            while len(in_hand) < room and (following := next(waiting, None)) is not None:
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
        self, executor: Executor, answer: Callable[[Strategy], Any] | None, room: int
    ) -> None:
        self._executor = executor
        self._answer = answer
        # The first problems of a map go out with it: half of what is in flight, so that each
        # worker begins with one.
        self._first_copies = max(1, room // 2)
        self._pending: dict[Future[Any], tuple[int, Problem]] = {}
        self._failed: deque[Solved] = deque()
        self._packed: dict[int, _PackedMap] = {}

    def __len__(self) -> int:
        return len(self._pending) + len(self._failed)

    def send(self, index: int, problem: Problem, with_map: bool = False) -> None:
        """Hand over a problem, with its map if that is asked for or few have it yet."""
        packed = self._packed.get(id(problem.risk_map))
        if packed is None:
            packed = self._packed[id(problem.risk_map)] = _PackedMap(problem.risk_map)
        with_map = with_map or packed.copies < self._first_copies
        packed.copies += with_map
        content = packed.content if with_map else None
        rest = (problem.start_xy, problem.goal_xy, problem.network, problem.game, problem.strategy)
        try:
            future = self._executor.submit(_solve, packed.key, content, rest, self._answer)
        except Exception as error:  # a pool that broke, or was shut down
            self._failed.append(Solved(index, error=error))
        else:
            self._pending[future] = index, problem

    def receive(self) -> list[Solved]:
        """Wait a moment for results."""
        results = list(self._failed)
        self._failed.clear()
        if not self._pending:
            return results
        # Executors of other makers may give a future each time it is asked for: no sets of theirs.
        patience = 0.0 if results else _PATIENCE
        done, _ = wait(self._pending, timeout=patience, return_when=FIRST_COMPLETED)
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
        """Take back what has not begun; the indices of what has no result yet."""
        for future in self._pending:
            future.cancel()
        return [index for index, _ in self._pending.values()]


def _error_of(future: Future[Any]) -> BaseException | None:
    try:
        return future.exception()
    except CancelledError as error:
        return error


class _PackedMap:
    """A map as it travels, and the number of its copies that were sent."""

    def __init__(self, risk_map: RiskMap) -> None:
        self.risk_map = risk_map  # keeps its id from being used again
        content = pickle.dumps(risk_map, protocol=pickle.HIGHEST_PROTOCOL)
        self.key = hashlib.sha256(content).digest()
        # Losses mostly come from bytes: a tenth of the size for little time.
        self.content = zlib.compress(content, 1)
        self.copies = 0


class _MapMissing:
    """Answer of a process that does not have the map."""


# Of this process, which may be a worker's: what it got stays for the problems that follow.
_maps: OrderedDict[bytes, RiskMap] = OrderedDict()
_maps_lock = threading.Lock()


def _solve(
    key: bytes,
    content: bytes | None,
    rest: tuple[Any, ...],
    answer: Callable[[Strategy], Any] | None,
) -> Any:
    """Solve one problem where the executor wants it."""
    risk_map: Any = _map_of(key, content)
    if risk_map is None and content is None:  # no map at all is the problem's own error
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
