"""Message definitions as an MCAP file carries them, from the installed interface files."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory

from .errors import RecordingFailed

_SEPARATOR = '=' * 80


@dataclass(frozen=True)
class MessageDefinition:
    """One message type, described so that a reader without ROS can decode it.

    Attributes:
        name: For example ``nav_msgs/msg/Path``.
        text: The .msg text, followed by those of all types that it uses (``ros2msg``).
        type_hash: The REP 2011 hash, ``RIHS01_...``.
    """

    name: str
    text: str
    type_hash: str


def type_name(message: Any) -> str:
    """Return the ROS name of the type of a message instance, like ``nav_msgs/msg/Path``."""
    package, kind = type(message).__module__.split('.')[:2]
    return f'{package}/{kind}/{type(message).__name__}'


@cache
def load_definition(name: str) -> MessageDefinition:
    """Read the definition of the message type ``name`` from the installed packages.

    Dependencies follow the type itself depth first, each once, as rosbag2 orders them.

    Raises:
        RecordingFailed: The interface files of the type are not installed.
    """
    description = json.loads(_read_interface(name, 'json'))
    hashes = {entry['type_name']: entry['hash_string'] for entry in description['type_hashes']}
    parts = [_read_interface(name, 'msg')]
    for dependency in _dependencies(name, description['type_description_msg']):
        package, kind, short_name = dependency.split('/')
        text = _read_interface(dependency, 'msg')
        parts.append(f'{_SEPARATOR}\nMSG: {package}/{short_name}\n{text}')
    return MessageDefinition(name, '\n'.join(parts), hashes[name])


def _dependencies(name: str, description: Mapping[str, Any]) -> list[str]:
    described = {
        entry['type_name']: entry['fields']
        for entry in (description['type_description'], *description['referenced_type_descriptions'])
    }
    found: list[str] = []

    def visit(type_: str) -> None:
        for field in described[type_]:
            nested = field['type']['nested_type_name']
            if nested and nested not in found:
                found.append(nested)
                visit(nested)

    visit(name)
    return found


def _read_interface(name: str, extension: str) -> str:
    package, kind, short_name = name.split('/')
    path = _share_folder(package) / kind / f'{short_name}.{extension}'
    try:
        return path.read_text(encoding='utf-8')
    except OSError as error:
        raise RecordingFailed(
            path,
            f'the definition of {name} is not readable ({error.strerror}); '
            f'install the package {package} or source the workspace that has it',
        ) from error


def _share_folder(package: str) -> Path:
    try:
        return Path(get_package_share_directory(package))
    except (LookupError, OSError):
        # ROS from Python wheels: share/ lies in the environment, outside the ament index.
        return Path(sys.prefix, 'share', package)
