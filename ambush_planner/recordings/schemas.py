# SPDX-License-Identifier: Apache-2.0
"""Message definitions as an MCAP file carries them, from the installed interface files."""

from __future__ import annotations

import json
import sys
from functools import cache
from importlib import resources
from pathlib import Path
from typing import NamedTuple

from .recording_errors import RecordingFailed

_SEPARATOR = '=' * 80


class MessageDefinition(NamedTuple):
    """A message type, described so that a reader without ROS can decode it.

    ``text`` is the type's definition and those of all types it uses, as ``ros2msg``;
    ``type_hash`` is the REP 2011 hash, ``RIHS01_...``.
    """

    text: str
    type_hash: str


@cache
def _shipped() -> dict[str, MessageDefinition]:
    """The definitions that come with this package, for recordings made without ROS."""
    text = resources.files(__package__).joinpath('definitions.json').read_text('utf-8')
    return {name: MessageDefinition(**fields) for name, fields in json.loads(text).items()}


@cache
def load_definition(name: str) -> MessageDefinition:
    """Read the definition of a type from the installed packages; raises RecordingFailed."""
    if name in _shipped():
        return _shipped()[name]
    described = json.loads(_read_interface(name, 'json'))
    hashes = {entry['type_name']: entry['hash_string'] for entry in described['type_hashes']}
    parts = [_read_interface(name, 'msg')]
    for other in _types_used(name, described['type_description_msg']):
        text = _read_interface(other, 'msg')
        parts.append(f'{_SEPARATOR}\nMSG: {other.replace("/msg/", "/")}\n{text}')
    return MessageDefinition('\n'.join(parts), hashes[name])


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
