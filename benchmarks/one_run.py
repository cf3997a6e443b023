"""Run one solver on one map in a process of its own and print what came out as JSON.

A process of its own, so that the peak of its memory is the solver's. Seconds are the processor's:
on one thread they do not depend on what else the machine does. `solver.py` starts these.
"""

from __future__ import annotations

import argparse
import json
import resource
import signal
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from maps import block_network
from peers import Answer, EntropyProblem, clarabel_entropy, highs

from ambush_planner import GameOptions, solve
from ambush_planner.core.game import make_game
from ambush_planner.core.game_value import solve_by_cut

# Short runs are repeated for this long [s].
LONG_ENOUGH = 0.5
# Nodes across the map with which our side loads what it loads at its first use.
WARM_UP = 12


def build(nodes: int, file: Path) -> Callable[[], Answer]:
    """The network from the map."""

    def run() -> Answer:
        started = time.process_time()
        network = block_network(nodes)
        seconds = time.process_time() - started
        return {
            "seconds": seconds, "nodes": len(network.points), "edges": len(network.edges),
        }

    return run


def value(nodes: int, file: Path) -> Callable[[], Answer]:
    """The exact value without a length budget, by a minimum cut."""
    game = make_game(block_network(nodes), GameOptions())

    def run() -> Answer:
        started = time.process_time()
        found = solve_by_cut(game)
        return {"seconds": time.process_time() - started, "value": found.value}

    return run


def strategy(nodes: int, file: Path) -> Callable[[], Answer]:
    """The default strategy, all stages; leaves its entropy problem in the file for others."""
    network = block_network(nodes)

    def run() -> Answer:
        started = time.process_time()
        found = solve(network)
        seconds = time.process_time() - started
        edges = np.flatnonzero(found.edge_probability > 0.0)
        # Up to rounding the strategy uses its whole budget; Clarabel may use what it used.
        length = max(found.length_budget, found.expected_length)
        np.savez(
            file, edges=edges, value=found.value, length=length, budget=found.length_budget
        )
        return {
            "seconds": seconds,
            "value": found.value,
            "gap": found.gap,
            "entropy": found.edge_entropy,
            "route_entropy": found.route_entropy,
            "iterations": found.iterations,
            "acyclic_edges": len(edges),
        }

    return run


def simplex(nodes: int, file: Path) -> Callable[[], Answer]:
    """The value with the length budget by HiGHS' dual simplex method."""
    with np.load(file) as left:
        return highs(block_network(nodes), float(left["budget"]), "simplex")


def interior_point(nodes: int, file: Path) -> Callable[[], Answer]:
    """The value without a length budget by HiGHS' interior point method without crossover."""
    return highs(block_network(nodes), np.inf, "ipx")


def interior_point_budget(nodes: int, file: Path) -> Callable[[], Answer]:
    """The same with the length budget."""
    with np.load(file) as left:
        return highs(block_network(nodes), float(left["budget"]), "ipx")


def conic(nodes: int, file: Path) -> Callable[[], Answer]:
    """The entropy problem by Clarabel."""
    with np.load(file) as left:
        problem = EntropyProblem(left["edges"], float(left["value"]), float(left["length"]))
    return clarabel_entropy(block_network(nodes), problem)


TASKS = (build, value, strategy, simplex, interior_point, interior_point_budget, conic)


def measure(run: Callable[[], Answer]) -> Answer:
    """Run until it has taken ``LONG_ENOUGH``; the last answer with the median time."""
    times: list[float] = []
    while sum(times) < LONG_ENOUGH:
        answer = run()
        times.append(answer["seconds"])
    return answer | {"seconds": statistics.median(times)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    tasks = {task.__name__: task for task in TASKS}
    parser.add_argument("task", choices=tasks, help="what is measured")
    parser.add_argument("nodes", type=int, help="lattice nodes across the map")
    parser.add_argument("file", type=Path, help=".npz in which `strategy` leaves its problem")
    parser.add_argument("--limit", type=int, default=0, help="seconds after which it ends")
    arguments = parser.parse_args()
    task = tasks[arguments.task]
    if task in (build, value, strategy):
        task(WARM_UP, arguments.file)()
    prepared = task(arguments.nodes, arguments.file)
    # Native code does not look at Python's signals: SIGPROF's default ends the process.
    signal.setitimer(signal.ITIMER_PROF, arguments.limit)
    answer = measure(prepared)
    signal.setitimer(signal.ITIMER_PROF, 0)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    print(json.dumps(answer | {"peak": peak}))


if __name__ == "__main__":
    main()
