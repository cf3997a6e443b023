# SPDX-License-Identifier: Apache-2.0
"""Many games on executors: order, errors, broken pools."""

import multiprocessing
import os
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace

import numpy as np
import pytest

from ambush_planner import (
    InvalidRiskMap,
    NetworkOptions,
    NoRoute,
    PlanningOptions,
    Problem,
    RiskMap,
    StartBlocked,
    StrategyOptions,
    plan_trip,
    solve_many,
)

# Each process is forked from one that has already imported the package.
FRESH = multiprocessing.get_context('forkserver')
FRESH.set_forkserver_preload(['ambush_planner'])
SIDE = 200.0


def field(seed=0, cells=20):
    rng = np.random.default_rng(seed)
    obstacles = np.zeros((cells, cells), bool)
    obstacles[8:12, 8:12] = True
    return RiskMap(rng.uniform(1.0, 5.0, (cells, cells)), obstacles, SIDE / cells)


def problem(risk_map, k, **options):
    start = (15.0, 15.0 + 10.0 * (k % 17))
    planning = PlanningOptions(network=NetworkOptions(spacing=20.0), **options)
    return Problem(risk_map, start, (185.0, 95.0), planning)


def numbers(plan):
    return plan.value, plan.trip.route_entropy


def expected(each):
    return numbers(plan_trip(each.risk_map, each.start_xy, each.goal_xy, each.options,
                             stops=each.stops))


@pytest.fixture(scope='module')
def processes():
    with ProcessPoolExecutor(2, FRESH) as pool:
        yield pool


@pytest.fixture(params=['threads', 'processes'])
def executor(request):
    if request.param == 'processes':
        return request.getfixturevalue('processes')
    pool = ThreadPoolExecutor(2)
    request.addfinalizer(pool.shutdown)
    return pool


def test_results_are_those_of_plan_trip_in_the_problems_order(executor, tmp_path):
    """With their maps, also of trips with stops."""
    assert solve_many([], executor) == []
    maps = [field(0), field(1)]
    problems = [problem(maps[k % 2], k, strategy=StrategyOptions(max_detour=1.1 + k % 3))
                for k in range(4)]
    problems.append(replace(problems[3], stops=[(105.0, 155.0), (155.0, 55.0)]))
    results = solve_many(iter(problems), executor)
    assert [result.index for result in results] == list(range(5))
    assert [numbers(result.answer) for result in results] == [expected(each) for each in problems]
    (path,) = results[4].answer.save(tmp_path / 'r.csv')
    assert path[0, :2].tolist() == list(problems[4].start_xy)


def test_an_error_replaces_only_its_own_result(executor):
    risk_map = field()
    wall = RiskMap(np.ones((20, 20)), np.arange(400).reshape(20, 20) % 20 == 10, 10.0)
    problems = [problem(risk_map, 0), Problem(risk_map, (95.0, 95.0), (185.0, 95.0)),
                problem(wall, 1), problem(None, 1), problem(risk_map, 2)]
    results = solve_many(problems, executor)
    kinds = [type(result.error) for result in results]
    assert kinds == [type(None), StartBlocked, NoRoute, InvalidRiskMap, type(None)]
    assert [result.answer is None for result in results] == [False, True, True, True, False]


class Deadly(PlanningOptions):
    """Options that end the process that reads them."""

    def __reduce__(self):
        return os._exit, (1,)


def test_a_broken_pool_keeps_the_finished_results():
    with ProcessPoolExecutor(1, FRESH) as pool:
        (first,) = solve_many([problem(field(), 0)], pool)
        results = solve_many([problem(field(), 1), replace(problem(field(), 2), options=Deadly()),
                              problem(field(), 3)], pool)
    assert first.error is None
    assert all(isinstance(result.error, BrokenProcessPool) for result in results[1:])
    results = solve_many([problem(field(), k) for k in range(3)], pool)
    assert all(isinstance(result.error, RuntimeError) for result in results)


@pytest.mark.slow
def test_a_cluster_that_loses_a_worker_loses_no_result(tmp_path):
    distributed = pytest.importorskip('distributed', reason='dask takes the extra "dask"')
    problems = [problem(field(), k) for k in range(8)]
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True,
                                 dashboard_address=None, local_directory=str(tmp_path)) as cluster,
        distributed.Client(cluster) as client,
    ):
        def but_one_dies():
            yield from problems[:6]
            os.kill(next(iter(client.run(os.getpid).values())), 9)  # both have problems now
            yield from problems[6:]

        results = solve_many(but_one_dies(), client.get_executor())
    assert [result.error for result in results] == [None] * 8
    assert [numbers(result.answer) for result in results] == [expected(each) for each in problems]
