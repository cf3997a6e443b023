# SPDX-License-Identifier: Apache-2.0
"""Density of past incidents: a Gaussian kernel on the cells of a map."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ..arrays import FloatArray
from ..option_checks import check_at_least
from .risk_map import RiskMap
from .tables import InvalidFeatures, read_dates
from .vector_file import attribute, attribute_values

if TYPE_CHECKING:
    from geopandas import GeoDataFrame

# Number of incidents whose density is computed at a time; bounds the memory.
CHUNK = 4096


def weighted_incidents(features: GeoDataFrame,
                       values: Mapping[str, Any]) -> tuple[FloatArray, FloatArray, str]:
    """Places (K, 2) [m] and weights (K,) of the incidents that count (see ``risk_layers``).

    Also says how many there are, and when, if dates matter. Raises InvalidFeatures if an
    attribute is missing or malformed.
    """
    places = np.stack((features.geometry.x, features.geometry.y), axis=1)
    weights = attribute_values(features, 'weight', values['weight'])
    half_life = values['half_life']
    check_at_least('half_life', half_life, 1e-3, 'days', finite=False)
    if half_life == math.inf:
        return places, weights, ''
    dates = read_dates(attribute(features, 'date', values['date']), values['date'])
    if missing := int(dates.isna().sum()):
        raise InvalidFeatures(f'date: {missing} of {len(dates)} incidents have no date such '
                              'as 2025-03-31')
    days = ((dates.max() - dates).dt.total_seconds() / 86400.0).to_numpy()
    return (places, weights * 0.5 ** (days / half_life),
            f'{len(dates)} incidents, {dates.min():%Y-%m-%d} to {dates.max():%Y-%m-%d}')


def kernel_density(ground: RiskMap, places: FloatArray, weights: FloatArray,
                   bandwidth: float) -> FloatArray:
    """The density (H, W), up to a constant, of places (K, 2) [m] with weights (K,)."""
    density, step = np.zeros(ground.alpha.shape), ground.resolution
    for begin in range(0, len(places), CHUNK):
        across, along = (
            np.exp(-0.5 * (((np.arange(count) + 0.5) * step - each[:, None]) / bandwidth) ** 2)
            for each, count in zip(ground.to_map_axes(places[begin: begin + CHUNK]).T,
                                   ground.alpha.shape[::-1], strict=True))
        density += (along * weights[begin: begin + CHUNK, None]).T @ across
    return density
