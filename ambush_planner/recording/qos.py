"""Quality-of-service profiles as rosbag2 (Jazzy, metadata version 9) writes them."""

from __future__ import annotations

from typing import Any

import yaml
from rclpy.duration import Duration, Infinite
from rclpy.qos import LivelinessPolicy, QoSProfile


def qos_to_yaml(profile: QoSProfile) -> str:
    """Return the YAML list with one profile that a channel's ``offered_qos_profiles`` holds.

    Policies that the profile leaves to the middleware and that have one default in DDS
    (durations, liveliness) are written as that default: what the publisher really offered.
    """
    return yaml.safe_dump([_profile_fields(profile)], sort_keys=False)


def qos_from_yaml(text: str) -> list[dict[str, Any]]:
    """Return the profiles of a channel's ``offered_qos_profiles`` as plain mappings."""
    return yaml.safe_load(text)


def _profile_fields(profile: QoSProfile) -> dict[str, Any]:
    """All nine fields: rosbag2 refuses a bag where one is missing."""
    liveliness = profile.liveliness
    if liveliness == LivelinessPolicy.SYSTEM_DEFAULT:
        liveliness = LivelinessPolicy.AUTOMATIC
    return {
        'history': profile.history.short_key,
        'depth': profile.depth,
        'reliability': profile.reliability.short_key,
        'durability': profile.durability.short_key,
        'deadline': _duration_fields(profile.deadline),
        'lifespan': _duration_fields(profile.lifespan),
        'liveliness': liveliness.short_key,
        'liveliness_lease_duration': _duration_fields(profile.liveliness_lease_duration),
        'avoid_ros_namespace_conventions': bool(profile.avoid_ros_namespace_conventions),
    }


def _duration_fields(duration: Duration) -> dict[str, int]:
    # rmw reads a duration of 0 as "unspecified", for which DDS has infinity.
    nanoseconds = duration.nanoseconds or Infinite.nanoseconds
    seconds, rest = divmod(nanoseconds, 1_000_000_000)
    return {'sec': seconds, 'nsec': rest}
