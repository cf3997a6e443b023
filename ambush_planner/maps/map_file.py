# SPDX-License-Identifier: Apache-2.0
"""Map files of Nav2's map_server: a YAML file that names an image.

Maps are written in mode ``raw``, which preserves all values: a pixel of 0..100 is the cell value,
any other is unknown. The image is PGM (P5), top row first. Keys that map_server ignores: ``crs``,
the coordinate system of the map's origin; ``alpha_min`` and ``alpha_max``, the losses of the
values 0 and 100. Images are grey with 8 bits. ``trinary`` and ``scale`` are read as
map_server reads them. Source: navigation2 (jazzy), nav2_map_server/src/map_io.cpp.
"""

from __future__ import annotations

import math
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..errors import AmbushPlannerError, InvalidOption, InvalidRiskMap, import_extra
from .elevation import MAX_CELLS
from .occupancy import OccupancyMap
from .risk_map import LOSSES

_MODES = ('trinary', 'scale', 'raw')
_GREY = 'convert the image to grey with 8 bits, without transparency'
# PGM header: width, height and largest value, separated by white space or comments.
_PGM = re.compile(rb'P5(?:\s|#[^\n]*\n)+(\d+)(?:\s|#[^\n]*\n)+(\d+)(?:\s|#[^\n]*\n)+(\d+)\s')


def write_map(path: Path, occupancy: OccupancyMap, remark: str = '') -> Path:
    """Write ``path`` (.yaml) and an image (.pgm) next to it; return the image's path.

    The image is written first, so that an existing YAML file implies both. ``remark`` becomes a
    comment.

    Raises InvalidOption if ``path`` does not end with .yaml or .yml; OSError.
    """
    if path.suffix.lower() not in ('.yaml', '.yml'):
        raise InvalidOption(f'{path}: the name of a map must end with .yaml')
    picture = path.with_suffix('.pgm')
    rows, columns = occupancy.values.shape
    values = occupancy.values.astype(np.int16)[::-1]
    pixels = np.where(values < 0, 255, values).astype(np.uint8)
    picture.write_bytes(b'P5\n%d %d\n255\n' % (columns, rows) + pixels.tobytes())
    fields = {
        'image': picture.name, 'mode': 'raw', 'resolution': float(occupancy.resolution),
        'origin': [float(value) for value in occupancy.origin], 'negate': 0,
        'occupied_thresh': 0.65, 'free_thresh': 0.196,
        'alpha_min': occupancy.losses[0], 'alpha_max': occupancy.losses[1],
        **({'crs': occupancy.crs} if occupancy.crs else {}),
    }
    import yaml

    comments = ''.join(f'# {line}\n' for line in remark.splitlines())
    path.write_text(comments + yaml.safe_dump(fields, sort_keys=False), encoding='utf-8')
    return picture


def read_map(path: Path) -> OccupancyMap:
    """Read a map_server YAML file and its image; formats other than PGM need Pillow.

    Raises InvalidRiskMap if either file is malformed, OSError if it cannot be opened.
    """
    fields = read_yaml(path, InvalidRiskMap)
    for name in ('image', 'resolution', 'origin'):
        if name not in fields:
            raise InvalidRiskMap(f'{path}: {name!r} is missing')
    mode = str(fields.get('mode', 'trinary')).lower()
    if mode not in _MODES:
        raise InvalidRiskMap(f'{path}: mode must be one of {", ".join(_MODES)}, got {mode!r}')
    defaults = {'occupied_thresh': 0.65, 'free_thresh': 0.196, 'negate': 0}
    numbers = {name: _numbers(path, defaults | fields, name, 1)[0] for name in defaults}
    values = _cells(*_pixels(path.parent / str(fields['image'])), mode, numbers)
    origin = _numbers(path, fields, 'origin', 3)
    resolution = _numbers(path, fields, 'resolution', 1)[0]
    if resolution <= 0.0:
        raise InvalidRiskMap(f'{path}: resolution must be positive [m], got {resolution}')
    least, most = (_numbers(path, {name: loss} | fields, name, 1)[0]
                   for name, loss in zip(('alpha_min', 'alpha_max'), LOSSES, strict=True))
    crs = fields.get('crs')
    return OccupancyMap(values[::-1], resolution, (origin[0], origin[1], origin[2]),
                        str(crs) if crs else None, losses=(least, most))


def read_yaml(path: Path, error: type[AmbushPlannerError]) -> dict[str, Any]:
    """Read the keys and values of a YAML file; raises ``error`` if it is no such file, OSError."""
    import yaml

    try:
        content = yaml.safe_load(path.read_text(encoding='utf-8'))
    except (yaml.YAMLError, ValueError) as reason:  # ValueError: no UTF-8, or no such date
        raise error(f'{path}: not a YAML file: {" ".join(str(reason).split())}') from reason
    if not isinstance(content, dict):
        raise error(f'{path}: must have keys and values, in YAML')
    return content


def _numbers(path: Path, fields: dict[str, Any], name: str, count: int) -> list[float]:
    given = fields[name] if isinstance(fields[name], list) else [fields[name]]
    try:
        numbers = [float(value) for value in given]
    except (TypeError, ValueError):
        numbers = []
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise InvalidRiskMap(f'{path}: {name} must be {count} finite numbers, got {fields[name]!r}')
    return numbers


def _cells(pixels: npt.NDArray[np.uint8], largest: int, mode: str,
           fields: dict[str, Any]) -> npt.NDArray[np.int8]:
    """Values -1..100 (H, W) of pixels up to ``largest``, as map_server converts them."""
    light = np.arange(256) / largest
    if mode == 'raw':
        value = np.rint(light * 255.0)
        return np.where(value <= 100.0, value, -1).astype(np.int8)[pixels]
    occupied = light if fields['negate'] else 1.0 - light
    full, free = fields['occupied_thresh'], fields['free_thresh']
    between = np.full(light.shape, -1.0)
    if mode == 'scale' and full > free:
        between = np.rint((occupied - free) / (full - free) * 100.0)
    value = np.where(occupied > full, 100, np.where(occupied < free, 0, between))
    return value.astype(np.int8)[pixels]


def _pixels(path: Path) -> tuple[npt.NDArray[np.uint8], int]:
    """Return the pixels (H, W) of a grey image of 8 bits, top row first, and the largest value."""
    data = path.read_bytes()
    header = _PGM.match(data)
    if header is None:
        return _other_pixels(path), 255
    columns, rows, largest = map(int, header.groups())
    _check_size(path, columns, rows)
    if not 0 < largest < 256:
        raise InvalidRiskMap(f'{path}: pixels up to {largest}; {_GREY}')
    if len(data) - header.end() < rows * columns:
        raise InvalidRiskMap(f'{path}: too short for {columns} x {rows} pixels')
    pixels = np.frombuffer(data, np.uint8, rows * columns, header.end()).reshape(rows, columns)
    return pixels, largest


def _check_size(path: Path, columns: int, rows: int) -> None:
    if not 0 < rows * columns <= MAX_CELLS:
        raise InvalidRiskMap(f'{path}: {columns} x {rows} pixels; 1 to {MAX_CELLS} can be read')


def _other_pixels(path: Path) -> npt.NDArray[np.uint8]:
    pillow = import_extra('PIL.Image', f'{path}: images other than binary PGM', 'figures',
                          InvalidRiskMap)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter('ignore', pillow.DecompressionBombWarning)
            image = pillow.open(path)
        with image:
            _check_size(path, *image.size)
            if image.mode != 'L' or 'transparency' in image.info:
                raise InvalidRiskMap(f'{path}: pixels of kind {image.mode}; {_GREY}')
            return np.asarray(image)
    except InvalidRiskMap:
        raise
    except (OSError, ValueError, SyntaxError, pillow.DecompressionBombError) as error:
        raise InvalidRiskMap(f'{path}: not a readable image: {error}') from error
