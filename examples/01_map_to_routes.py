# SPDX-License-Identifier: Apache-2.0
"""From a map of map_server to routes."""

from pathlib import Path

import numpy as np

from ambush_planner import GameOptions, PlanningOptions, plan_trip, read_risk_map

risk_map = read_risk_map(Path(__file__).parents[1] / 'docs/yard.yaml')
# An ambush reaches 2 m; by default, nobody can wait that near to start and goal.
options = PlanningOptions(game=GameOptions(ambush_radius=2.0))
plan = plan_trip(risk_map, (4.0, 20.0), (56.0, 20.0), options)

strategy = plan.strategy
print(f'mean loss at most {strategy.value:.3f}; no strategy can promise less than '
      f'{strategy.lower_bound:.3f}')

# Drawn with the operating system's entropy: each departure differs, and nobody can predict it.
for path in plan.paths(3):  # (L, 3): x, y [m], yaw [rad]
    length = np.hypot(*np.diff(path[:, :2], axis=0).T).sum()
    print(f'{len(path)} poses, {length:.1f} m, through {path[len(path) // 2, :2].round(1)}')
