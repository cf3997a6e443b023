# SPDX-License-Identifier: Apache-2.0
"""Many games on executors: order, errors, progress, broken pools."""

import multiprocessing
import os
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace

import numpy as np
import pytest

from ambush_planner import (
    InvalidOption,
    InvalidRiskMap,
    NetworkOptions,
    NoRoute,
    Plan,
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
    return numbers(plan_trip(each.risk_map, each.start_xy, each.goal_xy, each.options))


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


def test_results_are_those_of_solve_in_the_problems_order(executor):
    maps = [field(0), field(1)]
    problems = [problem(maps[k % 2], k, strategy=StrategyOptions(max_detour=1.1 + k % 3))
                for k in range(5)]
    finished = []
    results = solve_many(iter(problems), executor, answer=numbers, on_result=finished.append)
    assert sorted(finished, key=lambda each: each.index) == results
    assert [result.index for result in results] == list(range(5))
    assert [result.answer for result in results] == [expected(each) for each in problems]


def test_the_default_answer_is_the_plan(executor, tmp_path):
    """With its map, also of a trip with stops."""
    assert solve_many([], executor) == []
    each = replace(problem(field(), 3), stops=[(105.0, 155.0), (155.0, 55.0)])
    (result,) = solve_many([each], executor)
    assert isinstance(result.answer, Plan) and result.error is None
    plan = plan_trip(each.risk_map, each.start_xy, each.goal_xy, each.options, stops=each.stops)
    assert numbers(result.answer) == numbers(plan)
    (path,) = result.answer.save(tmp_path / 'r.csv')
    assert path[0, :2].tolist() == list(each.start_xy)


def test_an_error_replaces_only_its_own_result(executor):
    risk_map = field()
    wall = RiskMap(np.ones((20, 20)), np.arange(400).reshape(20, 20) % 20 == 10, 10.0)
    problems = [problem(risk_map, 0), Problem(risk_map, (95.0, 95.0), (185.0, 95.0)),
                problem(wall, 1), problem(None, 1), problem(risk_map, 2)]
    results = solve_many(problems, executor, answer=numbers)
    kinds = [type(result.error) for result in results]
    assert kinds == [type(None), StartBlocked, NoRoute, InvalidRiskMap, type(None)]
    assert [result.answer is None for result in results] == [False, True, True, True, False]


def test_an_error_in_on_result_cancels_the_rest():
    taken = []

    def problems():
        for k in range(50):
            taken.append(k)
            yield problem(field(), k)

    def stop(result):
        raise KeyboardInterrupt

    with ThreadPoolExecutor(1) as pool:
        with pytest.raises(KeyboardInterrupt):
            solve_many(problems(), pool, answer=numbers, on_result=stop, in_flight=4)
    assert len(taken) <= 8


def end_here(strategy):
    if strategy.network.points[strategy.network.source][1] == 35.0:
        os._exit(1)
    return strategy.value


def test_a_broken_pool_keeps_the_finished_results():
    with ProcessPoolExecutor(1, FRESH) as pool:
        results = solve_many([problem(field(), k) for k in range(6)], pool, answer=end_here,
                             in_flight=1)
    assert [result.error is None for result in results] == [True, True, *[False] * 4]
    assert all(isinstance(result.error, BrokenProcessPool) for result in results[2:])
    pool.shutdown()
    results = solve_many([problem(field(), k) for k in range(3)], pool)
    assert all(isinstance(result.error, BrokenProcessPool) for result in results)
    with pytest.raises(InvalidOption, match='in_flight'):
        solve_many([], pool, in_flight=-1)


def test_a_cluster_that_loses_a_worker_loses_no_result(tmp_path):
    distributed = pytest.importorskip('distributed', reason='dask takes the extra "dask"')
    problems = [problem(field(), k) for k in range(8)]
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True,
                                 dashboard_address=None, local_directory=str(tmp_path)) as cluster,
        distributed.Client(cluster) as client,
    ):
        done = []

        def kill_one(result):
            done.append(result)
            if len(done) == 3:
                # Both workers have problems at this time.
                victim = next(iter(client.run(os.getpid).values()))
                os.kill(victim, 9)

        results = solve_many(problems, client.get_executor(), answer=numbers, on_result=kill_one,
                             in_flight=6)
    assert len(done) == 8
    assert [result.error for result in results] == [None] * 8
    assert [result.answer for result in results] == [expected(each) for each in problems]
