"""Quality-of-service profiles as rosbag2 (Jazzy, metadata version 9) writes them."""

from __future__ import annotations

import re
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import yaml

if TYPE_CHECKING:
    from rclpy.qos import QoSProfile

# All of them: rosbag2 refuses a bag where one is missing.
FIELDS = (
    'history', 'depth', 'reliability', 'durability', 'deadline', 'lifespan', 'liveliness',
    'liveliness_lease_duration', 'avoid_ros_namespace_conventions',
)
_DURATIONS = ('deadline', 'lifespan', 'liveliness_lease_duration')
_INFINITE_NS = 2**63 - 1
_MOST_CHARACTERS = 4096
# Anchors, aliases, tags and merges: a few bytes of these may stand for gigabytes.
_COSTLY = re.compile(r'[&*!<]|\d:\d')


def qos_to_yaml(profile: QoSProfile) -> str:
    """Return the YAML list with one profile that a channel's ``offered_qos_profiles`` holds.

    Policies that the profile leaves to the middleware and that have one default in DDS
    (durations, liveliness) are written as that default: what the publisher really offered.
    """
    values = (getattr(profile, name) for name in FIELDS)
    return _yaml_of(*(getattr(each, 'nanoseconds', each) for each in values))


@lru_cache(maxsize=256)
def fields_from_yaml(text: str) -> dict[str, Any]:
    """Return the fields of the first profile of a channel's ``offered_qos_profiles``.

    Durations are mappings of ``sec`` and ``nsec``.

    Raises
    ------
    ValueError
        The text does not list complete profiles.
    """
    if len(text) > _MOST_CHARACTERS or _COSTLY.search(text):
        raise ValueError('its quality of service is over-long, or has anchors or tags')
    try:
        fields = yaml.safe_load(text)[0]
        whole = set(fields) == set(FIELDS) and isinstance(fields, dict)
        durations = [set(fields[name]) for name in _DURATIONS]
    except (yaml.YAMLError, LookupError, TypeError, ValueError, RecursionError) as error:
        raise ValueError('it has no quality-of-service profile') from error
    if not whole or any(each != {'sec', 'nsec'} for each in durations):
        raise ValueError('it has no complete quality-of-service profile')
    return fields


@lru_cache(maxsize=256)
def is_written_so(text: str) -> bool:
    """Whether a text is what ``qos_to_yaml`` writes of what it says."""
    try:
        return yaml.safe_dump([fields_from_yaml(text)], sort_keys=False) == text
    except (ValueError, yaml.YAMLError):
        return False


@lru_cache(maxsize=256)
def _yaml_of(*values: Any) -> str:
    fields = dict(zip(FIELDS, values, strict=True))
    for name in _DURATIONS:
        # rmw reads a duration of 0 as "unspecified", for which DDS has infinity.
        seconds, rest = divmod(fields[name] or _INFINITE_NS, 1_000_000_000)
        fields[name] = {'sec': seconds, 'nsec': rest}
    for name in ('history', 'reliability', 'durability', 'liveliness'):
        fields[name] = fields[name].short_key
    if fields['liveliness'] == 'system_default':
        fields['liveliness'] = 'automatic'
    fields['avoid_ros_namespace_conventions'] = bool(fields['avoid_ros_namespace_conventions'])
    return yaml.safe_dump([fields], sort_keys=False)
