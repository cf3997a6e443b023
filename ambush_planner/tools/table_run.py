"""What ``ambush_table`` does: read places and map, solve the pairs that are missing, write rows."""

from __future__ import annotations

import argparse
import hashlib
import itertools
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass

from ..core.batch import Problem, Solved, solve_many
from ..core.risk_map import RiskMap, risk_map_from_occupancy
from ..core.strategy import Strategy
from ..terrain.map_file import OccupancyMap, read_map
from . import cli
from .table_file import COLUMNS, Place, TableFile, read_places
from .table_options import TableOptions, options_from


@dataclass(frozen=True)
class Pair:
    """A depot, a customer, and the hash of all that their row follows from."""

    depot: Place
    customer: Place
    inputs: str


def run_table(arguments: argparse.Namespace, console: cli.Console) -> int:
    """Make or complete the table; the exit code says whether each pair has a strategy."""
    begin = time.monotonic()
    options = options_from(arguments.set)
    places = read_places(arguments.depots), read_places(arguments.customers)
    occupancy = read_map(arguments.map)
    risk_map = risk_map_from_occupancy(
        occupancy.values, occupancy.resolution, occupancy.origin, options.map
    )
    pairs = _pairs(*places, occupancy, options)
    with TableFile(arguments.output) as table:
        missing = [pair for pair in pairs if not table.has(pair.inputs)]
        failed, bar = 0, console.bar('pairs solved')
        if missing:
            with _executor(arguments) as (executor, in_flight):
                failed = _solve(missing, risk_map, options, executor, in_flight, table, bar)
        table.finish([pair.inputs for pair in pairs])
    seconds = time.monotonic() - begin
    console.line(f'{cli.place(arguments.output)}: {len(pairs)} pairs, {len(missing)} of them '
                 f'solved now, {failed} without a strategy, in {seconds:.1f} s')
    console.result = {
        'verdict': 'finding' if failed else 'holds', 'table': cli.place(arguments.output),
        'pairs': len(pairs), 'solved': len(missing), 'failed': failed, 'seconds': round(seconds, 1),
    }
    return cli.Exit.FINDING if failed else cli.Exit.HOLDS


def _pairs(
    depots: Sequence[Place],
    customers: Sequence[Place],
    occupancy: OccupancyMap,
    options: TableOptions,
) -> list[Pair]:
    common = hashlib.sha256(occupancy.values.tobytes())
    common.update(repr((occupancy.values.shape, occupancy.resolution, occupancy.origin)).encode())
    common.update(repr(options).encode())
    pairs = []
    for depot, customer in itertools.product(depots, customers):
        own = common.copy()
        own.update(repr((depot, customer)).encode())
        pairs.append(Pair(depot, customer, own.hexdigest()[:16]))
    return pairs


def _solve(
    pairs: Sequence[Pair],
    risk_map: RiskMap,
    options: TableOptions,
    executor: Executor,
    in_flight: int,
    table: TableFile,
    bar: Callable[[float], None],
) -> int:
    """Solve pairs, keep their rows as they come, and return how many have no strategy."""
    problems = (
        Problem(risk_map, pair.depot.xy, pair.customer.xy,
                options.network, options.game, options.strategy)
        for pair in pairs
    )

    done = [0]

    def keep(result: Solved) -> None:
        table.add(_row(pairs[result.index], result))
        done[0] += 1
        bar(done[0] / len(pairs))

    results = solve_many(
        problems, executor, answer=_measures, on_result=keep, in_flight=in_flight
    )
    return sum(result.error is not None for result in results)


def _measures(strategy: Strategy) -> dict[str, float]:
    """What of a strategy stands in the table; worked out where it was solved."""
    names = ('value', 'lower_bound', 'expected_length', 'shortest_length', 'route_entropy')
    return {name: float(getattr(strategy, name)) for name in names}


def _row(pair: Pair, result: Solved) -> dict[str, str]:
    row = dict.fromkeys(COLUMNS, '') | {
        'depot': pair.depot.name, 'customer': pair.customer.name, 'inputs': pair.inputs,
    }
    if result.error is not None:
        return row | {'error': f'{type(result.error).__name__}: {result.error}'}
    return row | {name: f'{value:.9g}' for name, value in result.answer.items()}


@contextmanager
def _executor(arguments: argparse.Namespace) -> Iterator[tuple[Executor, int]]:
    """What solves the pairs, and how many of them it should hold."""
    if arguments.scheduler:
        try:
            from distributed import Client
        except ModuleNotFoundError as error:
            raise cli.UsageError(
                "--scheduler needs dask: pip install 'ambush_planner[dask]'"
            ) from error
        with Client(arguments.scheduler, timeout='20s') as client:
            threads = sum(client.nthreads().values())
            yield client.get_executor(), 2 * max(1, threads)
        return
    jobs = arguments.jobs or len(os.sched_getaffinity(0))
    pool = ProcessPoolExecutor(jobs, multiprocessing.get_context('spawn'), _end_with_parent)
    try:
        yield pool, 2 * jobs
    except BaseException:
        # Nobody wants what still runs.
        for process in multiprocessing.active_children():
            process.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _end_with_parent() -> None:
    """In a process of the pool: end at Ctrl-C without a word, and when the parent was killed."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)

    def watch() -> None:
        parent = multiprocessing.parent_process()
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
