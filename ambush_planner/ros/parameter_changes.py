"""The parameters of a running node: declared, set in any order, and judged together."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from ..errors import InvalidOption
from ..game.strategy import SOLVERS
from ..maps.risk_map import MOST_LOSS
from ..planning.node_parameters import NodeParameters, parameters_from
from ..planning.parameters import PARAMETERS, Declaration

_INT64_MAX = 2**63 - 1


def declare_parameters(
    node: Node,
    changed: Callable[[NodeParameters], None],
    contradicting: Callable[[InvalidOption], None],
) -> NodeParameters:
    """Declare all parameters, and tell of each new set from now on.

    What one request sets must be possible together, whatever the others are. Where it contradicts
    the others, as happens while ``ros2 param load`` sets one after the other, ``contradicting`` is
    called with the reason, else ``changed``.

    Raises
    ------
    InvalidOption
        The values that the node was started with are not valid as a set.
    rclpy.exceptions.ParameterException
        One of them has the wrong type or is out of its range.
    """
    node.declare_parameters(
        '', [(name, each.default, _descriptor(each)) for name, each in PARAMETERS.items()]
    )
    _warn_of_unknown(node)
    parameters = parameters_from(_values(node))

    def tell(_: list[Parameter]) -> None:
        try:
            now = parameters_from(_values(node))
        except InvalidOption as error:
            contradicting(error)
        else:
            changed(now)

    node.add_pre_set_parameters_callback(lambda changes: [*map(_infinity_as_number, changes)])
    node.add_on_set_parameters_callback(lambda changes: _check(node, changes))
    node.add_post_set_parameters_callback(tell)
    return parameters


def _warn_of_unknown(node: Node) -> None:
    """Say which values on the command line or in a file are for no parameter that there is."""
    # rclpy keeps them to itself. They are no error: one file may serve several nodes.
    unknown = sorted(
        name for name in node._parameter_overrides
        if not node.has_parameter(name) and not name.startswith('qos_overrides.')
    )
    if unknown:
        node.get_logger().warning(
            f'{", ".join(unknown)}: no such parameter, ignored; ros2 param list shows all'
        )


def _values(node: Node) -> dict[str, Any]:
    return {name: node.get_parameter(name).value for name in PARAMETERS}


def _infinity_as_number(change: Parameter) -> Parameter:
    """Undo what ``ros2 param load`` makes of ``.inf``: a text."""
    declared = PARAMETERS.get(change.name)
    if declared and isinstance(declared.default, float) and change.value == 'inf':
        return Parameter(change.name, value=math.inf)
    return change


def _check(node: Node, changes: list[Parameter]) -> SetParametersResult:
    """Answer whether ``changes`` are possible together; other parameters are not ours."""
    ours = {change.name: change.value for change in changes if change.name in PARAMETERS}
    for name, value in ours.items():
        if PARAMETERS[name].fixed and value != node.get_parameter(name).value:
            return SetParametersResult(
                successful=False, reason=f'{name} is read-only: it is read at the start'
            )
    try:
        _check_possible(ours)
    except InvalidOption as error:
        return SetParametersResult(successful=False, reason=str(error))
    return SetParametersResult(successful=True)


def _check_possible(changes: Mapping[str, Any]) -> None:
    """Raise InvalidOption where no values of the other parameters go with the changes."""
    others = {name: each.default for name, each in PARAMETERS.items()}
    others |= {'map.alpha_min': 0.0, 'map.alpha_max': MOST_LOSS}
    refused: list[InvalidOption] = []
    for solver in SOLVERS:
        try:
            parameters_from({**others, 'strategy.solver': solver, **changes})
        except InvalidOption as error:
            refused.append(error)
        else:
            return
    raise refused[0]


def _descriptor(declaration: Declaration) -> ParameterDescriptor:
    """Return what ``ros2 param describe`` shows."""
    constraint = f'one of {", ".join(declaration.choices)}' if declaration.choices else ''
    result = ParameterDescriptor(
        description=declaration.description,
        additional_constraints='read at the start only' if declaration.fixed else constraint,
    )
    if isinstance(declaration.default, float):
        result.floating_point_range = [
            FloatingPointRange(from_value=float(declaration.low), to_value=float(declaration.high))
        ]
    elif isinstance(declaration.default, int) and not isinstance(declaration.default, bool):
        result.integer_range = [
            IntegerRange(
                from_value=int(declaration.low), to_value=int(min(declaration.high, _INT64_MAX))
            )
        ]
    return result
