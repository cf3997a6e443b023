# SPDX-License-Identifier: Apache-2.0
"""Triangular systems of one pattern: against dense algebra, by scipy's product and without it."""

import numpy as np
import pytest

from ambush_planner.game.law import triangular
from ambush_planner.game.law.triangular import Recursion


@pytest.mark.parametrize('in_place', [True, False])
@pytest.mark.parametrize('shape', [(30,), (30, 4)])
def test_solves_as_dense_algebra_does(monkeypatch, in_place, shape):
    monkeypatch.setattr(triangular, 'IN_PLACE', in_place)
    rng = np.random.default_rng(1)
    pattern = np.tril(rng.random((30, 30)) < 0.3, -1)
    row, column = np.nonzero(pattern)
    mixed = rng.permutation(len(row))
    system = Recursion(row[mixed], column[mixed], 30)
    for _ in range(2):
        dense = np.where(pattern, rng.normal(size=(30, 30)) / 5.0, 0.0)
        right = rng.normal(size=shape)
        solved = system.solve(dense[row, column][mixed], right.copy())
        assert solved == pytest.approx(np.linalg.solve(np.eye(30) - dense, right))
