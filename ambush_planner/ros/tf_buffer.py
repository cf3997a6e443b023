"""How frames lie to each other, by the transforms that were told: the part of tf2 that is needed.

Covered: moving transforms of the last ten seconds, interpolated (positions along the line,
orientations along the great circle); static ones; chains of both over a common ancestor; the latest
time that all moving links of a chain know. Not covered: lookups that wait, lookups through a fixed
frame, and frames whose parent changes (the history before the change is dropped).
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass, field
from threading import Lock
from typing import NamedTuple

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]  # x, y, z, w

HISTORY_NS = 10_000_000_000
# Of the squared norm, as tf2 checks quaternions.
_UNIT_TOLERANCE = 1e-2
# A longer chain is a loop of frames.
_LONGEST_CHAIN = 1000


class TransformUnknown(Exception):
    """It is not known how two frames lie to each other; the message says why."""


class Rigid(NamedTuple):
    """A rigid motion: x -> rotation x + translation."""

    translation: Vector
    rotation: Quaternion

    def __matmul__(self, other: Rigid) -> Rigid:
        """First ``other``, then this one."""
        moved = turned(self.rotation, other.translation)
        shift = (
            moved[0] + self.translation[0],
            moved[1] + self.translation[1],
            moved[2] + self.translation[2],
        )
        return Rigid(shift, product(self.rotation, other.rotation))

    def inverse(self) -> Rigid:
        """The motion that takes it back."""
        x, y, z, w = self.rotation
        back = (-x, -y, -z, w)
        u, v, n = turned(back, self.translation)
        return Rigid((-u, -v, -n), back)


IDENTITY = Rigid((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))


class StampedTransform(NamedTuple):
    """Where ``child`` lies in ``parent`` at a time [ns]."""

    parent: str
    child: str
    stamp_ns: int
    rigid: Rigid


class Found(NamedTuple):
    """A transform that was looked up, and its time; no time where all links are static."""

    rigid: Rigid
    stamp_ns: int | None


@dataclass
class _Link:
    """Where a frame lies in its parent; times ascend. A static one has no times."""

    parent: str
    static: bool
    stamps: list[int] = field(default_factory=list)
    motions: list[Rigid] = field(default_factory=list)

    def at(self, stamp_ns: int | None) -> Rigid:
        if self.static:
            return self.motions[0]
        if stamp_ns is None or not self.stamps[0] <= stamp_ns <= self.stamps[-1]:
            raise TransformUnknown('its times do not overlap with those of the other frames')
        k = bisect_left(self.stamps, stamp_ns)
        if self.stamps[k] == stamp_ns:
            return self.motions[k]
        before, after = self.stamps[k - 1], self.stamps[k]
        share = (stamp_ns - before) / (after - before)
        return between(self.motions[k - 1], self.motions[k], share)

    def add(self, stamp_ns: int, motion: Rigid) -> None:
        if self.stamps and stamp_ns < self.stamps[-1] - HISTORY_NS:
            return
        k = bisect_left(self.stamps, stamp_ns)
        if k < len(self.stamps) and self.stamps[k] == stamp_ns:
            return  # told already: the first one counts, as in tf2
        self.stamps.insert(k, stamp_ns)
        self.motions.insert(k, motion)
        old = bisect_left(self.stamps, self.stamps[-1] - HISTORY_NS)
        del self.stamps[:old], self.motions[:old]


class TransformBuffer:
    """Transforms by the names of their frames; safe to be used from several threads."""

    def __init__(self) -> None:
        self._links: dict[str, _Link] = {}
        self._lock = Lock()

    def add(self, transform: StampedTransform, static: bool) -> None:
        """Take note of a transform; one that makes no sense is ignored, as tf2 does."""
        parent, child = transform.parent.lstrip('/'), transform.child.lstrip('/')
        if not parent or not child or parent == child or not _is_rigid(transform.rigid):
            return
        with self._lock:
            link = self._links.get(child)
            if link is None or link.static or static or link.parent != parent:
                link = self._links[child] = _Link(parent, static)
            if static:
                link.motions = [transform.rigid]
            else:
                link.add(transform.stamp_ns, transform.rigid)

    def clear(self) -> None:
        """Forget all but static transforms."""
        with self._lock:
            self._links = {name: link for name, link in self._links.items() if link.static}

    def lookup(self, target: str, source: str, stamp_ns: int | None = None) -> Found:
        """Return the motion from ``source`` to ``target``, by default at the latest common time.

        Raises
        ------
        TransformUnknown
            A frame does not exist, the two are not connected, or not at one time.
        """
        with self._lock:
            up, down = self._chains(source, target)
            links = [*up, *down]
            if stamp_ns is None:
                stamp_ns = min((link.stamps[-1] for link in links if not link.static), default=None)
            source_up, target_up = _along(up, stamp_ns), _along(down, stamp_ns)
        static = all(link.static for link in links)
        return Found(target_up.inverse() @ source_up, None if static else stamp_ns)

    def _chains(self, source: str, target: str) -> tuple[list[_Link], list[_Link]]:
        """The links from either frame up to the nearest ancestor of both."""
        for name in (source, target):
            if not self._exists(name):
                raise TransformUnknown(f'the frame {name!r} does not exist')
        ups = list(self._ancestors(source))
        names = [source, *(link.parent for link in ups)]
        downs: list[_Link] = []
        at = target
        for link in (*self._ancestors(target), None):
            if at in names:
                return ups[:names.index(at)], downs
            if link is not None:
                downs.append(link)
                at = link.parent
        raise TransformUnknown(f'{source!r} and {target!r} are not in one tree')

    def _exists(self, name: str) -> bool:
        return name in self._links or any(link.parent == name for link in self._links.values())

    def _ancestors(self, name: str) -> Iterator[_Link]:
        for _ in range(_LONGEST_CHAIN):
            link = self._links.get(name)
            if link is None:
                return
            yield link
            name = link.parent
        raise TransformUnknown('the frames form a loop')


def product(a: Quaternion, b: Quaternion) -> Quaternion:
    """The rotation that turns by ``b`` and then by ``a``."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def turned(rotation: Quaternion, vector: Vector) -> Vector:
    """Turn a vector."""
    x, y, z, w = rotation
    a, b, c = vector
    u, v, n = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    return (
        a + w * u + y * n - z * v,
        b + w * v + z * u - x * n,
        c + w * n + x * v - y * u,
    )


def between(one: Rigid, other: Rigid, share: float) -> Rigid:
    """The motion at ``share`` (0..1) of the way: a line for positions, slerp for rotations."""
    t = tuple(a + share * (b - a) for a, b in zip(one.translation, other.translation, strict=True))
    return Rigid((t[0], t[1], t[2]), _slerp(one.rotation, other.rotation, share))


def _slerp(a: Quaternion, b: Quaternion, share: float) -> Quaternion:
    cosine = math.fsum(p * q for p, q in zip(a, b, strict=True))
    sign = -1.0 if cosine < 0.0 else 1.0  # the shorter way
    angle = math.acos(min(1.0, abs(cosine)))
    if angle < 1e-9:
        return a
    before, after = math.sin((1.0 - share) * angle), sign * math.sin(share * angle)
    x, y, z, w = (
        (before * p + after * q) / math.sin(angle) for p, q in zip(a, b, strict=True)
    )
    return x, y, z, w


def normalised(rotation: Quaternion) -> Quaternion:
    """The same rotation as a quaternion of length 1."""
    norm = math.sqrt(math.fsum(part * part for part in rotation))
    x, y, z, w = rotation
    return x / norm, y / norm, z / norm, w / norm


def _is_rigid(motion: Rigid) -> bool:
    norm = math.fsum(part * part for part in motion.rotation)
    return all(map(math.isfinite, motion.translation)) and abs(norm - 1.0) <= _UNIT_TOLERANCE


def _along(chain: list[_Link], stamp_ns: int | None) -> Rigid:
    """The motion from the first frame of a chain to the parent of its last link."""
    motion = IDENTITY
    for link in chain:
        motion = link.at(stamp_ns) @ motion
    return Rigid(motion.translation, normalised(motion.rotation))
