# SPDX-License-Identifier: Apache-2.0
"""The risk map: the loss for being ambushed in each cell, and the obstacles.

Row 0 is the lowest row and column 0 the leftmost, as in ``nav_msgs/OccupancyGrid``. *Map axes*
(u, v) measure metres along columns and rows from the lower left corner of cell (0, 0); the centre
of cell (row, column) lies at (column + 0.5, row + 0.5) * resolution. *World* coordinates (x, y)
result from the rotation and translation of ``origin``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy  # loads ndimage when it is used

from ..arrays import BoolArray, FloatArray, IndexArray, frozen_array, pooled
from ..errors import InvalidRiskMap
from ..notebook import Shown

# Distance at which a position counts as touching a cell [cells]; covers the rounding of positions
# such as (i + 0.5) * resolution, and of their conversion to world coordinates and back.
TOUCH = 1e-6
# Range of the losses over 0 for which the solvers are tested.
MIN_LOSS, MAX_LOSS = 1e-9, 1e9
# Losses of an occupancy grid's values 0 and 100 by default.
LOSSES = (1.0, 10.0)
# Maximum number of cells of a map in which obstacles and passes are looked for one by one, instead
# of in blocks of cells first.
_MAX_CELLS = 4_000_000


# Maximum number of grades of losses.
GRADES = 256


class GradedLosses(np.lib.mixins.NDArrayOperatorsMixin):
    """Losses (H, W) of at most 256 grades, which take a byte a cell instead of eight.

    Indices and masks read losses as those of an array do. Everything else that arrays can do works,
    too, on a whole array that is made for it.

    Parameters
    ----------
    levels : (G,) float
        The loss of each grade, ascending.
    grades : (H, W) uint8
    """

    ndim, dtype = 2, np.dtype(np.float64)

    def __init__(self, levels: npt.ArrayLike, grades: npt.NDArray[np.uint8]) -> None:
        self.levels = frozen_array(levels, np.float64)
        self.grades = frozen_array(grades, np.uint8)
        self.shape, self.size = self.grades.shape, self.grades.size

    def __len__(self) -> int:
        return len(self.grades)

    def __getitem__(self, key: Any) -> Any:
        return self.levels[self.grades[key]]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> npt.NDArray[Any]:
        return np.asarray(self.levels[self.grades], dtype)

    def __array_ufunc__(self, function: np.ufunc, method: str, *inputs: Any, **given: Any) -> Any:
        whole = (np.asarray(each) if isinstance(each, GradedLosses) else each for each in inputs)
        return getattr(function, method)(*whole, **given)

    def __getattr__(self, name: str) -> Any:
        if name.startswith('__') or 'grades' not in vars(self):
            raise AttributeError(name)
        return getattr(np.asarray(self), name)


@dataclass(frozen=True, eq=False, repr=False)
class RiskMap(Shown):
    """Loss for being ambushed in each cell.

    Parameters
    ----------
    alpha : (H, W) float, >= 0
        Loss for being ambushed in each cell; ignored in obstacle cells, so it may be NaN there.
    obstacles : (H, W) bool
        Cells that cannot be driven through.
    resolution : float
        Cell size [m].
    origin : (x, y, yaw)
        World pose of the lower left corner of cell (0, 0) [m, m, rad].
    crs : str or None
        Coordinate system of world positions, as ``coordinates`` reads it; None if unknown.
    unknown : (H, W) bool or None
        Obstacle cells that nobody has mapped, for pictures; None: no cell.

    Raises
    ------
    InvalidRiskMap
        A shape, the resolution, the origin or a loss is invalid.
    """

    alpha: FloatArray
    obstacles: BoolArray
    resolution: float
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    crs: str | None = None
    unknown: BoolArray | None = None

    def __post_init__(self) -> None:
        try:
            alpha: Any = self.graded or frozen_array(self.alpha, np.float64)
            obstacles = frozen_array(self.obstacles, np.bool_)
            origin = tuple(float(value) for value in self.origin)
            resolution = float(self.resolution)
        except (TypeError, ValueError, OverflowError) as error:
            raise InvalidRiskMap(f'risk map: not numeric: {error}') from error
        _check_layers(alpha, obstacles)
        check_place(resolution, origin)
        for name, value in (('alpha', alpha), ('obstacles', obstacles)):
            object.__setattr__(self, name, value)
        if self.unknown is not None:
            if np.shape(self.unknown) != alpha.shape:
                raise InvalidRiskMap(f"unknown must have alpha's shape {alpha.shape}, got "
                                     f'{np.shape(self.unknown)}')
            object.__setattr__(self, 'unknown', frozen_array(self.unknown, np.bool_))
        object.__setattr__(self, 'resolution', resolution)
        object.__setattr__(self, 'origin', origin)

    def _summary(self) -> dict[str, str]:
        rows, columns = self.alpha.shape
        loss = '{:.4g} to {:.4g}'.format(*self.loss_range) if self.loss_range else 'none'
        return {'cells': f'{columns} x {rows} of {self.resolution:.4g} m', 'loss': loss,
                'obstacles': f'{self.obstacles.mean():.1%}', 'crs': self.crs or 'unknown'}

    @property
    def size(self) -> tuple[float, float]:
        """Width and height [m]."""
        rows, columns = self.alpha.shape
        return columns * self.resolution, rows * self.resolution

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Lowest and highest world coordinates (2,) of the map [m]."""
        width, height = self.size
        corners = self.to_world([(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)])
        return corners.min(axis=0), corners.max(axis=0)

    @cached_property
    def loss_range(self) -> tuple[float, float] | None:
        """Least and greatest loss of free cells; None if no cell is free."""
        free, graded = ~self.obstacles, self.graded
        if not free.any():
            return None
        if graded is None:
            return (float(self.alpha.min(where=free, initial=np.inf)),
                    float(self.alpha.max(where=free, initial=-np.inf)))
        least, most = graded.levels[[graded.grades.min(where=free, initial=GRADES - 1),
                                     graded.grades.max(where=free, initial=0)]].tolist()
        return least, most

    @property
    def graded(self) -> GradedLosses | None:
        """The losses, if they are kept in grades."""
        alpha: Any = self.alpha
        return alpha if isinstance(alpha, GradedLosses) else None

    def _losses_of(self, cells: Callable[[npt.NDArray[Any]], npt.NDArray[Any]]) -> Any:
        """The losses of a part of the map, or of blocks of cells."""
        graded = self.graded
        return GradedLosses(graded.levels, cells(graded.grades)) if graded else cells(self.alpha)

    @cached_property
    def obstacle_blocks(self) -> tuple[BoolArray, int]:
        """Blocks of cells that have an obstacle, and how many cells each has a side."""
        block = max(math.ceil(math.sqrt(self.obstacles.size / _MAX_CELLS)), 1)
        return pooled(np.logical_or, self.obstacles, block), block

    def part(self, rows: slice, columns: slice) -> RiskMap:
        """The map of some rows and columns, which begin on this one."""
        at = rows, columns
        x, y = self.to_world(np.multiply((columns.start, rows.start), self.resolution)).tolist()
        return replace(
            self, alpha=self._losses_of(lambda cells: cells[at]), obstacles=self.obstacles[at],
            origin=(x, y, self.origin[2]),
            unknown=None if self.unknown is None else self.unknown[at])

    def coarser(self, most: int) -> RiskMap:
        """The map for pictures of at most ``most`` cells a side: of blocks of cells.

        Each block has its greatest loss, and is an obstacle if any of its cells is.
        """
        block = math.ceil(max(self.alpha.shape) / most)
        if block == 1:
            return self
        return RiskMap(
            self._losses_of(lambda cells: pooled(np.fmax, cells, block)),
            pooled(np.logical_or, self.obstacles, block), block * self.resolution, self.origin,
            self.crs, None if self.unknown is None else pooled(np.logical_and, self.unknown, block))

    def nearest_free_alpha(self) -> FloatArray:
        """Loss (H, W) of each cell, or of the nearest free cell in obstacles; 0 if none is free."""
        if self.obstacles.all():
            return np.zeros(self.alpha.shape)
        nearest = scipy.ndimage.distance_transform_edt(self.obstacles, return_distances=False,
                                         return_indices=True)
        return np.asarray(self.alpha[tuple(nearest)])

    def to_map_axes(self, xy: npt.ArrayLike) -> FloatArray:
        """Convert world positions (..., 2) to map axes (..., 2) [m]."""
        return to_map_axes(self.origin, xy)

    def to_world(self, uv: npt.ArrayLike) -> FloatArray:
        """Convert positions in map axes (..., 2) to world positions (..., 2) [m]."""
        return to_world(self.origin, uv)

    def contains(self, uv: npt.ArrayLike) -> BoolArray:
        """Return which positions in map axes (..., 2) lie on the map or its outer edge."""
        uv = np.asarray(uv, dtype=np.float64)
        inside: BoolArray = np.all((uv >= 0.0) & (uv <= self.size), axis=-1)
        return inside

    def cells(self, uv: npt.ArrayLike) -> tuple[IndexArray, IndexArray]:
        """Return (rows, columns) of the cells that contain positions in map axes (..., 2)."""
        return cells_at(uv, self.resolution, self.alpha.shape)


def to_map_axes(origin: tuple[float, float, float], xy: npt.ArrayLike) -> FloatArray:
    """Convert world positions (..., 2) to the axes of a map at ``origin`` (..., 2) [m]."""
    x0, y0, yaw = origin
    shifted = np.asarray(xy, dtype=np.float64) - (x0, y0)
    return shifted if yaw == 0.0 else shifted @ _rotation(yaw)


def to_world(origin: tuple[float, float, float], uv: npt.ArrayLike) -> FloatArray:
    """Convert positions in the axes of a map at ``origin`` (..., 2) to world positions [m]."""
    x0, y0, yaw = origin
    uv = np.asarray(uv, dtype=np.float64)
    return (uv if yaw == 0.0 else uv @ _rotation(yaw).T) + (x0, y0)


def cells_at(uv: npt.ArrayLike, resolution: float,
             shape: tuple[int, ...]) -> tuple[IndexArray, IndexArray]:
    """Return (rows, columns) of the cells that contain positions in map axes (..., 2) [m].

    A position within ``TOUCH`` of a border belongs to the cell above or on the right, however it
    was rounded; on the map's upper and right border, to the last cells. Positions must lie on the
    map, whose shape is (H, W).
    """
    index = np.floor(np.asarray(uv, dtype=np.float64) / resolution + TOUCH).astype(np.int64)
    return (np.clip(index[..., 1], 0, shape[0] - 1), np.clip(index[..., 0], 0, shape[1] - 1))


def _rotation(yaw: float) -> FloatArray:
    """Matrix whose columns are the map axes in the world."""
    return np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])


def check_place(resolution: float, origin: tuple[float, ...]) -> None:
    """Check resolution [m] and origin (x, y, yaw) of a map; raises InvalidRiskMap."""
    if not (math.isfinite(resolution) and resolution > 0):
        raise InvalidRiskMap(f'resolution must be positive and finite, got {resolution}')
    if len(origin) != 3 or not all(map(math.isfinite, origin)):
        raise InvalidRiskMap(f'origin must be three finite numbers (x, y, yaw), got {origin}')


def _check_layers(alpha: Any, obstacles: BoolArray) -> None:
    if alpha.ndim != 2 or alpha.size == 0:
        raise InvalidRiskMap(f'alpha must be a non-empty (H, W) array, got shape {alpha.shape}')
    if obstacles.shape != alpha.shape:
        raise InvalidRiskMap(
            f"obstacles must have alpha's shape {alpha.shape}, got {obstacles.shape}"
        )
    if isinstance(alpha, GradedLosses) and (
            np.isfinite(alpha.levels) & (alpha.levels >= 0.0)).all():
        return
    bad = ~(np.isfinite(alpha) & (alpha >= 0.0)) & ~obstacles
    if bad.any():
        row, column = (int(k) for k in np.argwhere(bad)[0])
        raise InvalidRiskMap(
            f'alpha must be finite and >= 0, got {alpha[row, column]} at row {row}, '
            f'column {column} ({int(bad.sum())} such cells)'
        )
