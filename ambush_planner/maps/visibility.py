"""Who sees a vehicle: the ground from which each cell can be seen, and what is hidden from it.

From each cell rays go out in evenly spaced directions (W. R. Franklin, C. K. Ray, *Higher isn't
necessarily better: visibility algorithms and experiments*, 1994, algorithm R2, with a fixed
number of rays in place of one for each cell of the rim). Along a ray the ground is read where it
crosses the centres of columns (of rows, on rays that are steeper than 45 degrees), linearly between
the two cells there; farther out only at some of the crossings, at most 1/12 of the distance apart,
where 64 rays are 1/10 of it apart. (On rough ground, with a range of 60 cells, exposure comes out
within 0.006 of that by all lines of sight, in the mean.) With

    g = (ground there - height of the vehicle's top) / distance

a person who stands there sees the vehicle, and is seen from it, if g + person's height / distance
is at least the largest g of the samples before. All cells take a step along a ray at once.

Not modelled: vegetation and buildings that are not in the elevation model, the curvature of the
Earth (0.02 m at 0.5 km, 0.3 m at 2 km).
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .elevation import Elevation, HeightArray, InvalidTerrain

# Samples are one cell apart out to this many cells, from there at this share of the distance.
DENSE_CELLS = 12
# Cells (rows, columns) that are worked on at once: what they need stays in the processor's cache.
TILE = (128, 512)
# Sum of the weights of a ray's samples, but for rounding: it must stay below 2^16.
_WHOLE = 60_000


@dataclass(frozen=True)
class ViewOptions:
    """Who looks at what.

    Parameters
    ----------
    weapon_range
        How far a weapon reaches [m].
    vehicle_height
        Of what can be hit, over the ground [m].
    person_height
        Of whoever shoots or comes near, over the ground [m].
    rays
        Number of directions, a multiple of 4; fewer where the range has few cells.

    Raises
    ------
    InvalidTerrain
        A number is out of range.
    """

    weapon_range: float = 300.0
    vehicle_height: float = 2.5
    person_height: float = 1.7
    rays: int = 64

    def __post_init__(self) -> None:
        for name in ('weapon_range', 'vehicle_height', 'person_height'):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise InvalidTerrain(f'{name} must be positive and finite [m], got {value}')
        if self.rays < 4 or self.rays % 4:
            raise InvalidTerrain(f'rays must be a positive multiple of 4, got {self.rays}')


@dataclass(frozen=True, eq=False)
class Views:
    """What is seen from where; both (H, W), NaN where the height is not known.

    Attributes
    ----------
    exposure
        Share 0..1 of the known ground within weapon range from which a vehicle in the cell is seen.
    approach
        Distance of the nearest ground that is hidden from the vehicle [m], the mean over all
        directions: so near somebody comes unseen. A direction whose ground is all in view counts
        with the weapon range.
    """

    exposure: HeightArray
    approach: HeightArray


@dataclass(frozen=True)
class Sample:
    """A place on a ray between two cells.

    ``first`` and ``second`` are their offsets (row, column), ``share`` is what the second one has
    of it; then come its distance [cells] and its weight.
    """

    first: tuple[int, int]
    second: tuple[int, int]
    share: float
    distance: float
    weight: int


def viewshed(
    elevation: Elevation,
    options: ViewOptions | None = None,
    progress: Callable[[float], None] | None = None,
) -> Views:
    """Find for all cells what is seen from them; ``progress`` is told the share that is done.

    Uses all processors that this process may use; the result does not depend on their number.

    Raises
    ------
    InvalidTerrain
        The weapon range is shorter than a cell.
    """
    options = options or ViewOptions()
    rays = rays_of(options.weapon_range / elevation.resolution, options.rays)
    # The second cell of a sample may lie one farther than the sample.
    reach = math.floor(options.weapon_range / elevation.resolution) + 1
    padded = np.pad(elevation.heights, reach, constant_values=np.nan)
    views = Views(np.empty_like(elevation.heights), np.empty_like(elevation.heights))
    tiles = list(_tiles(elevation.heights.shape))

    def work(tile: tuple[slice, slice]) -> None:
        rows, columns = tile
        around = (slice(rows.start, rows.stop + 2 * reach),
                  slice(columns.start, columns.stop + 2 * reach))
        one = _Tile(padded[around], reach, elevation.resolution, options)
        for ray in rays:
            one.follow(ray)
        views.exposure[tile], views.approach[tile] = one.result(len(rays))

    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        for done, _ in enumerate(pool.map(work, tiles), start=1):
            if progress is not None:
                progress(done / len(tiles))
    for layer in (views.exposure, views.approach):
        layer.setflags(write=False)
    return views


def rays_of(reach: float, count: int) -> list[list[Sample]]:
    """Samples of each ray, near to far, within ``reach`` cells; weights are shares of the area.

    The weight of a sample is proportional to its distance times the length of the ray that it
    stands for: rays diverge, so that far samples stand for more ground.

    Raises
    ------
    InvalidTerrain
        ``reach`` is under one cell.
    """
    if reach < 1.0:
        raise InvalidTerrain(
            f'the weapon range is {reach:g} cells: it must reach one cell at least; take a finer '
            'resolution or a longer range'
        )
    count = min(count, 8 * math.floor(reach))
    angles = (np.arange(count) + 0.5) * (2.0 * math.pi / count)
    return [_ray(math.sin(angle), math.cos(angle), reach) for angle in angles]


def _ray(rise: float, run: float, reach: float) -> list[Sample]:
    """One ray in the direction (run, rise), a unit vector."""
    longer = max(abs(rise), abs(run))
    crossings, k = [], 1
    while k <= reach * longer:
        crossings.append((k, max(1, k // DENSE_CELLS)))
        k += crossings[-1][1]
    # On one ray, distance times length is proportional to k times gap. All rays stand for sectors
    # of the same angle, so that each gets the same sum.
    scale = _WHOLE / sum(k * gap for k, gap in crossings) if crossings else 0.0
    return [_sample(rise, run, k, max(1, int(k * gap * scale))) for k, gap in crossings]


def _sample(rise: float, run: float, crossing: int, weight: int) -> Sample:
    """Where a ray crosses the centre of a column or row for the n-th time."""
    is_steep = abs(rise) > abs(run)
    longer, shorter = (rise, run) if is_steep else (run, rise)
    along = int(math.copysign(crossing, longer))
    across = crossing * shorter / abs(longer)
    near = math.floor(across)
    first, second = (along, near), (along, near + 1)
    if not is_steep:
        first, second = first[::-1], second[::-1]
    return Sample(first, second, across - near, crossing / abs(longer), weight)


def _tiles(shape: tuple[int, ...]) -> Iterator[tuple[slice, slice]]:
    for row in range(0, shape[0], TILE[0]):
        for column in range(0, shape[1], TILE[1]):
            yield (
                slice(row, min(row + TILE[0], shape[0])),
                slice(column, min(column + TILE[1], shape[1])),
            )


class _Tile:
    """Cells that follow their rays together; ``window`` holds them and ``reach`` cells around."""

    def __init__(
        self, window: HeightArray, reach: int, resolution: float, options: ViewOptions
    ) -> None:
        self._window = window
        self._all_known = bool(np.isfinite(window).all())
        self._reach = reach
        self._cell = resolution
        self._person = options.person_height
        self._range = options.weapon_range
        self._top = self._shifted((0, 0)) + np.float32(options.vehicle_height)
        self._seen = np.zeros(self._top.shape, np.float32)
        self._ground = np.zeros(self._top.shape, np.float32)
        self._near = np.zeros(self._top.shape, np.float32)

    def _shifted(self, offset: tuple[int, int]) -> HeightArray:
        """Heights that lie at an offset from the tile's cells."""
        row, column = self._reach + offset[0], self._reach + offset[1]
        rows, columns = (count - 2 * self._reach for count in self._window.shape)
        return self._window[row : row + rows, column : column + columns]

    def _heights(self, sample: Sample, out: HeightArray) -> None:
        """Heights of the ground at a sample, seen from each of the tile's cells."""
        first = self._shifted(sample.first)
        np.subtract(self._shifted(sample.second), first, out)
        np.multiply(out, np.float32(sample.share), out)
        np.add(out, first, out)

    def follow(self, ray: list[Sample]) -> None:
        """Add what is seen along one ray."""
        shape = self._top.shape
        horizon = np.full(shape, -np.inf, np.float32)
        angle, bar = np.empty(shape, np.float32), np.empty(shape, np.float32)
        seen, hidden, clear = np.empty(shape, bool), np.empty(shape, bool), np.ones(shape, bool)
        weighted, total = np.empty(shape, np.uint16), np.zeros(shape, np.uint16)
        before = np.zeros(shape, np.uint8 if len(ray) < 256 else np.uint16)
        for sample in ray:
            distance = sample.distance * self._cell
            # Comparisons with NaN are false: what is not known is neither seen nor hidden.
            self._heights(sample, angle)
            np.subtract(angle, self._top, angle)
            np.multiply(angle, np.float32(1.0 / distance), angle)
            np.subtract(horizon, np.float32(self._person / distance), bar)
            np.greater_equal(angle, bar, seen)
            np.less(angle, bar, hidden)
            np.fmax(horizon, angle, horizon)
            np.multiply(seen.view(np.uint8), np.uint16(sample.weight), weighted)
            np.add(total, weighted, total)
            np.greater(clear, hidden, clear)
            np.add(before, clear.view(np.uint8), before)
        self._seen += total
        self._ground += self._ground_on(ray)
        edges = [sample.distance * self._cell for sample in ray] + [self._range]
        self._near += np.array(edges, np.float32)[before]

    def _ground_on(self, ray: list[Sample]) -> npt.NDArray[np.float32] | np.float32:
        """Weight of the ground on a ray that is known."""
        if self._all_known:
            return np.float32(sum(sample.weight for sample in ray))
        total, heights = np.zeros(self._top.shape, np.float32), np.empty_like(self._top)
        for sample in ray:
            self._heights(sample, heights)
            total += np.isfinite(heights) * np.float32(sample.weight)
        return total

    def result(self, rays: int) -> tuple[HeightArray, HeightArray]:
        """Exposure and approach of the tile's cells, once all rays have been followed."""
        with np.errstate(invalid='ignore'):
            exposure = self._seen / self._ground
        unknown = np.isnan(self._top)
        # A cell with no known ground around: nobody can be anywhere.
        exposure = np.where(self._ground > 0.0, exposure, np.float32(0.0))
        return (np.where(unknown, np.float32(np.nan), exposure),
                np.where(unknown, np.float32(np.nan), self._near / rays))
