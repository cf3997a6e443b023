# SPDX-License-Identifier: Apache-2.0
"""Greatest route entropy by Clarabel, a conic solver that shares nothing with ours."""

import numpy as np
import pytest
from scipy.sparse import csc_matrix, csr_matrix, identity, vstack


def most_route_entropy(network, edges, rows, limits) -> float:
    """Largest -sum p ln(p / x_tail) of a unit flow p on ``edges`` (m,) with ``rows`` p <= limits.

    The test is skipped without Clarabel. NaN where it does not solve it to its own tolerances.
    Variables (p, t); (t_k, p_k, x_tail) in the exponential cone says t_k <= -p_k ln(p_k / x_tail).
    """
    clarabel = pytest.importorskip('clarabel', reason='no clarabel: it lacks a rosdep key')
    n, m = len(network.points), len(edges)
    tail, head = network.edges[edges].T
    ones, each = np.ones(m), np.arange(m)
    out, into = (csr_matrix((ones, (end, each)), shape=(n, m)) for end in (tail, head))
    touched = np.setdiff1d(np.union1d(tail, head), [network.target])
    supply = (touched == network.source).astype(float)
    linear = vstack([(out - into)[touched], csr_matrix(rows)]).tocsc()
    linear.resize((linear.shape[0], 2 * m))
    visits = out[tail].tocsc()  # row k: x of the tail of edge k
    visits.resize((m, 2 * m))
    cones = vstack([identity(2 * m, format='csr'), visits]).tocsr()
    order = np.arange(3 * m).reshape(3, m)[[1, 0, 2]].T.ravel()  # (t, p, x) edge by edge
    matrix = vstack([linear, -cones[order]]).tocsc()
    right = np.concatenate([supply, limits, np.zeros(3 * m)])
    kinds = [clarabel.ZeroConeT(len(supply)), clarabel.NonnegativeConeT(len(limits))]
    kinds += [clarabel.ExponentialConeT()] * m
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_feas = settings.tol_gap_abs = settings.tol_gap_rel = 1e-9
    cost = np.concatenate([np.zeros(m), -np.ones(m)])
    found = clarabel.DefaultSolver(
        csc_matrix((2 * m, 2 * m)), cost, matrix, right, kinds, settings
    ).solve()
    return float(-found.obj_val) if str(found.status) == 'Solved' else np.nan


def route_entropy(network, p) -> float:
    """-sum p ln(p / x_tail) [nats]."""
    x = np.bincount(network.tails, p, len(network.points))[network.tails]
    used = p > 0.0
    return float(-(p[used] * np.log(p[used] / x[used])).sum())
