"""All that the planner records, by the names of the types."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid, Path
from nav_msgs.srv import GetPlan
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from .messages import type_name

_INPUTS = (OccupancyGrid, PoseStamped, PoseWithCovarianceStamped)
# No other type is looked for: a file could name any module.
TYPES: Mapping[str, type] = MappingProxyType({
    type_name(kind): kind
    for kind in (*_INPUTS, Path, MarkerArray, DiagnosticArray, Trigger.Event, GetPlan.Event)
})
# Maps and poses are recorded as inputs only.
INPUT_TYPES = frozenset(map(type_name, _INPUTS))
