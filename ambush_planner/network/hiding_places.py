# SPDX-License-Identifier: Apache-2.0
"""Ambush sites that the convoy does not drive through: obstacle cells, or other places."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from ..arrays import FloatArray
from ..maps.risk_map import RiskMap
from .network import Network


def hiding_places(networks: Sequence[Network], risk_map: RiskMap, reach: float,
                  spacing: float) -> tuple[FloatArray, FloatArray]:
    """Positions (K, 2) of obstacle cells near the edges of a trip [m], and their losses (K,).

    All cells within ``reach`` [m] of an edge are considered, and some slightly further; one is
    taken in each square of half a ``spacing`` [m]. Its loss is that of the nearest free cell.
    """
    step = max(int(spacing / 2.0 / risk_map.resolution), 1)
    rows, columns = np.nonzero(risk_map.obstacles)
    squares = (rows // step) * (risk_map.obstacles.shape[1] // step + 1) + columns // step
    _, first = np.unique(squares, return_index=True)
    rows, columns = rows[first], columns[first]
    places = risk_map.to_world(np.stack((columns, rows), axis=1) * risk_map.resolution
                               + risk_map.resolution / 2.0)
    limit = reach + max(float(each.lengths.max(initial=0.0)) for each in networks) / 2.0
    near = np.isfinite(cKDTree(networks[0].points).query(places, distance_upper_bound=limit)[0])
    return places[near], risk_map.nearest_free_alpha()[rows[near], columns[near]]


def with_places(network: Network, points: FloatArray, alpha: FloatArray) -> Network:
    """Append places (K, 2) with losses (K,) as nodes without edges."""
    return replace(network, points=np.concatenate((network.points, points)),
                   alpha=np.concatenate((network.alpha, alpha)))
