# SPDX-License-Identifier: Apache-2.0
"""Shortest routes by scipy, and the linear program of the value by HiGHS (Huangfu and Hall, 2018).

They share no code with the package. Of HiGHS, only its own run is timed, on one thread.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import highspy
import numpy as np
from scipy.sparse import coo_matrix, csc_matrix, csr_matrix, hstack, vstack
from scipy.sparse.csgraph import dijkstra

from ambush_planner import Network
from ambush_planner.arrays import BoolArray, FloatArray


@dataclass(frozen=True, eq=False)
class LP:
    """Minimise cost x, rows x in low..high, x in 0..most; x is p (M,), t, s."""

    cost: FloatArray
    most: FloatArray
    rows: csc_matrix
    low: FloatArray
    high: FloatArray


def value_lp(network: Network, losses: csr_matrix, budgets: list[tuple[FloatArray, float]],
             ambushers: int = 1, usable: BoolArray | None = None) -> LP:
    """Minimise k t + sum s: ``losses`` (S, M) p <= t + s, one unit of flow p within ``budgets``.

    Each budget is the costs (M,) of the edges and its limit; p is 0 on edges that are not
    ``usable`` (M,).
    """
    (tail, head), m, n = network.edges.T, len(network.edges), len(network.points)
    sites = losses.shape[0]
    several = sites if ambushers > 1 else 0
    ends = np.r_[tail, head], np.tile(np.arange(m), 2)
    balance = coo_matrix((np.repeat([1.0, -1.0], m), ends), (n, m))
    supply = np.zeros(n)
    supply[network.source], supply[network.target] = 1.0, -1.0
    beyond = csr_matrix((-np.ones(several), (np.arange(several),) * 2), (sites, several))
    parts = [hstack((losses, csr_matrix(-np.ones((sites, 1))), beyond))]
    finite = [(cost / limit, 1.0) for cost, limit in budgets if 0.0 < limit < np.inf]
    parts += [csr_matrix(np.r_[cost, np.zeros(1 + several)]) for cost, _ in finite]
    rows = vstack([*parts, hstack((balance, csr_matrix((n, 1 + several))))])
    above = np.r_[np.zeros(sites), np.ones(len(finite))]
    most = np.full(m + 1 + several, np.inf)
    if usable is not None:
        most[:m][~usable] = 0.0
    return LP(np.r_[np.zeros(m), ambushers, np.ones(several)], most, csc_matrix(rows),
              np.r_[np.full(len(above), -np.inf), supply], np.r_[above, supply])


def best_route(network: Network, weights: FloatArray) -> list[int]:
    """The nodes of the route of least weight; weights (M,) of edges."""
    count = len(network.points)
    graph = csr_matrix((weights, network.edges.T), (count, count))
    _, before = dijkstra(graph, indices=network.source, return_predecessors=True)
    nodes = [network.target]
    while nodes[-1] != network.source:
        nodes.append(int(before[nodes[-1]]))
    return nodes[::-1]


def highs(lp: LP, **options: Any) -> dict[str, Any]:
    """HiGHS' status, its value, and its processor seconds."""
    model, (rows, columns) = highspy.HighsLp(), lp.rows.shape
    model.num_row_, model.num_col_ = rows, columns
    model.col_cost_, model.col_lower_ = lp.cost, np.zeros(columns)
    model.col_upper_ = lp.most
    model.row_lower_, model.row_upper_ = lp.low, lp.high
    model.a_matrix_.format_ = highspy.MatrixFormat.kColwise
    model.a_matrix_.start_, model.a_matrix_.index_ = lp.rows.indptr, lp.rows.indices
    model.a_matrix_.value_ = lp.rows.data
    engine = highspy.Highs()
    settings = {'output_flag': False, 'threads': 1, 'solver': 'simplex', **options}
    for name, setting in settings.items():
        engine.setOptionValue(name, setting)
    engine.passModel(model)
    begin = time.process_time()
    engine.run()
    seconds = time.process_time() - begin
    status = engine.modelStatusToString(engine.getModelStatus())
    answer = {'seconds': seconds, 'status': status}
    found = {'value': engine.getInfo().objective_function_value}
    return answer | (found if status == 'Optimal' else {'failed': True})
