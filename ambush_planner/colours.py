# SPDX-License-Identifier: Apache-2.0
"""Colours of pictures, reports and layouts, which colour-blind readers can tell apart.

The layouts in `config` repeat them.
"""

OBSTACLE = '#1c1714'
AMBUSHER = '#e66100'
# Start, goal and stops.
ENDS = '#ffd92f'
# From the least loss to the largest, and from rare to likely.
RISK = ('#ffffff', '#848484')
PROBABILITY = ('#7fb8e6', '#2f7fd0', '#1146b0', '#14075c')
# The network below routes, which have none of its blues and do not resemble the ambusher's orange.
NETWORK = '#a5c8e8'
ROUTES = ('#b605f9', '#01584b', '#1fd19b', '#870005', '#f57bfd', '#b7775e', '#640c89', '#916298')
