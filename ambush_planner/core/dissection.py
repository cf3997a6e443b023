"""Geometric nested dissection: an elimination order that keeps factors of planar systems sparse."""

from __future__ import annotations

import numpy as np

from .network import IndexArray
from .risk_map import FloatArray

LEAF = 24


def nested_dissection(points: FloatArray, links: IndexArray) -> IndexArray:
    """Order (K,) in which to eliminate K unknowns at ``points`` that ``links`` (L, 2) couple.

    Halves the points by coordinate again and again; the unknowns that separate the halves come
    after both. Source: A. George, Nested dissection of a regular finite element mesh, 1973.
    """
    count = len(points)
    label = np.zeros(count, dtype=np.int64)
    level_of = np.full(count, -1, dtype=np.int64)
    depth = max(int(np.ceil(np.log2(max(count, 1) / LEAF))), 0)
    for level in range(depth):
        side = _halves(points, label, level_of)
        separator = _separator(links, label, level_of, side)
        level_of[separator] = level
        label = 2 * label + side
    return _postorder(label, level_of, depth)


def _halves(points: FloatArray, label: IndexArray, level_of: IndexArray) -> IndexArray:
    """0 or 1 for each unknown: below or above its part's median along its longer side."""
    count = len(points)
    inside = np.flatnonzero(level_of < 0)
    part = label[inside]
    axis = _longer_axis(points[inside], part)
    key = np.where(axis[part] == 0, points[inside, 0], points[inside, 1])
    order = np.lexsort((inside, key, part))
    sorted_part = part[order]
    start = np.searchsorted(sorted_part, sorted_part, side="left")
    stop = np.searchsorted(sorted_part, sorted_part, side="right")
    upper = np.arange(len(order)) - start >= (stop - start) // 2
    side = np.zeros(count, dtype=np.int64)
    side[inside[order]] = upper
    return side


def _longer_axis(points: FloatArray, part: IndexArray) -> IndexArray:
    size = int(part.max(initial=-1)) + 1
    spread = np.empty((size, 2))
    for axis in (0, 1):
        low, high = np.full(size, np.inf), np.full(size, -np.inf)
        np.minimum.at(low, part, points[:, axis])
        np.maximum.at(high, part, points[:, axis])
        spread[:, axis] = high - low
    return np.argmax(spread, axis=1)


def _separator(
    links: IndexArray, label: IndexArray, level_of: IndexArray, side: IndexArray
) -> IndexArray:
    """Unknowns that cover every link between the two halves of a part.

    Of each part's two covers, all lower ends or all upper ends of such links, the smaller.
    """
    a, b = links.T
    across = (
        (level_of[a] < 0) & (level_of[b] < 0) & (label[a] == label[b]) & (side[a] != side[b])
    )
    a, b = a[across], b[across]
    swap = side[a] == 1
    lower, upper = np.where(swap, b, a), np.where(swap, a, b)
    lower, upper = np.unique(lower), np.unique(upper)
    size = int(label.max()) + 1
    lower_count = np.bincount(label[lower], minlength=size)
    upper_count = np.bincount(label[upper], minlength=size)
    take_lower = lower_count <= upper_count
    return np.concatenate((lower[take_lower[label[lower]]], upper[~take_lower[label[upper]]]))


def _postorder(label: IndexArray, level_of: IndexArray, depth: int) -> IndexArray:
    """Sort so that both halves of every part come before the unknowns that separate them."""
    # A separator of level k has the label of its part and side appended depth - k times; its key
    # is the last leaf below its part, and after that leaf the deepest separators come first.
    level = np.where(level_of < 0, depth, level_of)
    below = np.int64(1) << (depth - level)
    part = label >> (depth - level)
    last_leaf = (part + 1) * below - 1
    order: IndexArray = np.lexsort((-level, last_leaf))
    return order
