"""Ground to drive on, for the benchmark of routes: real terrain, a depot, a city, a maze."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter

from ambush_planner import RiskMap
from ambush_planner.commands import demo_ground as fault
from ambush_planner.maps.obstacles import nearest_free_cell
from ambush_planner.maps.occupancy import risk_map_from_occupancy

# Maps of the Nav2 project, beside the checkout where there is one.
DEPOT = Path(__file__).resolve().parents[2] / 'shared' / 'data' / 'nav2_depot'


@dataclass(frozen=True, eq=False)
class Ground:
    """A risk map and the two places [m] between which the convoy drives."""

    risk_map: RiskMap
    start: tuple[float, float]
    goal: tuple[float, float]


def terrain() -> Ground:
    """The demo's ground: 30 km by 32 km with ridges across the way."""
    values = fault.load_ground().values
    return Ground(risk_map_from_occupancy(values, fault.RESOLUTION), fault.START, fault.GOAL)


def depot() -> Ground:
    """Nav2's depot, 30 m by 15 m; a loss of 1 to 10 by its mask of speeds.

    Raises
    ------
    FileNotFoundError
        The maps are not there.
    """
    occupied = 255 - read_pgm(DEPOT / 'depot.pgm').astype(int)
    mask = 255 - read_pgm(DEPOT / 'depot_speed.pgm').astype(int)
    risk_map = RiskMap(1.0 + 9.0 * mask / 255.0, occupied > 0.19 * 255, 0.05)
    return Ground(risk_map, (2.0, 7.0), (28.0, 7.0))


def read_pgm(path: Path) -> npt.NDArray[np.uint8]:
    """Pixels (H, W) of a binary PGM file, its last row first, as maps have it."""
    content, words, at = path.read_bytes(), [], 0
    while len(words) < 4:
        end = content.index(b'\n', at)
        words += content[at:end].split(b'#')[0].split()
        at = end + 1
    width, height = int(words[1]), int(words[2])
    pixels = np.frombuffer(content, np.uint8, width * height, at)
    return pixels.reshape(height, width)[::-1]


def city() -> Ground:
    """800 m by 600 m of blocks of buildings between streets of 10 to 25 m, some of them squares."""
    rng = np.random.default_rng(7)
    rows, columns = 200, 266
    across, along = _streets(rng, rows), _streets(rng, columns)
    obstacles = ~(across[:, None] | along)
    block = np.cumsum(np.diff(across, prepend=False))[:, None] * 1000 + np.cumsum(
        np.diff(along, prepend=False))
    obstacles &= ~np.isin(block, rng.choice(np.unique(block), len(np.unique(block)) // 12))
    risk = gaussian_filter(rng.random((rows, columns)), 12.0)
    risk = (risk - risk.min()) / np.ptp(risk)
    risk_map = RiskMap(1.0 + 9.0 * risk, obstacles, 3.0)
    start, goal = (nearest_free_cell(risk_map, xy, 50.0, 4.0) for xy in ((60, 300), (740, 280)))
    return Ground(risk_map, start, goal)


def _streets(rng: np.random.Generator, cells: int) -> npt.NDArray[np.bool_]:
    """Cells (``cells``,) of a line across the blocks that are street."""
    street, at = np.zeros(cells, dtype=bool), 0
    while at < cells:
        wide = int(rng.integers(4, 9))
        street[at : at + wide] = True
        at += wide + int(rng.integers(9, 22))
    street[-4:] = True
    return street


def maze(rooms: int = 12, side: int = 14) -> Ground:
    """A maze of ``rooms`` x ``rooms`` rooms of 0.7 m, with a third of its dead walls opened."""
    rng = np.random.default_rng(11)
    free = np.zeros((rooms * side + 1,) * 2, dtype=bool)
    for row, column in np.ndindex(rooms, rooms):
        free[row * side + 1 : (row + 1) * side, column * side + 1 : (column + 1) * side] = True
    group = np.arange(rooms * rooms)
    walls = [(k, k + step) for step in (1, rooms) for k in range(rooms * rooms)
             if (k + step < rooms * rooms and (step > 1 or (k + 1) % rooms))]
    for a, b in rng.permutation(walls):
        if group[a] != group[b] or rng.random() < 0.33:
            group[group == group[b]] = group[a]
            _open(free, divmod(int(a), rooms), divmod(int(b), rooms), side)
    alpha = 1.0 + 4.0 * gaussian_filter(rng.random(free.shape), 20.0, mode='nearest')
    width = rooms * side * 0.05
    return Ground(RiskMap(alpha, ~free, 0.05), (0.35, 0.35), (width - 0.3, width - 0.3))


def _open(
    free: npt.NDArray[np.bool_], a: tuple[int, int], b: tuple[int, int], side: int
) -> None:
    """Take away the wall between two rooms."""
    inside = slice(1, side)
    if a[0] == b[0]:
        free[a[0] * side :, b[1] * side][inside] = True
    else:
        free[b[0] * side, a[1] * side :][inside] = True


GROUNDS: dict[str, Callable[[], Ground]] = {
    'terrain': terrain, 'depot': depot, 'city': city, 'maze': maze
}
