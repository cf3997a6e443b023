"""Colours of pictures, reports and layouts, which colour-blind readers can tell apart.

`report_map.js`, `report.css`, `report_section.html` and the layouts in `config` repeat them.
"""

OBSTACLE = '#1c1714'
AMBUSHER = '#e66100'
# Start, goal and stops.
ENDS = '#ffd92f'
# From the least loss to the largest, and from rare to likely.
RISK = ('#ffffff', '#848484')
PROBABILITY = ('#7fb8e6', '#2f7fd0', '#1146b0', '#14075c')
# Departures. None resembles the ambusher's orange.
ROUTES = ('#2560a2', '#590051', '#15a9ff', '#350290', '#e0aed9', '#35c48c', '#9216f9', '#5b4a39')
# RViz and Foxglove, whose ground is dark: the last departure and the start, and the goal.
LIVE_ROUTE, LIVE_GOAL = '#00ff88', '#cc00cc'
