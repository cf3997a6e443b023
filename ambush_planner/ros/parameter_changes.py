# SPDX-License-Identifier: Apache-2.0
"""Declare the parameters of a node, and check their changes."""

from __future__ import annotations

import math
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from ..errors import InvalidOption, telling_warnings
from ..gone import check_none_gone
from ..parameters.table import PARAMETERS, Declaration
from ..parameters.values import check_crs, parameters_from, roads_named
from ..recordings.plan_file import SavedPlan
from .gate import Gate
from .plan_from_file import planned_parameters, read_plan_for_node

# Maximum of a whole number in ROS.
_MAX_INT64 = 2**63 - 1


class NodeSettings:
    """The parameters of a node, all of which this declares; ``current`` are their values.

    Changes that contradict each other or the present values are refused: what depends on each other
    is set in one request. With ``parameters.locked`` changes are refused while the ``gate`` is
    open. A file with roads is read now. ``saved`` is the plan that the node starts from, if it is
    given one; its options are set first.

    Raises InvalidOption if the initial values are invalid as a set, and
    rclpy.exceptions.ParameterException if one has the wrong type or is out of its range.
    """

    def __init__(self, node: Node, gate: Gate) -> None:
        self._node, self._gate = node, gate
        node.declare_parameters(
            '', [(name, each.default, _descriptor(each)) for name, each in PARAMETERS.items()]
        )
        _check_unknown(node)
        self.saved = _saved_plan(node)
        values = self._values()
        check_crs(values)
        with telling_warnings(node.get_logger().warning):
            self._roads = (self.saved.plan.options.network.roads if self.saved else
                           roads_named(values))
            self.current = parameters_from(values, self._roads)
        node.add_pre_set_parameters_callback(lambda changes: [*map(_infinity_as_number, changes)])
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._update)

    def _values(self) -> dict[str, Any]:
        planned = self.saved.parameters.values if self.saved else {}  # also what is no parameter
        return {**planned, **{name: self._node.get_parameter(name).value for name in PARAMETERS}}

    def _check(self, changes: list[Parameter]) -> SetParametersResult:
        """Refuse changes of locked parameters, and those that do not agree with all others."""
        locked = self._gate.is_open and self.current.values['parameters.locked']
        for change in changes:
            if locked and change.value != self._node.get_parameter(change.name).value:
                return SetParametersResult(
                    successful=False, reason=f'{change.name} is read-only while the node is '
                    'active: parameters.locked is true')
        values = self._values() | {change.name: change.value for change in changes}
        try:
            check_crs(values)
            parameters_from(values, self._roads)
        except InvalidOption as error:
            return SetParametersResult(successful=False, reason=f'{error}; set parameters that '
                                       'depend on each other in one call')
        return SetParametersResult(successful=True)

    def _update(self, _: list[Parameter]) -> None:
        self.current = parameters_from(self._values(), self._roads)


def _saved_plan(node: Node) -> SavedPlan | None:
    """Read the plan that the node starts from, and set its parameters."""
    if not (path := node.get_parameter('plan').value):
        return None
    saved = read_plan_for_node(path)
    for name, value in planned_parameters(saved).items():
        result = node.set_parameters([Parameter(name, value=value)])[0]
        if not result.successful:
            raise InvalidOption(f'plan {path}: {result.reason}')
    return saved


def _check_unknown(node: Node) -> None:
    """Warn of initial values for unknown parameters; one file may serve several nodes.

    Raises InvalidOption if one is for a parameter that went.
    """
    given = node._parameter_overrides
    check_none_gone({name: parameter.value for name, parameter in given.items()})
    unknown = sorted(name for name in given
                     if not node.has_parameter(name) and not name.startswith('qos_overrides.'))
    if unknown:
        node.get_logger().warning(
            f'ignored unknown parameters: {", ".join(unknown)}; ros2 param list shows all'
        )


def _infinity_as_number(change: Parameter) -> Parameter:
    """Return the change with the number that ``ros2 param load`` sends as the string inf."""
    declared = PARAMETERS.get(change.name)
    if declared and isinstance(declared.default, float) and change.value == 'inf':
        return Parameter(change.name, value=math.inf)
    return change


def _descriptor(declaration: Declaration) -> ParameterDescriptor:
    """Return the type, range and description for ``ros2 param describe``."""
    constraint = f'one of {", ".join(declaration.choices)}' if declaration.choices else ''
    result = ParameterDescriptor(
        description=declaration.description,
        additional_constraints='read at the start only' if declaration.fixed else constraint,
        read_only=declaration.fixed,
    )
    low, high = declaration.low, declaration.high
    if isinstance(declaration.default, float):
        limits = FloatingPointRange(from_value=float(low), to_value=float(high))
        result.floating_point_range = [limits]
    elif isinstance(declaration.default, int) and not isinstance(declaration.default, bool):
        ends = IntegerRange(from_value=int(low), to_value=int(min(high, _MAX_INT64)))
        result.integer_range = [ends]
    return result
