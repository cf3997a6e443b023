"""From the shape of the ground, or from an occupancy grid, to a risk map.

``risk_map`` is the record, ``occupancy`` reads cell values as losses, ``ros_messages`` and
``map_file`` read them from messages and from map_server's files. ``elevation``, ``relief`` and
``visibility`` describe the ground; ``terrain_risk`` turns it into a risk map.
"""

from .elevation import Elevation, InvalidTerrain, Raster, elevation_from, mask_from
from .occupancy import OccupancyMap
from .relief import relative_depth, slope
from .terrain_risk import TerrainMap, TerrainOptions, terrain_map
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
    'relative_depth',
    'slope',
    'terrain_map',
    'viewshed',
]
