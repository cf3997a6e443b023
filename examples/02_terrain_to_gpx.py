# SPDX-License-Identifier: Apache-2.0
"""From heights to tracks for a GPS: writes routes.gpx."""

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

paths = plan.save('routes.gpx', n=5)  # secret: only you may read the file
for number, path in enumerate(paths, start=1):
    print(f'departure {number}: {np.hypot(*np.diff(path[:, :2], axis=0).T).sum():.0f} m')
