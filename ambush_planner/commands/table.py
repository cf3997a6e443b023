"""``ambush_table``: what it costs to drive between all depots and all customers."""

from __future__ import annotations

import argparse
import hashlib
import itertools
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from ..game.strategy import Strategy
from ..maps.map_file import read_map
from ..maps.occupancy import OccupancyMap, risk_map_from_occupancy
from ..maps.risk_map import RiskMap
from ..planning.many import Problem, Solved, solve_many
from . import cli
from .table_file import COLUMNS, Place, TableFile, read_places
from .table_options import TableOptions, options_from

EPILOG = """\
DEPOTS and CUSTOMERS are CSV files with the columns name, x, y (world positions [m]). The map is one
that map_server reads; ambush_terrain makes such maps. The table has a row for each pair: value,
lower_bound, expected_length and shortest_length [m], route_entropy [nats], and error where there is
no strategy. Options have the names of the node's parameters (map., network., game.,
strategy.), and the defaults of the Python functions.

Pairs are solved by processes on this machine, or by the workers of a dask.distributed cluster
(pip install 'ambush_planner[dask]' here, ambush_planner there). Rows are kept in TABLE.csv.part as
they come: after an interruption the same command goes on from there. Rows whose map, positions
and options are the same are not solved again, rows with an error are.
A pair without a strategy is a finding.
--json: {"verdict", "table", "pairs", "solved", "failed", "seconds"}
""" + cli.EXIT_CODES


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = cli.new_parser(
        'table', 'Value, length and entropy of the strategies for all pairs of places.', EPILOG
    )
    made.add_argument('depots', type=Path, metavar='DEPOTS.csv', help='where trips begin')
    made.add_argument('customers', type=Path, metavar='CUSTOMERS.csv', help='where they end')
    made.add_argument('--map', type=Path, required=True, metavar='MAP.yaml', help='the risk map')
    made.add_argument(
        '-o', '--output', type=Path, required=True, metavar='TABLE.csv', help='the table to write'
    )
    made.add_argument(
        '--set', nargs='+', default=[], metavar='NAME=VALUE',
        help='options, such as network.spacing=50 strategy.max_detour=1.3',
    )
    where = made.add_mutually_exclusive_group()
    where.add_argument(
        '--jobs', type=cli.positive, metavar='N', help='processes (default: one for each processor)'
    )
    where.add_argument(
        '--scheduler', metavar='ADDRESS', help='of a dask cluster, such as tcp://host:8786'
    )
    return made


@dataclass(frozen=True)
class Pair:
    """A depot, a customer, and the hash of all that their row follows from."""

    depot: Place
    customer: Place
    inputs: str


def _work(arguments: argparse.Namespace, console: cli.Console) -> int:
    """Make or complete the table; the exit code says whether each pair has a strategy."""
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
    seconds = console.seconds
    console.line(cli.place(arguments.output))
    console.line(f'{len(pairs)} pairs, {len(missing)} of them solved now, {failed} without a '
                 f'strategy, in {seconds:.1f} s')
    console.result = {
        'table': cli.place(arguments.output), 'pairs': len(pairs), 'solved': len(missing),
        'failed': failed, 'seconds': round(seconds, 1),
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
    solved = itertools.count(1)

    def keep(result: Solved) -> None:
        table.add(_row(pairs[result.index], result))
        bar(next(solved) / len(pairs))

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


main = cli.command(parser, _work)
