"""YAML as ``ros2 topic pub`` and ``ros2 service call`` read it (rosidl_runtime_py has no wheel)."""

import array
import re
from pathlib import Path

import yaml

EXAMPLES = Path(__file__).resolve().parent.parent / 'msg_examples'


def message_from_yaml(kind, path):
    """Return a message of the class ``kind`` with the fields that the file gives."""
    return _filled(kind(), yaml.safe_load(path.read_text()))


def command_of(path):
    """Return the words of the command line in the comment at the top of an example."""
    (command,) = re.findall(r'^# (ros2 .*)$', path.read_text(), flags=re.MULTILINE)
    return command.split()


def _filled(message, values):
    for name, value in values.items():
        present = getattr(message, name)
        if hasattr(present, 'get_fields_and_field_types'):
            _filled(present, value)
        elif isinstance(present, array.array):
            setattr(message, name, array.array(present.typecode, value))
        else:
            setattr(message, name, type(present)(value))
    return message
