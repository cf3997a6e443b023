# SPDX-License-Identifier: Apache-2.0
"""Message definitions as an MCAP file carries them, of all types that are recorded."""

from __future__ import annotations

import json
from functools import cache
from importlib import resources
from typing import NamedTuple

MAP, POSE, PATH = 'nav_msgs/msg/OccupancyGrid', 'geometry_msgs/msg/PoseStamped', 'nav_msgs/msg/Path'
# The types of recorded inputs, and of the path, by their roles in the metadata record.
INPUT_TYPES = {'map': (MAP,), 'start': (POSE, 'geometry_msgs/msg/PoseWithCovarianceStamped'),
               'goal': (POSE,), 'via': ('geometry_msgs/msg/PoseArray',)}
ROLE_TYPES = {**INPUT_TYPES, 'path': (PATH,)}
# What else is recorded: the strategy as markers, each on a topic below the node's name, and the
# diagnostics.
MARKERS = 'visualization_msgs/msg/MarkerArray'
MARKER_NAMES = 'edge_probabilities', 'mean_direction', 'ambush_sites', 'stops'
DIAGNOSTICS = 'diagnostic_msgs/msg/DiagnosticArray', '/diagnostics'


class MessageDefinition(NamedTuple):
    """A message type, described so that a reader without ROS can decode it.

    ``text`` is the type's definition and those of all types it uses, as ``ros2msg``, without
    comments, which would be in each recording; ``type_hash`` is the REP 2011 hash, ``RIHS01_...``.
    """

    text: str
    type_hash: str


@cache
def definitions() -> dict[str, MessageDefinition]:
    """The definitions by the names of their types, as Jazzy has them."""
    text = resources.files(__package__).joinpath('definitions.json').read_text('utf-8')
    return {name: MessageDefinition(**fields) for name, fields in json.loads(text).items()}
