"""The part of tf2's buffer that the planner needs: how frames lie to each other, over time.

Covered: moving transforms of the last ten seconds, interpolated (positions linearly, orientations
by slerp); static transforms; chains of both over a common ancestor; the latest time that all moving
links of a chain know. Not covered: lookups that wait, lookups through a fixed frame, and frames
whose parent changes (the history before the change is dropped).
"""

from __future__ import annotations

import math
from bisect import bisect_left
from dataclasses import dataclass, field
from threading import Lock
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from ..arrays import FloatArray

HISTORY_NS = 10_000_000_000


class TransformUnknown(Exception):
    """No transform between two frames is known; the message says why."""


class Rigid(NamedTuple):
    """A rigid motion x -> rotation x + translation (3,)."""

    translation: FloatArray
    rotation: Rotation

    def __matmul__(self, other: Rigid) -> Rigid:
        """Return the motion that applies ``other`` first and then this one."""
        shift = self.rotation.apply(other.translation) + self.translation
        return Rigid(shift, self.rotation * other.rotation)

    def inverse(self) -> Rigid:
        """Return the inverse motion."""
        back = self.rotation.inv()
        return Rigid(-back.apply(self.translation), back)


class StampedTransform(NamedTuple):
    """The pose of ``child`` in ``parent`` at a time [ns]; the quaternion is (x, y, z, w)."""

    parent: str
    child: str
    stamp_ns: int
    translation: tuple[float, float, float]
    quaternion: tuple[float, float, float, float]

    @property
    def rigid(self) -> Rigid:
        """The motion that takes coordinates in ``child`` to coordinates in ``parent``."""
        return Rigid(np.array(self.translation), Rotation.from_quat(self.quaternion))

    @property
    def is_valid(self) -> bool:
        """Whether the frames are two and the numbers, once normalised, are a rigid motion."""
        norm = math.fsum(part * part for part in self.quaternion)
        return (
            '' not in (self.parent, self.child) and self.parent != self.child
            and all(map(math.isfinite, self.translation)) and 0.0 < norm < math.inf
        )


class Found(NamedTuple):
    """A transform that was looked up, and its time; None if all its links are static."""

    rigid: Rigid
    stamp_ns: int | None


@dataclass(eq=False)
class _Link:
    """The pose of a frame in its parent: one static transform, or some with ascending times."""

    parent: str
    static: bool
    transforms: list[StampedTransform] = field(default_factory=list)

    @property
    def latest_ns(self) -> int:
        return self.transforms[-1].stamp_ns

    def at(self, stamp_ns: int) -> Rigid:
        """Return the motion to the parent at a time, which a static link ignores."""
        if self.static:
            return self.transforms[0].rigid
        if not self.transforms[0].stamp_ns <= stamp_ns <= self.latest_ns:
            raise TransformUnknown('its times do not overlap with those of the other frames')
        k = self._index(stamp_ns)
        after = self.transforms[k]
        if after.stamp_ns == stamp_ns:
            return after.rigid
        before = self.transforms[k - 1]
        share = (stamp_ns - before.stamp_ns) / (after.stamp_ns - before.stamp_ns)
        one, other = before.rigid, after.rigid
        turns = Slerp([0.0, 1.0], Rotation.concatenate([one.rotation, other.rotation]))
        shift = one.translation + share * (other.translation - one.translation)
        return Rigid(shift, turns(share))

    def add(self, transform: StampedTransform) -> None:
        if self.static:
            self.transforms = [transform]
            return
        if self.transforms:  # as in tf2, what is new does not yet count
            oldest = self.latest_ns - HISTORY_NS
            del self.transforms[:self._index(oldest)]
            if transform.stamp_ns < oldest:
                return
        k = self._index(transform.stamp_ns)
        # The last transform of a time counts, as in tf2.
        same = k < len(self.transforms) and self.transforms[k].stamp_ns == transform.stamp_ns
        self.transforms[k:k + same] = [transform]

    def _index(self, stamp_ns: int) -> int:
        return bisect_left(self.transforms, stamp_ns, key=lambda each: each.stamp_ns)


class TransformBuffer:
    """Transforms by the names of their frames; thread-safe."""

    def __init__(self) -> None:
        self._links: dict[str, _Link] = {}
        self._lock = Lock()

    def add(self, transform: StampedTransform, static: bool) -> None:
        """Add a transform; an invalid one is ignored, as by tf2."""
        parent, child = transform.parent.lstrip('/'), transform.child.lstrip('/')
        transform = transform._replace(parent=parent, child=child)
        if not transform.is_valid:
            return
        with self._lock:
            link = self._links.get(child)
            if link is None or link.static or static or link.parent != parent:
                link = self._links[child] = _Link(parent, static)
            link.add(transform)

    def clear(self) -> None:
        """Remove all but static transforms."""
        with self._lock:
            self._links = {name: link for name, link in self._links.items() if link.static}

    def lookup(self, target: str, source: str, stamp_ns: int | None = None) -> Found:
        """Return the motion from ``source`` to ``target``, by default at the latest common time.

        Raises TransformUnknown if a frame does not exist (unless it is both), or the two frames are
        not connected at one time.
        """
        if target == source:
            return Found(Rigid(np.zeros(3), Rotation.identity()), stamp_ns)
        with self._lock:
            up, down = self._to_root(source), self._to_root(target)
            # Links above the nearest common ancestor do not matter.
            while up and down and up[-1] is down[-1]:
                up.pop()
                down.pop()
            ends = (up[-1].parent if up else source), (down[-1].parent if down else target)
            if ends[0] != ends[1]:
                raise TransformUnknown(f'no transforms connect {source!r} and {target!r}')
            moving = [link for link in (*up, *down) if not link.static]
            if stamp_ns is None:
                stamp_ns = min((link.latest_ns for link in moving), default=0)
            rigid = _along(down, stamp_ns).inverse() @ _along(up, stamp_ns)
        return Found(rigid, stamp_ns if moving else None)

    def _to_root(self, name: str) -> list[_Link]:
        """Return the links from a frame up to the root of its tree."""
        if name not in self._links and all(link.parent != name for link in self._links.values()):
            raise TransformUnknown(f'the frame {name!r} does not exist')
        chain: list[_Link] = []
        while (link := self._links.get(name)) is not None:
            chain.append(link)
            if len(chain) > len(self._links):
                raise TransformUnknown('the frames form a loop')
            name = link.parent
        return chain


def _along(chain: list[_Link], stamp_ns: int) -> Rigid:
    """Return the motion from the first frame of a chain to the parent of its last link."""
    motion = Rigid(np.zeros(3), Rotation.identity())
    for link in chain:
        motion = link.at(stamp_ns) @ motion
    return motion
