# SPDX-License-Identifier: Apache-2.0
"""From heights to tracks for a GPS: writes routes.gpx."""

import os

import numpy as np

from ambush_planner import GameOptions, PlanningOptions, plan_trip
from ambush_planner.maps import Elevation, terrain_map

# Hills of 6 km x 4.5 km in UTM zone 33. For a GeoTIFF use
# elevation_from_raster(read_raster(Path('dem.tif'))), of maps and maps.elevation_file.
v, u = np.mgrid[0:90, 0:120] * 50.0
heights = 90.0 * np.sin(u / 700.0) * np.cos(v / 600.0)
west, south = 455000.0, 5410000.0
elevation = Elevation(heights, 50.0, (west, south), 'EPSG:32633')

# Low, visible, steep ground with cover nearby is dangerous; too steep ground is an obstacle.
ground = terrain_map(elevation)
risk_map = ground.risk_map()

options = PlanningOptions(game=GameOptions(ambush_radius=300.0))
plan = plan_trip(risk_map, (west + 300.0, south + 2200.0), (west + 5700.0, south + 2300.0), options)
print(f'value {plan.strategy.value:.2f}, lower bound {plan.strategy.lower_bound:.2f}')

os.umask(0o077)  # routes are secret: only you may read the file
routes = plan.routes(5)  # a GeoDataFrame in the map's coordinate system
print(routes[['departure', 'length']].round().to_string(index=False))
routes[['geometry']].to_crs('EPSG:4326').to_file('routes.gpx', driver='GPX', layer='tracks')
