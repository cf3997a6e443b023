# SPDX-License-Identifier: Apache-2.0
"""Lines as segments between places, and where they meet without a shared vertex."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ..arrays import FloatArray, IndexArray

if TYPE_CHECKING:
    from geopandas import GeoDataFrame

# Decimals of metres to which vertices are rounded; equal vertices are one place.
DIGITS = 3
# Distance within which an open end meets another line, and any vertex does [m].
NEAR_END, NEAR_VERTEX = 0.05, 0.002
# Difference in height of roads that do not meet, and height of a level [m].
CLEARANCE, STOREY = 2.0, 5.0
METRES_PER_DEGREE = 111_320.0


@dataclass(frozen=True, eq=False)
class Segments:
    """Segments (S,) of lines between places (P,).

    ``points`` (P, 2) [m] and ``heights`` (P,) [m, NaN if unknown] of places; ``scale`` (2,), metres
    in a unit of the file; ``pairs`` (S, 2), the two places of a segment; ``line`` (S,), the line of
    each; ``split``, how many places share a vertex with a place at another height.
    """

    points: FloatArray
    heights: FloatArray
    scale: FloatArray
    pairs: IndexArray
    line: IndexArray
    split: int


def segments_of(lines: GeoDataFrame, level: IndexArray | None = None) -> Segments:
    """Split lines (L,) at their vertices; equal vertices are one place.

    Vertices over ``CLEARANCE`` apart in height are not. If the lines have no heights, their inner
    vertices have that of the ``level`` (L,).
    """
    import shapely

    xyz, line = shapely.get_coordinates(lines.geometry, include_z=True, return_index=True)
    xy, height, scale = xyz[:, :2].copy(), xyz[:, 2], np.ones(2)
    if lines.crs is not None and lines.crs.is_geographic:  # continuous across the antimeridian
        xy[:, 0] = (xy[:, 0] - xy[0, 0] + 180.0) % 360.0 + xy[0, 0] - 180.0
        scale = METRES_PER_DEGREE * np.array((np.cos(np.radians(xy[:, 1].mean())), 1.0))
    elif lines.crs is not None:
        scale *= lines.crs.axis_info[0].unit_conversion_factor
    xy *= scale
    first = np.diff(line, prepend=-1) != 0
    if level is not None and not np.isfinite(height).any():
        height = np.where(first | np.append(first[1:], True), np.nan, STOREY * level[line])
    _, spot = np.unique(xy.round(DIGITS), axis=0, return_inverse=True)
    spot = spot.ravel()
    order = np.lexsort((height, spot))
    new_spot = np.diff(spot[order], prepend=-1) != 0
    higher = ~new_spot & (np.diff(height[order], prepend=np.nan) > CLEARANCE)
    begins = new_spot | higher
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.cumsum(begins) - 1
    pairs = np.stack((place[:-1], place[1:]), axis=1)
    long = ~first[1:] & (place[:-1] != place[1:])
    return Segments(xy[order][begins], height[order][begins], scale, pairs[long], line[1:][long],
                    len(np.unique(spot[order][higher])))


def cut_at_meetings(given: Segments, level: IndexArray) -> tuple[Segments, int]:
    """Cut segments where they cross or touch others of the same ``level`` (L,) of their lines.

    Returns how many places these are, too; those within twice ``NEAR_END`` count once.
    """
    cut, place, at = _meetings(given, level)
    spots = at[np.unique(place)]
    near = cKDTree(spots).query_pairs(2.0 * NEAR_END, output_type='ndarray')
    count = connected_components(coo_matrix((np.ones(len(near)), tuple(near.T)), [len(spots)] * 2),
                                 directed=False)[0] if len(spots) else 0
    # The places of each segment, in their order.
    number = np.arange(len(given.pairs))
    segment = np.concatenate((number, cut, number))
    place = np.concatenate((given.pairs[:, 0], place, given.pairs[:, 1]))
    along = np.hypot(*(at[place] - at[given.pairs[segment, 0]]).T)
    along[len(along) - len(number):] = np.inf
    order = np.lexsort((along, segment))
    segment, place = segment[order], place[order]
    inner = segment[1:] == segment[:-1]
    return replace(given, points=at, line=given.line[segment[1:][inner]],
                   pairs=np.stack((place[:-1], place[1:]), axis=1)[inner]), count


def _meetings(given: Segments, level: IndexArray) -> tuple[IndexArray, IndexArray, FloatArray]:
    """Segments (K,) that others cross or touch, the places (K,) where, all places (P + N, 2) [m].

    An open end touches what is within ``NEAR_END``, another vertex what is within ``NEAR_VERTEX``.
    """
    import shapely

    at, pairs, line = given.points, given.pairs, given.line
    shapes = shapely.linestrings(at[pairs])
    one, other = shapely.STRtree(shapes).query(shapes, predicate='dwithin', distance=NEAR_END)
    apart = (pairs[one][:, :, None] != pairs[other][:, None, :]).all(axis=(1, 2))
    apart &= level[line[one]] == level[line[other]]
    one, other = one[apart], other[apart]
    pair = np.minimum(one, other) * len(pairs) + np.maximum(one, other)
    ends = pairs[one]
    reach = np.where(np.bincount(pairs.ravel())[ends] == 1, NEAR_END, NEAR_VERTEX)
    touches = (shapely.distance(shapely.points(at[ends]), shapes[other][:, None]) <= reach) & (
        line[one] != line[other])[:, None]
    row, which = np.nonzero(touches)
    cut, place = other[row], ends[row, which]
    fits = ~(np.abs(given.heights[place] - _heights_at(given, cut, at[place])) > CLEARANCE)
    crosses = (one < other) & ~np.isin(pair, pair[touches.any(axis=1)])
    one, other = one[crosses], other[crosses]
    met = shapely.intersection(shapes[one], shapes[other])
    single = shapely.get_type_id(met) == shapely.GeometryType.POINT
    one, other, met = one[single], other[single], shapely.get_coordinates(met[single])
    level_met = ~(np.abs(_heights_at(given, one, met) - _heights_at(given, other, met)) > CLEARANCE)
    one, other, met = one[level_met], other[level_met], met[level_met]
    new = len(at) + np.arange(len(met))
    return (np.concatenate((cut[fits], one, other)), np.concatenate((place[fits], new, new)),
            np.concatenate((at, met)))


def _heights_at(given: Segments, segment: IndexArray, at: FloatArray) -> FloatArray:
    """Heights (K,) of segments (K,) at the places (K, 2) [m] next to them, NaN if unknown."""
    a, b = np.moveaxis(given.points[given.pairs[segment]], 1, 0)
    share = ((at - a) * (b - a)).sum(axis=1) / ((b - a) ** 2).sum(axis=1)
    low, high = given.heights[given.pairs[segment]].T
    return np.asarray(low + np.clip(share, 0.0, 1.0) * (high - low))
