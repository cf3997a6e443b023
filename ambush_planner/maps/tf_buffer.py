# SPDX-License-Identifier: Apache-2.0
"""Transforms between frames as they are now: the part of tf2's buffer that the planner needs.

The newest believable transform of each link counts, and static ones always do. tf2 answers for any
time, so it keeps a history and interpolates; a robot that asks where it is needs neither.
"""

from __future__ import annotations

import math
from collections import deque
from functools import reduce
from threading import Lock
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from ..arrays import FloatArray

# Number of moving transforms kept of each link: if a wrong clock stamped some, the others count.
KEPT = 10


class TransformUnknown(Exception):
    """No transform between two frames is known; the message says why."""


class StampedTransform(NamedTuple):
    """The pose of ``child`` in ``parent`` at a time [ns]; None: static.

    The quaternion is (x, y, z, w); it need not be normalised.
    """

    parent: str
    child: str
    stamp_ns: int | None
    translation: tuple[float, float, float]
    quaternion: tuple[float, float, float, float]

    @property
    def is_valid(self) -> bool:
        """True if the frames are two and the numbers, once normalised, are a rigid motion."""
        norm = math.fsum(part * part for part in self.quaternion)
        return (
            '' not in (self.parent, self.child) and self.parent != self.child
            and all(map(math.isfinite, self.translation)) and 0.0 < norm < math.inf
        )


class Found(NamedTuple):
    """A motion (4, 4) that was looked up, and its oldest and newest time [ns]; None: all static."""

    matrix: FloatArray
    stamp_ns: int | None
    newest_ns: int | None


class TransformBuffer:
    """Transforms by the names of their frames; thread-safe."""

    def __init__(self) -> None:
        self._links: dict[str, deque[StampedTransform]] = {}
        self._lock = Lock()

    def add(self, transform: StampedTransform) -> None:
        """Add a transform; an invalid one is ignored, as by tf2."""
        parent, child = transform.parent.lstrip('/'), transform.child.lstrip('/')
        transform = transform._replace(parent=parent, child=child)
        if not transform.is_valid:
            return
        with self._lock:
            kept = self._links.get(child)
            if not kept or kept[-1].parent != parent or None in (
                    transform.stamp_ns, kept[-1].stamp_ns):
                kept = self._links[child] = deque(maxlen=KEPT)
            kept.append(transform)

    def clear(self) -> None:
        """Remove all but static transforms."""
        with self._lock:
            self._links = {name: kept for name, kept in self._links.items()
                           if kept[-1].stamp_ns is None}

    def lookup(self, target: str, source: str, latest_ns: float = math.inf) -> Found:
        """Return the motion that takes coordinates in ``source`` to coordinates in ``target``.

        Transforms stamped after ``latest_ns`` only count for links that have no others.

        Raises TransformUnknown if a frame does not exist (unless it is both), or the two frames are
        not connected.
        """
        if target == source:
            return Found(np.eye(4), None, None)
        with self._lock:
            up, down = (self._to_root(name, latest_ns) for name in (source, target))
        # Links above the nearest common ancestor do not matter.
        while up and down and up[-1] is down[-1]:
            up.pop()
            down.pop()
        ends = (up[-1].parent if up else source), (down[-1].parent if down else target)
        if ends[0] != ends[1]:
            raise TransformUnknown(f'no transforms connect {source!r} and {target!r}')
        stamps = [link.stamp_ns for link in (*up, *down) if link.stamp_ns is not None]
        return Found(np.linalg.inv(_along(down)) @ _along(up), min(stamps, default=None),
                     max(stamps, default=None))

    def _to_root(self, name: str, latest_ns: float) -> list[StampedTransform]:
        """Return the links from a frame up to the root of its tree."""
        if name not in self._links and all(
                kept[-1].parent != name for kept in self._links.values()):
            raise TransformUnknown(f'the frame {name!r} does not exist')
        chain: list[StampedTransform] = []
        while name in self._links:
            chain.append(link := _newest(self._links[name], latest_ns))
            if len(chain) > len(self._links):
                raise TransformUnknown('the frames form a loop')
            name = link.parent
        return chain


def _newest(kept: deque[StampedTransform], latest_ns: float) -> StampedTransform:
    """Return the newest by its stamp, the last of equal ones, not after ``latest_ns`` if it can."""
    believed = [each for each in kept if (each.stamp_ns or 0) <= latest_ns] or kept
    return max(reversed(believed), key=lambda each: each.stamp_ns or 0)


def rigid_motion(translation: tuple[float, ...], quaternion: tuple[float, ...]) -> FloatArray:
    """Return the matrix (4, 4) of a rotation, by a quaternion (x, y, z, w), and a translation."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = Rotation.from_quat(quaternion).as_matrix(), translation
    return matrix


def _along(chain: list[StampedTransform]) -> FloatArray:
    """Return the motion from the first frame of a chain to the parent of its last link."""
    motions = [rigid_motion(link.translation, link.quaternion) for link in reversed(chain)]
    return reduce(np.matmul, motions, np.eye(4))
