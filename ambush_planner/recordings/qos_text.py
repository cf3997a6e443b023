"""Quality-of-service profiles in the text format of rosbag2 (Jazzy, metadata version 9)."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import yaml

# rosbag2 refuses a bag that lacks one of these.
_FIELDS = (
    'history', 'depth', 'reliability', 'durability', 'deadline', 'lifespan', 'liveliness',
    'liveliness_lease_duration', 'avoid_ros_namespace_conventions',
)
DURATIONS = ('deadline', 'lifespan', 'liveliness_lease_duration')
_INFINITE_NS = 2**63 - 1


def qos_to_yaml(profile: Any) -> str:
    """Return the YAML list with one rclpy profile that a channel's ``offered_qos_profiles`` holds.

    Durations and liveliness that the profile leaves to the middleware are written as the DDS
    defaults, which are what the publisher offered.
    """
    values = (getattr(profile, name) for name in _FIELDS)
    return _yaml_of(*(getattr(value, 'nanoseconds', value) for value in values))


@lru_cache(maxsize=256)
def fields_from_yaml(text: str) -> dict[str, Any]:
    """Return the fields of the first profile in a channel's ``offered_qos_profiles``."""
    fields: dict[str, Any] = yaml.safe_load(text)[0]
    return fields


@lru_cache(maxsize=256)
def _yaml_of(*values: Any) -> str:
    fields = dict(zip(_FIELDS, values, strict=True))
    for name in DURATIONS:
        # rmw reads a duration of 0 as "unspecified", for which DDS has infinity.
        seconds, rest = divmod(fields[name] or _INFINITE_NS, 1_000_000_000)
        fields[name] = {'sec': seconds, 'nsec': rest}
    for name in ('history', 'reliability', 'durability', 'liveliness'):
        fields[name] = fields[name].short_key
    if fields['liveliness'] == 'system_default':
        fields['liveliness'] = 'automatic'
    fields['avoid_ros_namespace_conventions'] = bool(fields['avoid_ros_namespace_conventions'])
    return yaml.safe_dump([fields], sort_keys=False)
