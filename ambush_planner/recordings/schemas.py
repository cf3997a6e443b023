"""Message definitions as an MCAP file carries them, from the installed interface files.

Messages are described by their .msg texts. The events of a service (``std_srvs/srv/Trigger_Event``)
have no text of their own. rosbag2 (Jazzy) stores the service's .srv text for them, which no reader
can decode (ros2/rosbag2 issue 2365); here they get the IDL from which the event's type follows.
rosbag2 itself plays events by the installed type and does not read the definition.
"""

from __future__ import annotations

import json
import sys
from functools import cache
from pathlib import Path
from typing import NamedTuple

from .recording_errors import RecordingFailed

_SEPARATOR = '=' * 80
_EVENT = '_Event'


class MessageDefinition(NamedTuple):
    """A message type, described so that a reader without ROS can decode it.

    ``encoding`` is ``ros2msg`` or ``ros2idl``, ``text`` the type's definition and those of all
    types it uses, ``type_hash`` the REP 2011 hash, ``RIHS01_...``.
    """

    encoding: str
    text: str
    type_hash: str


@cache
def load_definition(name: str) -> MessageDefinition:
    """Read the definition of a type from the installed packages; raises RecordingFailed."""
    event = '/srv/' in name and name.endswith(_EVENT)
    described = json.loads(_read_interface(name.removesuffix(_EVENT) if event else name, 'json'))
    hashes = {entry['type_name']: entry['hash_string'] for entry in described['type_hashes']}
    used = _types_used(name, described['type_description_msg'])
    if event:
        return MessageDefinition('ros2idl', _event_idl(name, used), hashes[name])
    parts = [_read_interface(name, 'msg')]
    for other in used:
        text = _read_interface(other, 'msg')
        parts.append(f'{_SEPARATOR}\nMSG: {other.replace("/msg/", "/")}\n{text}')
    return MessageDefinition('ros2msg', '\n'.join(parts), hashes[name])


def _types_used(name: str, description: dict) -> list[str]:
    """Return the types that a type is made of, each once."""
    fields = {
        entry['type_name']: entry['fields']
        for entry in (description['type_description'], *description['referenced_type_descriptions'])
    }
    found = [name]
    for each in found:  # grows meanwhile
        nested = (field['type']['nested_type_name'] for field in fields[each])
        found += [type_ for type_ in dict.fromkeys(nested) if type_ and type_ not in found]
    return found[1:]


def _event_idl(name: str, used: list[str]) -> str:
    """Return the event's struct (REP 2012), its service's file, and those of all other types."""
    service = name.removesuffix(_EVENT)
    package, kind, short_name = service.split('/')
    scoped = f'{package}::{kind}::{short_name}'
    event = (f'module {package} {{\n  module {kind} {{\n    struct {short_name}{_EVENT} {{\n'
             '      service_msgs::msg::ServiceEventInfo info;\n'
             f'      sequence<{scoped}_Request, 1> request;\n'
             f'      sequence<{scoped}_Response, 1> response;\n'
             '    };\n  };\n};\n')
    parts = {name: event}
    for type_ in (service, *used):
        if not type_.startswith(f'{service}_'):
            lines = _read_interface(type_, 'idl').splitlines(True)
            # Included types follow in this text, and parsers without a file system refuse includes.
            parts[type_] = ''.join(line for line in lines if not line.startswith('#include'))
    return '\n'.join(f'{_SEPARATOR}\nIDL: {type_}\n{text}' for type_, text in parts.items())


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
