# SPDX-License-Identifier: Apache-2.0
"""Compare the gain of an ambusher who has learnt your tracks with what the optimum leaves."""

from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from ambush_planner import GameOptions, PlanningOptions, plan_trip, read_risk_map

REACH = 2.0  # [m]
# Corners of tracks: two of three days through the gate in the middle, else the northern one.
OWN = 2 * [[(4, 20), (31, 19), (48, 16), (56, 20)]] + [[(4, 20), (31, 34), (50, 31), (56, 20)]]

plan = plan_trip(read_risk_map(Path(__file__).parents[1] / 'docs/yard.yaml'), (4, 20), (56, 20),
                 PlanningOptions(game=GameOptions(ambush_radius=REACH)))
game = plan.strategy.game
sites, loss = game.network.points[game.sites], game.loss[game.sites]


def worst_site(tracks):
    """Say where an ambush costs most on average, how many tracks pass there, and the cost."""
    met = np.mean([cKDTree(dense(each)).query(sites)[0] <= REACH for each in tracks], axis=0)
    k = np.argmax(met * loss)
    return f'{met[k]:.0%} pass {sites[k].round(1)}; mean loss {met[k] * loss[k]:.2f}'


def dense(corners):
    """Return points (L, 2) of a track, 0.1 m apart."""
    corners = np.asarray(corners, float)[:, :2]
    along = np.append(0.0, np.hypot(*np.diff(corners, axis=0).T).cumsum())
    at = np.arange(0.0, along[-1], 0.1)
    return np.stack([np.interp(at, along, each) for each in corners.T], axis=1)


print('own tracks:', worst_site(OWN))
# In a sample, the worst of many sites comes out a little above the value.
print('300 drawn:', worst_site(plan.paths(300)), f'(value {plan.strategy.value:.2f})')
