"""From the shape of the ground to a risk map; no ROS.

In reading order: ``elevation`` (what the ground is given as), ``relief`` (slope, and how deep a
place lies), ``visibility`` (who sees it, and from how near it is reached unseen), ``risk`` (the map
that follows). ``dem_file`` reads elevation models, ``map_file`` reads and writes the maps of
Nav2's map_server.
"""

from .dem_file import read_raster
from .elevation import Elevation, InvalidTerrain, Raster, elevation_from, mask_from
from .map_file import OccupancyMap, read_map, write_map
from .relief import relative_depth, slope
from .risk import TerrainMap, TerrainOptions, terrain_map
from .visibility import ViewOptions, Views, viewshed

__all__ = [
    'Elevation',
    'InvalidTerrain',
    'OccupancyMap',
    'Raster',
    'TerrainMap',
    'TerrainOptions',
    'ViewOptions',
    'Views',
    'elevation_from',
    'mask_from',
    'read_map',
    'read_raster',
    'relative_depth',
    'slope',
    'terrain_map',
    'viewshed',
    'write_map',
]
