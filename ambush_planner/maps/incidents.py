"""Density of past incidents: a Gaussian kernel on the cells of a map, and its bandwidth."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.signal import fftconvolve
from scipy.spatial.distance import cdist

from ..arrays import FloatArray
from ..option_checks import check_at_least
from .risk_map import RiskMap
from .vector_file import InvalidFeatures, attribute, attribute_values

if TYPE_CHECKING:
    from geopandas import GeoDataFrame

# The kernel ends at this distance [bandwidths].
CUT = 4.0
# Bandwidths that cross-validation compares, and the number of incidents that it uses.
BANDWIDTHS, MOST_VALIDATED = 24, 3000


def weighted_incidents(features: GeoDataFrame,
                       values: Mapping[str, Any]) -> tuple[FloatArray, FloatArray]:
    """Places (K, 2) [m] and weights (K,) of the incidents that count, as ``risk_layers`` says.

    Raises InvalidFeatures if an attribute is missing or malformed.
    """
    from pandas import to_datetime

    places = np.stack((features.geometry.x, features.geometry.y), axis=1)
    weights = attribute_values(features, 'weight', values['weight'])
    half_life = values['half_life']
    check_at_least('half_life', half_life, 1e-3, 'days', finite=False)
    if half_life == math.inf and values['until'] is None:
        return places, weights
    dates = to_datetime(attribute(features, 'date', values['date']), errors='coerce', utc=True,
                        format='mixed')
    if missing := int(dates.isna().sum()):
        raise InvalidFeatures(f'date: {missing} of {len(dates)} incidents have none such as '
                              '2025-03-31')
    until = dates.max() if values['until'] is None else to_datetime(str(values['until']), utc=True)
    days = ((until - dates).dt.total_seconds() / 86400.0).to_numpy()
    return places[days >= 0.0], (weights * 0.5 ** (days / half_life))[days >= 0.0]


def kernel_density(ground: RiskMap, places: FloatArray, weights: FloatArray,
                   bandwidth: float) -> FloatArray:
    """The density (H, W), up to a constant, of places (K, 2) [m] with weights (K,)."""
    sigma = bandwidth / ground.resolution
    margin = math.ceil(CUT * sigma)
    smooth = gaussian_filter(_binned(ground, places, weights, margin), sigma, mode='constant',
                             truncate=CUT)
    return np.asarray(smooth[margin:-margin, margin:-margin])


def count_near(ground: RiskMap, places: FloatArray, distance: float) -> FloatArray:
    """The number of places (K, 2) within ``distance`` [m] of each cell (H, W)."""
    margin = math.ceil(distance / ground.resolution)
    across = np.arange(-margin, margin + 1) * ground.resolution
    disc = (np.hypot(across[:, None], across) <= distance).astype(np.float64)
    binned = _binned(ground, places, np.ones(len(places)), margin)
    return np.rint(fftconvolve(binned, disc, 'same')[margin:-margin, margin:-margin])


def cross_validated_bandwidth(ground: RiskMap, places: FloatArray,
                              weights: FloatArray) -> tuple[float, bool]:
    """The bandwidth [m] under which each incident is likeliest given all others.

    Also returns whether it is the largest of those compared: then there is no pattern to see.
    """
    heaviest = np.argsort(-weights, kind='stable')[:MOST_VALIDATED]
    places, weights = places[heaviest], weights[heaviest]
    squared = cdist(places, places, 'sqeuclidean')
    np.fill_diagonal(squared, np.inf)
    tried = np.geomspace(ground.resolution, max(ground.size) / 2.0, BANDWIDTHS)
    likelihood = [
        weights @ np.log(np.maximum(np.exp(-squared / (2.0 * h**2)) @ weights / h**2, 1e-300))
        for h in tried
    ]
    best = int(np.argmax(likelihood))
    return float(tried[best]), best == len(tried) - 1


def _binned(ground: RiskMap, places: FloatArray, weights: FloatArray, margin: int) -> FloatArray:
    """The sum of weights in each cell of the map with a margin [cells]."""
    cells = np.zeros(np.array(ground.alpha.shape) + 2 * margin)
    at = np.floor(ground.to_map_axes(places)[:, ::-1] / ground.resolution).astype(int) + margin
    inside = ((at >= 0) & (at < cells.shape)).all(axis=1)
    np.add.at(cells, tuple(at[inside].T), weights[inside])
    return cells
