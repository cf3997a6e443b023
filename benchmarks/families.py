# SPDX-License-Identifier: Apache-2.0
"""Random problems, each drawn from a seed: map, start, goal and all options of a plan.

A problem's name is ``kind:family:nodes:seed``. Nothing is chosen by hand: losses, obstacles,
places, reach, secured area and detour are drawn. Each layer of a trip has about ``nodes`` places.
"""

from __future__ import annotations

import argparse
import math
import secrets
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from report import new_parser
from scenarios import Scenario, across, block, city, maze, terrain
from scipy.ndimage import gaussian_filter, label

from ambush_planner import GameOptions, NetworkOptions, PlanningOptions, RiskMap, StrategyOptions
from ambush_planner.arrays import BoolArray, FloatArray

# One leg with a reach, or without one; trips of one to four stops, crossing edges.
KINDS = ('plan', 'nodes', 'trip', 'grid')
DETOURS = (1.05, 1.1, 1.2, 1.5)  # shortest lengths
OBSTACLES = 0.08  # share of the cells
# Cells per node along a line, least and most; larger maps have finer features, not more of them.
CELLS_PER_NODE = 1.3, 6.0
# Maximum reach, as a share of the distance from start to goal: the secured area leaves some ground.
MAX_REACH = 0.2

Position = tuple[float, float]


@dataclass(frozen=True, eq=False)
class Problem:
    """A scenario, its stops, the options of a plan, and what was drawn in words."""

    scenario: Scenario
    options: PlanningOptions
    stops: tuple[Position, ...]
    words: str


def draw(name: str) -> Problem:
    """The problem ``kind:family:nodes:seed``, without a time limit."""
    kind, family, nodes, seed = name.split(':')
    rng = np.random.default_rng([int(seed), list(FAMILIES).index(family), KINDS.index(kind)])
    fine = CELLS_PER_NODE[0]  # at the nodes, finer cells change nothing
    if kind != 'nodes':
        fine = math.exp(rng.uniform(*np.log(CELLS_PER_NODE)))
    scenario = FAMILIES[family](rng, round(fine * math.sqrt(int(nodes))))
    spacing = spacing_for(scenario.risk_map, int(nodes))
    reach, secured = _reach_and_secured(kind, rng, scenario, spacing)
    detour = scenario.detour or float(rng.choice(DETOURS))
    count = 1 + rng.integers(4) if kind == 'trip' else 0
    options = PlanningOptions(
        network=NetworkOptions(method='uniform_grid8' if kind == 'grid' else 'uniform_delaunay',
                               spacing=spacing, refine=0),
        game=GameOptions(ambush_radius=reach * spacing,
                         secured_radius=None if secured < 0.0 else secured * spacing),
        strategy=StrategyOptions(max_detour=detour, time_limit=math.inf), max_gap=math.inf)
    rows, columns = scenario.risk_map.alpha.shape
    words = (f'{rows} x {columns} cells reach {reach:.2g} secured {secured:.2g} '
             f'detour {detour:.3g} stops {count}')
    return Problem(scenario, options, _places(rng, scenario.risk_map, int(count)), words)


def spacing_for(risk_map: RiskMap, nodes: int) -> float:
    """The spacing [m] of about ``nodes`` nodes, never below the resolution."""
    free = float((~risk_map.obstacles).sum()) * risk_map.resolution**2
    return max(risk_map.resolution, math.sqrt(free / nodes))


def _reach_and_secured(kind: str, rng: np.random.Generator, scenario: Scenario,
                    spacing: float) -> tuple[float, float]:
    """Reach and radius of the secured area [spacings]; -1: as far as the reach."""
    if kind == 'nodes':
        return 0.0, 0.03 * max(scenario.risk_map.size) / spacing
    if kind == 'plan':
        most = MAX_REACH * math.dist(scenario.start, scenario.goal) / spacing
        reach = float(rng.uniform(1.0, max(min(6.0, most), 1.0)))
        return reach, float(rng.choice([-1.0, reach, 2.0 * reach]))
    reach = float(rng.integers(1 if kind == 'grid' else 0, 4))
    return reach, float(rng.choice([1.0, 1.5, 2.0])) * reach or 2.0


def connected_ground(obstacles: BoolArray) -> BoolArray:
    """The largest part of the free cells that are connected by their sides."""
    ground, _ = label(~obstacles)
    largest: BoolArray = ground == np.bincount(ground[ground > 0]).argmax()
    return largest


def _places(rng: np.random.Generator, risk_map: RiskMap, count: int) -> tuple[Position, ...]:
    """The centres of free cells on the largest connected ground [m]."""
    free = np.argwhere(connected_ground(risk_map.obstacles))[:, ::-1]
    cells = free[rng.choice(len(free), count, replace=False)]
    return tuple((float(x), float(y)) for x, y in risk_map.resolution * (cells + 0.5))


# Makes a scenario on a map whose sides have about the given number of cells.
Family = Callable[[np.random.Generator, int], Scenario]


def _noise(rng: np.random.Generator, shape: tuple[int, ...], smooth: float) -> FloatArray:
    """Smooth noise in 0..1; ``smooth`` is the filter's width in cells, 0: independent cells."""
    noise = rng.random(shape)
    if smooth > 0.0:
        noise = gaussian_filter(noise, smooth, mode='reflect')
    return np.asarray((noise - noise.min()) / np.ptp(noise))


def _across(alpha: FloatArray, obstacles: BoolArray) -> Scenario:
    """From the middle of the left edge to the middle of the right one, on connected ground."""
    return across(RiskMap(alpha, ~connected_ground(obstacles), 1.0), 0.04)


def _hills(roughness: float, obstacles: float = 0.0, ratio: int = 1) -> Family:
    """Smooth losses 1..10 with features of ``roughness`` of the map, ``ratio`` times as long."""

    def make(rng: np.random.Generator, cells: int) -> Scenario:
        shape = round(cells / math.sqrt(ratio)), round(cells * math.sqrt(ratio))
        smooth = roughness * cells
        alpha = 1.0 + 9.0 * _noise(rng, shape, smooth)
        blocked = _noise(rng, shape, max(smooth / 2.0, 1.0))
        return _across(alpha, blocked > np.quantile(blocked, 1.0 - obstacles))

    return make


def _gates(rng: np.random.Generator, cells: int) -> Scenario:
    """A wall with a gate ahead and one to the side; the budget allows nearly half through it."""
    alpha = 1.0 + 2.0 * _noise(rng, (cells, cells), 0.1 * cells)
    wall = np.zeros((cells, cells), dtype=bool)
    middle, gate, aside = cells // 2, max(cells // 20, 4), rng.uniform(0.2, 0.42) * cells
    wall[:, middle : middle + max(cells // 40, 2)] = True
    for row in (middle, middle - round(aside)):
        wall[row - gate // 2 : row + gate // 2 + 1] = False
    by_the_side = math.hypot(0.46 * cells, aside) / (0.46 * cells)
    share = 0.5 * rng.uniform(0.9, 1.1)
    return replace(_across(alpha, wall), detour=1.0 + share * (by_the_side - 1.0))


def _building(rng: np.random.Generator, cells: int) -> Scenario:
    """A floor plan twice as long as wide: halls split at random, with two doors in each wall."""
    shape = round(cells / math.sqrt(2.0)), round(cells * math.sqrt(2.0))
    wall = np.zeros(shape, dtype=bool)
    rooms = [(0, 0, *shape)]
    door = max(cells // 16, 4)
    while rooms:
        top, left, bottom, right = rooms.pop()
        tall = bottom - top > right - left
        long, wide = (bottom - top, right - left) if tall else (right - left, bottom - top)
        if long < 6 * door or wide < 3 * door:
            continue
        at = round(long * rng.uniform(0.3, 0.7))
        line = wall[top + at, left:right] if tall else wall[top:bottom, left + at]
        line[:] = True
        for _ in range(2):
            begin = int(rng.integers(1, wide - door))
            line[begin : begin + door] = False
        rooms += ([(top, left, top + at, right), (top + at, left, bottom, right)] if tall else
                  [(top, left, bottom, left + at), (top, left + at, bottom, right)])
    for _ in range(20):  # shelves
        row, column = rng.integers(0, shape[0]), rng.integers(0, shape[1])
        wall[row : row + door // 3, column : column + 2 * door] = True
    return _across(1.0 + 9.0 * _noise(rng, shape, 0.05 * cells), wall)


def _waves(rng: np.random.Generator, cells: int) -> Scenario:
    """Losses 1..10 of six waves, impassable where they are largest."""
    y, x = (np.mgrid[0:cells, 0:cells] + 0.5) / cells
    sines = sum(np.sin(7 * a * x + 7 * b * y + 3 * c) for a, b, c in rng.normal(size=(6, 3)))
    height = np.asarray((sines - np.min(sines)) / np.ptp(sines))
    return _midway(height, height > np.quantile(height, 0.92))


def _patches(rng: np.random.Generator, cells: int) -> Scenario:
    """Losses 1..10 of patches of 6 cells, among obstacles of 9."""
    losses, blocked = (gaussian_filter(rng.normal(size=(cells, cells)), each) for each in (6, 9))
    return _midway(losses, blocked > np.quantile(blocked, 0.9))


def _free_walls(rng: np.random.Generator, cells: int) -> Scenario:
    """26 straight walls that need not meet."""
    wall = np.zeros((cells, cells), dtype=bool)
    for _ in range(26):
        x, y = rng.integers(10, cells - 10, 2)
        length = rng.integers(20, 60)
        if rng.random() < 0.5:
            wall[y - 1 : y + 1, x : x + length] = True
        else:
            wall[y : y + length, x - 1 : x + 1] = True
    return _midway(gaussian_filter(rng.normal(size=(cells, cells)), 10), wall)


def _midway(height: FloatArray, obstacles: BoolArray) -> Scenario:
    """From left to right at half the height, between free cells 6 % inside the map."""
    alpha, cells = 1.0 + 9.0 * (height - height.min()) / np.ptp(height), len(height)
    free = np.argwhere(~obstacles)[:, ::-1]
    start, goal = (free[((free - (share * cells, 0.5 * cells))**2).sum(axis=1).argmin()] + 0.5
                   for share in (0.06, 0.94))
    return Scenario(RiskMap(alpha, obstacles, 1.0), tuple(start.tolist()), tuple(goal.tolist()))


def _between_random_ends(make: Family) -> Family:
    """Start and goal anywhere on a scenario's map, at least half its width apart."""

    def drawn(rng: np.random.Generator, cells: int) -> Scenario:
        risk_map = make(rng, cells).risk_map
        free = np.argwhere(connected_ground(risk_map.obstacles))[:, ::-1]
        while True:
            ends = free[rng.choice(len(free), 2, replace=False)]
            if math.dist(*ends) >= 0.5 * max(risk_map.obstacles.shape):
                start, goal = map(tuple, (risk_map.resolution * (ends + 0.5)).tolist())
                return Scenario(risk_map, start, goal)

    return drawn


FAMILIES: dict[str, Family] = {
    'hills-coarse': _hills(0.12),
    'hills-fine': _hills(0.02),
    'hills-obstacles': _hills(0.05, OBSTACLES),
    'hills-thicket': _hills(0.02, 2.0 * OBSTACLES),
    'rough': _hills(0.0),
    'rough-obstacles': _hills(0.0, OBSTACLES),
    'corridor': _hills(0.05, OBSTACLES, ratio=12),
    'gates': _gates,
    'building': _building,
    'city': _between_random_ends(lambda rng, _: city(int(rng.integers(2**31)))),
    'maze': _between_random_ends(lambda rng, _: maze(seed=int(rng.integers(2**31)))),
    'terrain': _between_random_ends(lambda *_: terrain()),
    'block': lambda _, cells: _across(block(cells).alpha, block(cells).obstacles),
}


# Families of large maps only, whose default plans are slow.
SLOW: dict[str, Family] = {'waves': _waves, 'patches': _patches, 'free-walls': _free_walls}


def problem_parser(description: str | None) -> argparse.ArgumentParser:
    """A command line with ``--families``, ``--each``, ``--seed`` and ``--limit``."""
    parser = new_parser(description)
    parser.add_argument('--families', nargs='+', default=list(FAMILIES), choices=list(FAMILIES))
    parser.add_argument('--each', type=int, default=2, help='problems of each family')
    parser.add_argument('--seed', type=int, default=secrets.randbelow(10**9),
                        help='the first seed, new in each run')
    parser.add_argument('--limit', type=float, default=300.0, help='of each problem [s]')
    return parser
