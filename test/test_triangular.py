"""Triangular systems of one pattern: against dense algebra, by SuperLU's solve and without it."""

import numpy as np
import pytest

from ambush_planner.game import triangular
from ambush_planner.game.triangular import UnitTriangle


def refused(*_):
    raise TypeError('called otherwise in this scipy')


@pytest.mark.parametrize('solve', ['compiled', None, refused])
@pytest.mark.parametrize('shape', [(30,), (30, 4)])
def test_solves_as_dense_algebra_does(monkeypatch, solve, shape):
    if solve != 'compiled':
        monkeypatch.setattr(triangular, 'gstrs', solve)
    rng = np.random.default_rng(1)
    pattern = np.triu(rng.random((30, 30)) < 0.3, 1) | np.eye(30, dtype=bool)
    system = UnitTriangle(np.nonzero(pattern)[1], np.append(0, np.cumsum(pattern.sum(axis=1))))
    for _ in range(2):
        dense = np.where(pattern, rng.normal(size=(30, 30)) / 5.0, 0.0)
        np.fill_diagonal(dense, 1.0)
        system.data[:] = dense[pattern]
        right = rng.normal(size=shape)
        assert system.solve(right) == pytest.approx(np.linalg.solve(dense, right))
        turned = system.solve(right, transposed=True)
        assert turned == pytest.approx(np.linalg.solve(dense.T, right))
