# SPDX-License-Identifier: Apache-2.0
"""Risk maps combined from layers: terrain, polygons, roads and incidents.

A YAML file has one line per layer; they apply from top to bottom, by the formulas of
docs/risk_layers.md. Features that cannot be used are counted in a warning, and are an error if they
are forbidden or held.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..arrays import BoolArray, FloatArray
from ..errors import AmbushPlannerError
from ..option_checks import check_at_least
from .coordinates import Coordinates, is_robot_frame
from .elevation import MAX_CELLS
from .incidents import kernel_density, weighted_incidents
from .map_file import read_yaml
from .occupancy import OccupancyOptions
from .risk_map import MIN_LOSS, RiskMap
from .road_file import places_in
from .road_tags import select_roads
from .tables import InvalidFeatures
from .terrain_risk import TerrainOptions, terrain_of_file
from .vector_file import attribute_values, read_features_on
from .visibility import ViewOptions

if TYPE_CHECKING:
    from geopandas import GeoDataFrame, GeoSeries
    from geopandas.base import GeoPandasBase

# The keys of the file, and of each kind of line, with their defaults.
_TOP = {'layers': None, 'base': 1.0, 'resolution': 0.0, 'bounds': None, 'crs': None}
_VIEW = ('weapon_range', 'vehicle_height', 'person_height')
_SHAPES = {'loss': 0.0, 'factor': 1.0, 'passable': False, 'forbidden': False, 'held': False}
_KINDS: Mapping[str, Mapping[str, Any]] = {
    'terrain': {'loss': 9.0, **dict.fromkeys((*_VIEW, 'slope_limit', 'weights'))},
    'polygons': {**_SHAPES, 'buffer': 0.0},
    'roads': {**_SHAPES, 'width': 0.0, 'road_column': '', 'all_lines_are_roads': False},
    'incidents': {'loss': 9.0, 'bandwidth': None, 'half_life': math.inf, 'date': 'date',
                  'weight': 1.0},
}
_GEOMETRIES = {'polygons': ('Polygon', 'LineString', 'Point'), 'roads': ('LineString',),
               'incidents': ('Point',)}
# With fewer incidents of full weight, a density is mostly chance.
FEW = 20.0
# Positions (x, y) [m] in the world, and names.
Names = tuple[tuple[float, float, str], ...]


class InvalidLayers(AmbushPlannerError, ValueError):
    """The description of layers is malformed."""


@dataclass(frozen=True, eq=False)
class Layer:
    """A vector layer, for pictures.

    ``kind`` is that of the line, ``shapes`` (the borders of polygons) and ``names`` those in the
    ``file``.
    """

    kind: str
    file: str
    shapes: GeoPandasBase
    names: Names = ()


@dataclass(frozen=True, eq=False)
class LayeredRisk:
    """A risk map with its layers, and remarks for the user."""

    risk_map: RiskMap
    layers: tuple[Layer, ...]
    remarks: tuple[str, ...]


def risk_from_layers(description: Path | str | Mapping[str, Any], folder: Path | None = None,
                     progress: Callable[[float], None] | None = None) -> LayeredRisk:
    """Combine the layers of a YAML file, or of its content, by the formulas of docs/risk_layers.md.

    The grid is that of the terrain, which must be the first layer; without it, that of ``bounds``
    [west, south, east, north], ``resolution`` [m] and ``crs``. Files are relative to ``folder``, by
    default that of the YAML file. ``progress`` is called with the completed share of the terrain.

    Raises InvalidLayers, whose message names the layer, InvalidOption or OSError.
    """
    if not isinstance(description, Mapping):
        file = Path(description)
        folder, description = folder or file.parent, read_yaml(file, InvalidLayers)
        if 'layers' not in description:
            hint = '; it is a map for map_server' * ('image' in description)
            raise InvalidLayers(f'{file}: layers is missing{hint}; see docs/risk_layers.md')
    top = _with_defaults('the top of the file', description, _TOP)
    if not isinstance(top['layers'], list) or not top['layers']:
        raise InvalidLayers('layers must be a list with a line for each layer')
    lines = [_line(k, line) for k, line in enumerate(top['layers'], start=1)]
    base, crs = _number('base', top['base']), str(top['crs']) if top['crs'] else None
    joined: _Joined | None = None
    for number, (kind, values) in enumerate(lines, start=1):
        path = (folder or Path()) / Path(str(values[kind])).expanduser()
        try:
            if kind == 'terrain':
                if joined:
                    raise InvalidLayers('must be the first layer and the only terrain, since it '
                                        'gives the grid')
                joined = _terrain(path, crs, values, _number('resolution', top['resolution']),
                                  progress)
                joined.loss += base
                continue
            joined = joined or _without_terrain(top, base)
            whole = [key for key in ('forbidden', 'held') if values.get(key)]
            features = read_features_on(
                joined.ground, str(path), *_GEOMETRIES[kind], crs=crs,
                refused=f'{whole[0]} ground must be whole' if whole else '')
            if kind == 'roads':
                roads, *_ = select_roads(str(path), features, values['road_column'],
                                       values['all_lines_are_roads'], two_way=True)
                if whole and len(roads) < len(features):
                    raise InvalidFeatures(
                        f'{path.name}: {whole[0]} ground must be whole; put lines that are no '
                        'roads into a layer of polygons with a buffer')
                features = roads
            if kind == 'incidents':
                joined.add_incidents(path.name, features, values)
                continue
            joined.add_shapes(path.name, features, values)
            joined.layers[-1] = replace(joined.layers[-1], names=(
                _places(path, joined.ground.crs) if kind == 'roads' else _named(features)))
        except (AmbushPlannerError, OSError, TypeError, ValueError) as error:
            where = '' if path.name in str(error) else f'{path.name}: '
            raise InvalidLayers(f'layer {number} ({kind}): {where}{error}') from error
    assert joined is not None  # there is a line
    return joined.result()


def _places(path: Path, crs: str | None) -> Names:
    """Return the names of the places in a file of roads."""
    if (found := places_in(path)) is None:
        return ()
    lat_lon = np.column_stack((found.geometry.y, found.geometry.x))
    x, y = Coordinates(crs or '').from_lat_lon(lat_lon).T.tolist()
    return tuple(zip(x, y, found['name'], strict=True))


def _named(features: GeoDataFrame) -> Names:
    """Return the names of shapes."""
    if 'name' not in features:
        return ()
    named = features[features['name'].notna()]
    at = named.representative_point()
    return tuple(zip(at.x, at.y, map(str, named['name']), strict=True))


def _line(number: int, line: Any) -> tuple[str, Mapping[str, Any]]:
    """The kind of a line, and its values with defaults."""
    kinds = [kind for kind in _KINDS if isinstance(line, Mapping) and kind in line]
    if len(kinds) != 1:
        raise InvalidLayers(f'layer {number} needs one of {", ".join(_KINDS)}, with a file')
    (kind,) = kinds
    return kind, _with_defaults(f'layer {number} ({kind})', line, {kind: '', **_KINDS[kind]})


def _with_defaults(where: str, given: Mapping[str, Any],
                   defaults: Mapping[str, Any]) -> Mapping[str, Any]:
    if unknown := [str(key) for key in given if key not in defaults]:
        raise InvalidLayers(f'{where}: unknown {", ".join(unknown)}; choose from '
                            f'{", ".join(defaults)}')
    return {**defaults, **given}


def _terrain(path: Path, crs: str | None, values: Mapping[str, Any], resolution: float,
             progress: Callable[[float], None] | None) -> _Joined:
    given = {key: each for key, each in values.items() if each is not None}
    view = ViewOptions(**{key: given[key] for key in _VIEW if key in given})
    options = {key: given[key] for key in ('slope_limit', 'weights') if key in given}
    made = terrain_of_file(path, TerrainOptions(view=view, **options), resolution, crs=crs,
                           progress=progress)
    ground = made.risk_map(
        OccupancyOptions(alpha_min=0.0, alpha_max=_number('loss', values['loss'])))
    # Cells that a road opens have the loss of the nearest free cell.
    return _Joined(ground, ground.nearest_free_alpha())


def _without_terrain(top: Mapping[str, Any], base: float) -> _Joined:
    bounds, resolution = top['bounds'], _number('resolution', top['resolution'])
    if not isinstance(bounds, list) or len(bounds) != 4 or resolution == 0.0:
        raise InvalidLayers('without terrain, the file needs resolution: [m] and bounds: [west, '
                            'south, east, north] [m]')
    west, south, east, north = map(float, bounds)
    rows, columns = (round(length / resolution) for length in (north - south, east - west))
    if min(rows, columns) < 1 or rows * columns > MAX_CELLS:
        raise InvalidLayers(f'bounds {bounds} have {columns} x {rows} cells of {resolution:g} m; '
                            f'at least 1 and at most {MAX_CELLS} are possible')
    crs = str(top['crs']) if top['crs'] else None
    if crs and not is_robot_frame(crs):
        crs = Coordinates(crs).crs.to_string()
    cells = np.zeros((rows, columns))
    ground = RiskMap(cells, cells.astype(bool), resolution, (west, south, 0.0), crs)
    return _Joined(ground, cells + base)


@dataclass(eq=False)
class _Joined:
    """The grid with the terrain's obstacles, and what the layers so far make of it."""

    ground: RiskMap
    loss: FloatArray
    layers: list[Layer] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    masks: Mapping[str, list[BoolArray]] = field(
        default_factory=lambda: {'passable': [], 'forbidden': [], 'held': []})

    def result(self) -> LayeredRisk:
        obstacles = self.ground.obstacles.copy()
        for mask in self.masks['passable']:
            obstacles &= ~mask
        for mask in self.masks['forbidden']:
            obstacles |= mask
        for mask in self.masks['held']:
            self.loss[mask] = 0.0
        self.loss[self.loss < MIN_LOSS] = 0.0  # far from all incidents
        return LayeredRisk(replace(self.ground, alpha=self.loss, obstacles=obstacles),
                           tuple(self.layers), tuple(self.remarks))

    def add_shapes(self, name: str, features: GeoDataFrame, values: Mapping[str, Any]) -> None:
        """Apply polygons or roads."""
        roads = 'roads' in values
        size = (attribute_values(features, 'width', values['width']) / 2.0 if roads
                else attribute_values(features, 'buffer', values['buffer']))
        flat = Counter(features.geom_type[(features.geom_type != 'Polygon') & (size == 0.0)])
        if flat and not roads:
            what = ', '.join(f'{count} {kind}' for kind, count in flat.items())
            raise InvalidFeatures(f'{name}: {sum(flat.values())} of {len(features)} shapes are '
                                  f'no polygons ({what}); make them polygons, or give the '
                                  'layer a buffer [m], which all shapes grow by')
        given = features
        features = given.set_geometry(given.buffer(size).where(size > 0.0, given.geometry))
        shown = given if roads else features.boundary
        before = self.loss
        loss, factor = (attribute_values(features, key, values[key]) for key in ('loss', 'factor'))
        if roads:  # those with the same value count once
            self.loss = before.copy()
            for column, apply in ((loss, np.add), (factor, np.multiply)):
                for value, same in features.geometry.groupby(column):
                    part, covered = self._covered(same, touched=True)
                    apply(self.loss[part], value, out=self.loss[part], where=covered)
        else:
            with np.errstate(divide='ignore'):  # a factor of 0
                powers = self._sum(features, np.log2(factor))
            self.loss = (before + self._sum(features, loss)) * np.exp2(powers)
        for key, masks in self.masks.items():
            chosen = features[attribute_values(features, key, values[key]) > 0.0]
            if len(chosen):
                masks.append(self._cover(chosen, roads or key == 'forbidden'))
        self.layers.append(Layer('roads' if roads else 'polygons', name, shown))

    def add_incidents(self, name: str, features: GeoDataFrame, values: Mapping[str, Any]) -> None:
        """Apply incidents, with a remark if there are few."""
        places, weights, span = weighted_incidents(features, values)
        self.remarks += [f'{name}: {span}'] * bool(span)
        if values['bandwidth'] in (None, 'auto'):
            raise InvalidFeatures('how far does an incident count? Give the bandwidth in metres')
        bandwidth = _number('bandwidth', values['bandwidth'], self.ground.resolution)
        density = kernel_density(self.ground, places, weights, bandwidth)
        if not density.max() > 0.0:
            raise InvalidFeatures('no incident has a weight above 0')
        full = float(weights.sum() / weights.max())
        if full < FEW:
            self.remarks.append(
                f'{name}: {len(places)} incidents, weighted by age worth {full:.3g} recent ones; '
                f'with fewer than {FEW:g}, their pattern may be chance')
        self.loss = self.loss + _number('loss', values['loss']) * density / density.max()
        self.layers.append(Layer('incidents', name, features.geometry))

    def _sum(self, features: GeoDataFrame, values: FloatArray) -> FloatArray:
        """The sum (H, W) of the values (K,) of those shapes that contain a cell's centre."""
        from rasterio.features import MergeAlg, rasterize

        return np.asarray(rasterize(
            zip(features.geometry, values.tolist(), strict=True), self.loss.shape,
            transform=self._transform(0, 0), merge_alg=MergeAlg.add, dtype='float64'))

    def _cover(self, features: GeoDataFrame, touched: bool) -> BoolArray:
        """Cells (H, W) whose centres shapes cover, or any part of which if ``touched``."""
        cells = np.zeros(self.loss.shape, bool)
        part, covered = self._covered(features.geometry, touched)
        cells[part] = covered
        return cells

    def _covered(self, shapes: GeoSeries, touched: bool) -> tuple[tuple[slice, slice], BoolArray]:
        """The part of the grid around shapes, and which of its cells they cover."""
        from rasterio.features import rasterize

        low, high = np.reshape(shapes.total_bounds, (2, 2))
        (x, y, _), (rows, columns) = self.ground.origin, self.loss.shape
        low, high = (np.clip(np.floor((each - (x, y)) / self.ground.resolution) + more, 0,
                             (columns, rows)).astype(int).tolist()
                     for each, more in ((low, -1), (high, 2)))
        part = slice(low[1], high[1]), slice(low[0], high[0])
        size = high[1] - low[1], high[0] - low[0]
        if min(size) == 0:  # off the map
            return part, np.zeros(size, bool)
        cells = rasterize(((shape, 1) for shape in shapes), size, all_touched=touched,
                          transform=self._transform(*low), dtype='uint8')
        return part, cells > 0

    def _transform(self, column: int, row: int) -> Any:
        """The affine transform of rasterio for the part of the grid that begins at a cell."""
        from rasterio import Affine

        (x, y, _), step = self.ground.origin, self.ground.resolution
        return Affine(step, 0.0, x + column * step, 0.0, step, y + row * step)


def _number(name: str, value: Any, least: float = 0.0) -> float:
    check_at_least(name, value, least)
    return float(value)
