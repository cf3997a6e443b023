# SPDX-License-Identifier: Apache-2.0
"""Roads only: a town with one-way streets and a fast ring road; budgets are of driving time."""

import numpy as np

from ambush_planner import GameOptions, NetworkOptions, PlanningOptions, RiskMap, plan_trip
from ambush_planner.maps.road_file import RoadGraph

# Junctions every 100 m. For a file of roads, give its name as `graph` instead (docs/roads.md).
number = np.arange(81).reshape(9, 9)  # row by row from the south-west
points = 100.0 * np.argwhere(number >= 0)[:, ::-1] + 50.0
east_west = np.stack((number[:, :-1].ravel(), number[:, 1:].ravel()), axis=1)
north_south = np.stack((number[:-1].ravel(), number[1:].ravel()), axis=1)
pairs = np.concatenate((east_west, north_south))

speeds = np.full((len(pairs), 2), 8.0)  # [m/s], from the first junction of a pair, and back
speeds[np.isin(points[pairs], (50.0, 850.0)).any(axis=2).all(axis=1)] = 14.0
speeds[(points[pairs][:, :, 0] == 250.0).all(axis=1), 1] = 0.0  # this street leads north only

v, u = np.mgrid[0:90, 0:90] / 90.0
alpha = 1.0 + 4.0 * np.exp(-20.0 * ((u - 0.5) ** 2 + (v - 0.5) ** 2))  # the centre is dangerous
risk_map = RiskMap(alpha, np.zeros((90, 90), bool), resolution=10.0)

roads = RoadGraph(points, pairs, speeds, timed=True)
options = PlanningOptions(network=NetworkOptions(method='graph', graph=roads, spacing=50.0),
                          game=GameOptions(ambush_radius=30.0, secured_radius=120.0))
plan = plan_trip(risk_map, (50.0, 250.0), (850.0, 650.0), options)
strategy = plan.strategy
print(f'value {strategy.value:.2f}, lower bound {strategy.lower_bound:.2f}')
print(f'mean time {strategy.expected_length:.0f} s, fastest {strategy.shortest_length:.0f} s')
