# SPDX-License-Identifier: Apache-2.0
"""Kinds of sound files that are not read, by their first bytes and suffixes, and what to do."""

from __future__ import annotations

import re
import zipfile
from pathlib import Path

from ..errors import AmbushPlannerError

_UNPACK = 'unpack it, and give the file that is in it'
_GPX = 'convert it to GPX: gpsbabel -i {} -f {{file}} -o gpx -F {{stem}}.gpx'
# First bytes (a pattern), suffixes, what the file is and what to do with it; the first that fits.
_KINDS = tuple((re.compile(start, re.DOTALL | re.IGNORECASE), suffixes.split(), what, remedy)
               for start, suffixes, what, remedy in (
    (rb'\Z', '', 'an empty file', 'get it again'),
    (rb'\s*(<!doctype html|<html)', '', 'a web page', 'get the file that it leads to'),
    (rb'version https://git-lfs', '', 'a pointer of Git LFS', 'get the file with git lfs pull'),
    (rb'\Z.', '.xlsx .xls .ods', 'a spreadsheet', 'save it as CSV in UTF-8'),
    (rb'PK\x03\x04|\x1f\x8b|BZh|7z\xbc\xaf|Rar!|\xfd7zXZ|\x28\xb5\x2f\xfd', '.zip .gz .bz2 .7z',
     'a packed file', _UNPACK),
    (rb'PAR1|ARROW1', '.parquet .geoparquet .feather', 'a Parquet or Arrow file',
     'convert it to GeoPackage (in Python: geopandas.read_parquet("{file}")'
     '.to_file("{stem}.gpkg"))'),
    (rb'.{8}\.FIT', '.fit', 'a FIT file of a watch or receiver', _GPX.format('garmin_fit')),
    (rb'\s*[$!](G[A-Z]|BD|QZ|AI|P)[A-Z]{3,4},', '.nmea', 'a log of NMEA sentences',
     _GPX.format('nmea')),
    (rb'.{,300}<TrainingCenterDatabase', '.tcx', 'a TCX file', _GPX.format('gtrnctr')),
    (rb'#ROSBAG', '.db3', 'a bag of ROS', 'write its positions to GPX or CSV'),
    (rb'.{,300}<osmChange', '.osc .o5m', 'an OpenStreetMap file of another kind',
     'convert it: osmium cat {file} -o {stem}.osm.pbf (changes: osmium apply-changes)'),
    (rb'\s*<OGRVRT', '', 'a virtual layer of GDAL', 'give the file that it names'),
    (rb'.{,500}"osm3s"', '', 'an answer of Overpass in JSON', 'ask for XML ([out:xml]), as .osm'),
    (rb'\s*\{\s*"(locations|semanticSegments|timelineObjects)"', '', 'a location history of Google',
     'convert it to GPX'),
    (rb'AC10\d\d', '.dwg', 'a drawing of AutoCAD', 'convert it to GeoPackage'),
))


def refuse_other_kinds(path: Path, error: type[AmbushPlannerError]) -> None:
    """Raise ``error``, which says what to do, if the file is of a kind that nothing here reads.

    Raises OSError if it cannot be opened.
    """
    if path.is_dir():  # a file geodatabase
        return
    with path.open('rb') as file:
        head = file.read(512)
    if head.startswith(b'PK') and zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as packed:
            if any(name.endswith('.npy') for name in packed.namelist()):
                return
    for start, suffixes, what, remedy in _KINDS:
        if start.match(head) or path.suffix.lower() in suffixes:
            raise error(f'{path}: this is {what}, which is not read here; '
                        + remedy.format(file=path.name, stem=path.stem))
