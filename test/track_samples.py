# SPDX-License-Identifier: Apache-2.0
"""Tracks of a driver with habits in docs/yard.yaml, and what goes wrong with tracks."""

import numpy as np

START, GOAL = (4.0, 20.0), (56.0, 20.0)
NORTH_OF_HALL = [(34.0, 22.0), (36.5, 30.5), (48.5, 30.5)]
SOUTH_OF_HALL = [(36.0, 16.0), (48.0, 16.0)]
ROUTES = {
    'short': [(30.0, 18.5), (33.0, 18.0), *SOUTH_OF_HALL],
    'north': [(26.0, 24.0), (30.0, 34.5), (34.0, 34.5), (49.0, 31.0)],
    'hall': [(30.0, 19.5), (33.0, 20.0), *NORTH_OF_HALL],
    'south': [(15.0, 14.0), (30.0, 5.0), (33.0, 5.0), (50.0, 13.0)],
}
HABIT = ('hall', 'hall', 'north', 'hall', 'short', 'hall', 'hall', 'north')


def driven(name, rng, step=3.5, noise=0.25):
    """Positions (L, 2) of a receiver on one of ``ROUTES``, a step apart [m]."""
    corners = np.array([START, *ROUTES[name], GOAL])
    along = np.append(0.0, np.hypot(*np.diff(corners, axis=0).T).cumsum())
    at = np.append(np.arange(0.0, along[-1] - 0.5 * step, step), along[-1])
    line = np.column_stack([np.interp(at, along, axis) for axis in corners.T])
    return line + rng.normal(0.0, noise, line.shape)


def habit(weeks, seed=0):
    """Tracks of trips on ``HABIT``, week by week, the last one by the south gate."""
    rng = np.random.default_rng(seed)
    return [driven(name, rng) for name in (*HABIT * weeks, 'south')]
