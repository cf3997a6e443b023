# SPDX-License-Identifier: Apache-2.0
"""Maps that have to be refused, and words that the reason must have (regular expressions)."""

import math

import numpy as np
from ros_harness import risk_grid

NAN, INF = math.nan, math.inf


def spoiled(**changes):
    """A good map with fields of its info, origin's position or orientation changed."""
    message = risk_grid(np.zeros((3, 4), dtype=np.int8))
    for name, value in changes.items():
        place = message.info
        if name in ('x', 'y', 'z'):
            place = message.info.origin.position
        elif name.startswith('q'):
            place, name = message.info.origin.orientation, name[1:]
        setattr(place, name, value)
    return message


BAD_MAPS = {
    'no cells': (spoiled(width=0, height=0), 'empty: width 0, height 0'),
    'no rows': (spoiled(height=0), 'width 4, height 0'),
    'data too short': (spoiled(height=5), '12 cells, but width 4 x height 5 is 20'),
    'data too long': (spoiled(width=2), '12 cells, but width 2 x height 3 is 6'),
    'huge claim': (spoiled(width=30_000, height=30_000), '900000000'),
    'resolution 0': (spoiled(resolution=0.0), 'resolution.*0.0'),
    'resolution negative': (spoiled(resolution=-0.5), 'resolution.*-0.5'),
    'resolution NaN': (spoiled(resolution=NAN), 'resolution.*nan'),
    'resolution infinite': (spoiled(resolution=INF), 'resolution.*inf'),
    'origin NaN': (spoiled(x=NAN), r'origin: position \(nan, 0.0, 0.0\)'),
    'origin infinite': (spoiled(y=-INF), r'origin: position \(0.0, -inf, 0.0\)'),
    'origin quaternion NaN': (spoiled(qz=NAN), 'origin: orientation .*nan'),
    'origin quaternion zero': (spoiled(qw=0.0), 'not a unit quaternion: its norm is 0'),
    'origin quaternion long': (spoiled(qw=2.0), 'not a unit quaternion: its norm is 2'),
    'origin tilted': (spoiled(qw=0.0, qx=1.0), 'tilts the map'),
    'value over 100': (risk_grid(np.array([[0, 101]])), r'101 at \(row, column\) \(0, 1\)'),
    'value under -1': (risk_grid(np.array([[0], [-2]])), r'-2 at \(row, column\) \(1, 0\)'),
    'no frame': (risk_grid(frame=''), 'frame_id is empty'),
}
