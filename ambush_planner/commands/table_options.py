"""Options given as ``group.name=value``, by the names of the node's parameters."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import yaml

from ..errors import InvalidOption
from ..game.game import GameOptions
from ..game.strategy import StrategyOptions
from ..maps.occupancy import OccupancyOptions
from ..network.construction import NetworkOptions


@dataclass(frozen=True)
class TableOptions:
    """How a map is read and what is solved on it."""

    map: OccupancyOptions = field(default_factory=OccupancyOptions)
    network: NetworkOptions = field(default_factory=NetworkOptions)
    game: GameOptions = field(default_factory=GameOptions)
    strategy: StrategyOptions = field(default_factory=StrategyOptions)


def options_from(assignments: Sequence[str]) -> TableOptions:
    """Read assignments such as ``network.spacing=50``.

    Raises
    ------
    InvalidOption
        A name does not exist, a value has another type than the default, or is out of range.
    """
    options = TableOptions()
    changes: dict[str, dict[str, Any]] = {}
    for assignment in assignments:
        name, equals, text = assignment.partition('=')
        if not equals:
            raise InvalidOption(f'{assignment!r}: must be NAME=VALUE')
        group, _, option = name.strip().partition('.')
        changes.setdefault(group, {})[option] = _value(options, group, option, text)
    return dataclasses.replace(options, **{
        group: dataclasses.replace(getattr(options, group), **values)
        for group, values in changes.items()
    })


def _value(options: TableOptions, group: str, option: str, text: str) -> Any:
    names = {
        f'{part.name}.{each.name}': getattr(getattr(options, part.name), each.name)
        for part in dataclasses.fields(options)
        for each in dataclasses.fields(getattr(options, part.name))
    }
    name = f'{group}.{option}'
    if name not in names:
        raise InvalidOption(f'no option {name!r}; there are {", ".join(sorted(names))}')
    default = names[name]
    kind = type(default)
    try:
        value = yaml.safe_load(text)
        if kind is float and not isinstance(value, bool):
            value = float(value)  # YAML has 1e3 as text
        if type(value) is kind:
            return value
    except (yaml.YAMLError, TypeError, ValueError):
        pass
    raise InvalidOption(f'{name} must be of type {kind.__name__}, got {text!r}')
