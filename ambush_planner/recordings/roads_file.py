# SPDX-License-Identifier: Apache-2.0
"""The attachment ``roads.npz``: the roads of the method graph, in the map's coordinates."""

from __future__ import annotations

from functools import lru_cache
from io import BytesIO

import numpy as np

from ..maps.road_file import RoadGraph

ROADS_FILE = 'roads.npz'


@lru_cache(4)
def roads_file(roads: RoadGraph) -> bytes:
    """Return roads as an npz file."""
    stream = BytesIO()
    np.savez_compressed(stream, points=roads.points, pairs=roads.pairs, speeds=roads.speeds,
                        timed=roads.timed)
    return stream.getvalue()


def roads_from_file(data: bytes | None) -> RoadGraph | None:
    """Return the roads in the bytes of a ``roads.npz``; None if there are none."""
    if data is None:
        return None
    with np.load(BytesIO(data), allow_pickle=False) as archive:
        return RoadGraph(archive['points'], archive['pairs'], archive['speeds'],
                         bool(archive['timed']))
