"""One recorded departure opened for review: its parameters and messages, each decoded once."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray, PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid
from nav_msgs.msg import Path as PathMessage
from nav_msgs.srv import GetPlan
from rclpy.serialization import deserialize_message, serialize_message
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from ..errors import AmbushPlannerError
from ..game.strategy import Strategy
from ..maps.risk_map import RiskMap
from ..maps.ros_messages import risk_map_from_ros
from ..planning.node_parameters import NodeParameters, parameters_from
from ..planning.parameters import PARAMETERS
from . import RecordedDeparture, RecordedMessage, UnreadableRecording, type_name
from .npz import BadAttachment
from .strategy_file import strategy_from_file

_INPUTS = (OccupancyGrid, PoseStamped, PoseWithCovarianceStamped, PoseArray)
# No other type is looked for: a file could name any module.
TYPES: Mapping[str, type] = MappingProxyType({
    type_name(kind): kind
    for kind in (*_INPUTS, PathMessage, MarkerArray, DiagnosticArray, Trigger.Event, GetPlan.Event)
})
# Maps and poses are recorded as inputs only.
INPUT_TYPES = frozenset(map(type_name, _INPUTS))
# A message from the network may have up to three bytes of padding at its end.
_MOST_PADDING = 3


class Case:
    """A recorded departure with the node's parameters and its messages.

    Attributes
    ----------
    recorded, metadata
        What the file says.
    parameters
        All parameters of the node, as the node reads them.

    Raises
    ------
    UnreadableRecording
        The recorded parameters are not those of this planner.
    """

    def __init__(self, recorded: RecordedDeparture) -> None:
        self.recorded, self.metadata = recorded, recorded.metadata
        self.parameters: NodeParameters = self._parameters()
        self._decoded: dict[int, Any] = {}

    @property
    def path(self) -> Path:
        """The file."""
        return self.recorded.path

    def unreadable(self, reason: str) -> UnreadableRecording:
        """The error that says what is wrong with the file."""
        return UnreadableRecording(self.path, reason)

    def of_type(self, *kinds: type) -> list[RecordedMessage]:
        """The recorded messages of these types."""
        names = {type_name(kind) for kind in kinds}
        return [each for each in self.recorded.messages if each.type in names]

    def message(self, role: str, *kinds: type) -> Any:
        """Return the message in a role, which must be of one of these types."""
        message = self.decode(self.recorded.recorded(role))
        if not isinstance(message, kinds or object):
            raise self.unreadable(f'{role}: it is not of the type {kinds[0].__name__}')
        return message

    def decode(self, recorded: RecordedMessage) -> Any:
        """Return a recorded message, deserialised.

        Raises
        ------
        UnreadableRecording
            The planner records nothing of its type, or its data is not a message of it.
        """
        if id(recorded) not in self._decoded:
            try:
                self._decoded[id(recorded)] = _deserialised(recorded)
            except ValueError as error:
                where = f'the message on {recorded.topic[:60]!r}'
                raise self.unreadable(f'{where}: {error}') from error
        return self._decoded[id(recorded)]

    def strategy(self) -> Strategy:
        """Return the recorded strategy with its network and game, its certificate anew.

        Raises
        ------
        UnreadableRecording
            The attachment is not a strategy, or its numbers do not agree.
        """
        try:
            return strategy_from_file(self.recorded.strategy, self.parameters.planning.game)
        except BadAttachment as error:
            raise self.unreadable(f'the recorded strategy: {error}') from error

    def risk_map(self) -> RiskMap:
        """Return the risk map that the departure was planned on.

        Raises
        ------
        UnreadableRecording
            The recorded map is not an occupancy grid that can be read.
        """
        try:
            message = self.message('map', OccupancyGrid)
            return risk_map_from_ros(message, self.parameters.occupancy)
        except AmbushPlannerError as error:
            raise self.unreadable(f'the recorded map: {error}') from error

    def _parameters(self) -> NodeParameters:
        values = self.metadata.parameters
        if others := sorted(set(values) ^ set(PARAMETERS)):
            raise self.unreadable(f'the recorded parameters are not ours, see {others[0][:60]!r}')
        if type(values['seed']) is not int or values['seed'] < -1:
            raise self.unreadable('parameters: seed is not a whole number >= -1')
        try:
            parameters = parameters_from(values)
            hash((parameters.occupancy, parameters.planning))
        except (AmbushPlannerError, LookupError, TypeError, ValueError, AttributeError) as error:
            raise self.unreadable(f'the recorded parameters: {error}') from error
        return parameters


def _deserialised(recorded: RecordedMessage) -> Any:
    if recorded.type not in TYPES:
        raise ValueError(f'the planner records nothing of type {recorded.type[:60]!r}')
    kind = TYPES[recorded.type]
    try:
        message = deserialize_message(recorded.data, kind)
        size = len(serialize_message(message))
    except Exception as error:
        # The middleware chooses what it raises: RMWError, RuntimeError, UnicodeDecodeError, ...
        raise ValueError(f'it is not a {kind.__name__} message ({type(error).__name__})') from error
    if not 0 <= len(recorded.data) - size <= _MOST_PADDING:
        raise ValueError(
            f'{len(recorded.data)} bytes where a {kind.__name__} of its fields has {size}'
        )
    return message
