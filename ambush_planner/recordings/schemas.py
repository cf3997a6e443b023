"""Message definitions as an MCAP file carries them, from the installed interface files.

Messages are described by their .msg texts. The events of a service (``std_srvs/srv/Trigger_Event``)
have no text of their own. rosbag2 (Jazzy) stores the service's .srv text for them, which no reader
can decode (ros2/rosbag2 issue 2365); here they get the IDL from which the event's type follows.
rosbag2 itself plays events by the installed type and does not read the definition.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from .recording_errors import RecordingFailed

_SEPARATOR = '=' * 80
_EVENT = '_Event'


@dataclass(frozen=True)
class MessageDefinition:
    """One message type, described so that a reader without ROS can decode it.

    ``name`` is like ``nav_msgs/msg/Path``, ``encoding`` that of the text (``ros2msg`` or
    ``ros2idl``), ``text`` its definition, followed by those of all types that it uses, and
    ``type_hash`` the REP 2011 hash, ``RIHS01_...``.
    """

    name: str
    encoding: str
    text: str
    type_hash: str


@cache
def load_definition(name: str) -> MessageDefinition:
    """Read the definition of the message type ``name`` from the installed packages.

    Dependencies follow the type itself depth first, each once, as rosbag2 orders them.

    Raises
    ------
    RecordingFailed
        The interface files of the type are not installed.
    """
    event = '/srv/' in name and name.endswith(_EVENT)
    described = json.loads(_read_interface(name.removesuffix(_EVENT) if event else name, 'json'))
    hashes = {entry['type_name']: entry['hash_string'] for entry in described['type_hashes']}
    dependencies = _dependencies(name, described['type_description_msg'])
    text = _event_idl(name, dependencies) if event else _message_text(name, dependencies)
    return MessageDefinition(name, 'ros2idl' if event else 'ros2msg', text, hashes[name])


def _message_text(name: str, dependencies: list[str]) -> str:
    parts = [_read_interface(name, 'msg')]
    for dependency in dependencies:
        package, _, short_name = dependency.split('/')
        text = _read_interface(dependency, 'msg')
        parts.append(f'{_SEPARATOR}\nMSG: {package}/{short_name}\n{text}')
    return '\n'.join(parts)


def _event_idl(name: str, dependencies: list[str]) -> str:
    """The event's struct (REP 2012), then the file with its request and response, and the rest."""
    service = name.removesuffix(_EVENT)
    package, kind, short_name = service.split('/')
    scoped = f'{package}::{kind}::{short_name}'
    event = (
        f'module {package} {{\n  module {kind} {{\n    struct {short_name}{_EVENT} {{\n'
        '      service_msgs::msg::ServiceEventInfo info;\n'
        f'      sequence<{scoped}_Request, 1> request;\n'
        f'      sequence<{scoped}_Response, 1> response;\n'
        '    };\n  };\n};\n'
    )
    used = [type_ for type_ in dependencies if not type_.startswith(f'{service}_')]
    texts = {type_: _without_includes(_read_interface(type_, 'idl')) for type_ in (service, *used)}
    parts = {name: event, **texts}
    return '\n'.join(f'{_SEPARATOR}\nIDL: {type_}\n{text}' for type_, text in parts.items())


def _without_includes(idl: str) -> str:
    """What is included stands in the same text, and parsers without a file system refuse it."""
    return ''.join(line for line in idl.splitlines(True) if not line.startswith('#include'))


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
    # Reading recordings needs neither ROS nor this module's definitions.
    from ament_index_python.packages import get_package_share_directory

    try:
        return Path(get_package_share_directory(package))
    except (LookupError, OSError):
        # ROS from Python wheels: share/ lies in the environment, outside the ament index.
        return Path(sys.prefix, 'share', package)
