# SPDX-License-Identifier: Apache-2.0
"""Maps with start and goal for the benchmarks: terrain, a city, a maze, and a formula."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter

from ambush_planner import RiskMap
from ambush_planner.arrays import BoolArray
from ambush_planner.maps.occupancy import risk_from_occupancy

# The demo's terrain, and for the scripts that draw problems the oracles of the tests.
ROOT = Path(__file__).resolve().parents[1]
sys.path += [str(ROOT), str(ROOT / 'test')]
from examples.demo import ground as demo_ground  # noqa: E402

# Side length of the map ``block`` [m].
SIDE = 100.0


@dataclass(frozen=True, eq=False)
class Scenario:
    """A risk map with start and goal [m], and the detour that makes it hard; None: any."""

    risk_map: RiskMap
    start: tuple[float, float]
    goal: tuple[float, float]
    detour: float | None = None


def nearest_free(risk_map: RiskMap, uv: tuple[float, float]) -> tuple[float, float]:
    """Centre of the free cell nearest to a position in map axes [m]."""
    centres = (np.argwhere(~risk_map.obstacles)[:, ::-1] + 0.5) * risk_map.resolution
    x, y = risk_map.to_world(centres[np.argmin(((centres - uv) ** 2).sum(axis=1))]).tolist()
    return x, y


def across(risk_map: RiskMap, margin: float) -> Scenario:
    """From left to right, half-way up, with a margin [widths] at both ends."""
    width, height = risk_map.size
    start, goal = (nearest_free(risk_map, (share * width, height / 2))
                   for share in (margin, 1.0 - margin))
    return Scenario(risk_map, start, goal)


def block(cells: int) -> RiskMap:
    """Two smooth rises of risk and a square obstacle in the centre, ``cells`` x ``cells``."""
    centre = (np.arange(cells) + 0.5) / cells
    u, v = np.meshgrid(centre, centre)
    south_east = np.exp(-((u - 0.7) ** 2 + (v - 0.25) ** 2) / 0.08)
    north_west = np.exp(-((u - 0.3) ** 2 + (v - 0.8) ** 2) / 0.05)
    obstacles = (np.abs(u - 0.5) < 0.12) & (np.abs(v - 0.5) < 0.12)
    return RiskMap(1.0 + 4.0 * south_east + 2.0 * north_west, obstacles, SIDE / cells)


def terrain() -> Scenario:
    """The demo's terrain: 30 km by 32 km with ridges between start and goal."""
    risk_map = risk_from_occupancy(demo_ground.load_ground().values, demo_ground.RESOLUTION)
    return Scenario(risk_map, demo_ground.START, demo_ground.GOAL)


def city(seed: int = 7) -> Scenario:
    """800 m by 600 m of building blocks between streets 10 to 25 m wide, with some squares."""
    rng = np.random.default_rng(seed)
    rows, columns = 200, 266
    across, along = _streets(rng, rows), _streets(rng, columns)
    obstacles = ~(across[:, None] | along)
    number = np.cumsum(np.diff(across, prepend=False))[:, None] * 1000 + np.cumsum(
        np.diff(along, prepend=False))
    squares = rng.choice(np.unique(number), len(np.unique(number)) // 12)
    obstacles &= ~np.isin(number, squares)
    risk = gaussian_filter(rng.random((rows, columns)), 12.0)
    risk = (risk - risk.min()) / np.ptp(risk)
    risk_map = RiskMap(1.0 + 9.0 * risk, obstacles, 3.0)
    start, goal = (nearest_free(risk_map, xy) for xy in ((60, 300), (740, 280)))
    return Scenario(risk_map, start, goal)


def _streets(rng: np.random.Generator, cells: int) -> BoolArray:
    """Which cells (``cells``,) of a line across the blocks are street."""
    street, at = np.zeros(cells, dtype=bool), 0
    while at < cells:
        width = int(rng.integers(4, 9))
        street[at : at + width] = True
        at += width + int(rng.integers(9, 22))
    street[-4:] = True
    return street


def maze(rooms: int = 12, side: int = 14, seed: int = 11) -> Scenario:
    """A maze of ``rooms`` x ``rooms`` rooms of 0.7 m, with a third of its spare walls removed."""
    rng = np.random.default_rng(seed)
    free = np.zeros((rooms * side + 1,) * 2, dtype=bool)
    for row, column in np.ndindex(rooms, rooms):
        free[row * side + 1 : (row + 1) * side, column * side + 1 : (column + 1) * side] = True
    group = np.arange(rooms * rooms)
    walls = [(k, k + step) for step in (1, rooms) for k in range(rooms * rooms)
             if (k + step < rooms * rooms and (step > 1 or (k + 1) % rooms))]
    for a, b in rng.permutation(walls):
        if group[a] != group[b] or rng.random() < 0.33:
            group[group == group[b]] = group[a]
            _remove_wall(free, divmod(int(a), rooms), divmod(int(b), rooms), side)
    alpha = 1.0 + 4.0 * gaussian_filter(rng.random(free.shape), 20.0, mode='nearest')
    width = rooms * side * 0.05
    return Scenario(RiskMap(alpha, ~free, 0.05), (0.35, 0.35), (width - 0.3, width - 0.3))


def _remove_wall(free: BoolArray, a: tuple[int, int], b: tuple[int, int], side: int) -> None:
    """Remove the wall between two rooms."""
    inside = slice(1, side)
    if a[0] == b[0]:
        free[a[0] * side :, b[1] * side][inside] = True
    else:
        free[b[0] * side, a[1] * side :][inside] = True
