# SPDX-License-Identifier: Apache-2.0
"""Risk maps from occupancy grids and elevation models.

``risk_map`` defines the map, ``occupancy`` converts cell values to losses, ``ros_messages`` and
``map_file`` read grids from messages and from map_server files, ``risk_map_file`` reads risk maps
from files of several kinds, and ``coordinates`` converts to latitude and longitude. ``elevation``,
``relief`` and ``visibility`` describe the terrain; ``terrain_risk`` converts it to a risk map.
"""

from .elevation import Elevation, InvalidTerrain, Raster, elevation_from_raster
from .occupancy import OccupancyMap, OccupancyOptions
from .relief import relative_depth, slope
from .risk_map import RiskMap
from .risk_map_file import read_risk_map
from .terrain_risk import TerrainOptions, terrain_map
from .visibility import ViewOptions, Views, viewshed

__all__ = [
    'Elevation', 'InvalidTerrain', 'OccupancyMap', 'OccupancyOptions', 'Raster', 'RiskMap',
    'TerrainOptions', 'ViewOptions', 'Views', 'elevation_from_raster', 'read_risk_map',
    'relative_depth', 'slope', 'terrain_map', 'viewshed',
]
