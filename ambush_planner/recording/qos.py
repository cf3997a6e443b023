"""Quality-of-service profiles as rosbag2 (Jazzy, metadata version 9) writes them."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import yaml
from rclpy.duration import Duration, Infinite
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)

from .yaml_text import BadYaml, load_yaml


def qos_to_yaml(profile: QoSProfile) -> str:
    """Return the YAML list with one profile that a channel's ``offered_qos_profiles`` holds.

    Policies that the profile leaves to the middleware and that have one default in DDS
    (durations, liveliness) are written as that default: what the publisher really offered.
    """
    return _yaml_of(
        profile.history,
        profile.depth,
        profile.reliability,
        profile.durability,
        profile.deadline.nanoseconds,
        profile.lifespan.nanoseconds,
        profile.liveliness,
        profile.liveliness_lease_duration.nanoseconds,
        bool(profile.avoid_ros_namespace_conventions),
    )


def qos_from_yaml(text: str) -> QoSProfile:
    """Return the first profile of a channel's ``offered_qos_profiles``.

    Raises:
        BadYaml: The text does not list complete profiles, or the first is none that a publisher
            can have.
    """
    profiles = load_yaml(text)
    try:
        fields = profiles[0]
        profile = QoSProfile(
            history=HistoryPolicy.get_from_short_key(fields['history']),
            depth=fields['depth'],
            reliability=ReliabilityPolicy.get_from_short_key(fields['reliability']),
            durability=DurabilityPolicy.get_from_short_key(fields['durability']),
            deadline=_duration(fields['deadline']),
            lifespan=_duration(fields['lifespan']),
            liveliness=LivelinessPolicy.get_from_short_key(fields['liveliness']),
            liveliness_lease_duration=_duration(fields['liveliness_lease_duration']),
            avoid_ros_namespace_conventions=fields['avoid_ros_namespace_conventions'],
        )
    except (
        LookupError, TypeError, ValueError, ArithmeticError, AttributeError, AssertionError,
    ) as error:
        raise BadYaml('no complete quality-of-service profile') from error
    policies = profile.history, profile.reliability, profile.durability, profile.liveliness
    if any(policy.name == 'UNKNOWN' for policy in policies) or not 0 <= profile.depth < 2**31:
        raise BadYaml('a quality-of-service profile that no publisher can have')
    return profile


@lru_cache(maxsize=256)
def _yaml_of(
    history: HistoryPolicy,
    depth: int,
    reliability: ReliabilityPolicy,
    durability: DurabilityPolicy,
    deadline_ns: int,
    lifespan_ns: int,
    liveliness: LivelinessPolicy,
    lease_ns: int,
    avoid_ros_namespace_conventions: bool,
) -> str:
    """All nine fields: rosbag2 refuses a bag where one is missing."""
    if liveliness == LivelinessPolicy.SYSTEM_DEFAULT:
        liveliness = LivelinessPolicy.AUTOMATIC
    fields = {
        'history': history.short_key,
        'depth': depth,
        'reliability': reliability.short_key,
        'durability': durability.short_key,
        'deadline': _duration_fields(deadline_ns),
        'lifespan': _duration_fields(lifespan_ns),
        'liveliness': liveliness.short_key,
        'liveliness_lease_duration': _duration_fields(lease_ns),
        'avoid_ros_namespace_conventions': avoid_ros_namespace_conventions,
    }
    return yaml.safe_dump([fields], sort_keys=False)


def _duration_fields(nanoseconds: int) -> dict[str, int]:
    # rmw reads a duration of 0 as "unspecified", for which DDS has infinity.
    seconds, rest = divmod(nanoseconds or Infinite.nanoseconds, 1_000_000_000)
    return {'sec': seconds, 'nsec': rest}


def _duration(fields: Any) -> Duration:
    return Duration(seconds=fields['sec'], nanoseconds=fields['nsec'])
