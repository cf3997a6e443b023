"""YAML as ``ros2 topic pub`` and ``ros2 service call`` read it (rosidl_runtime_py has no wheel)."""

import array
import re
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

import yaml
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

EXAMPLES = Path(__file__).resolve().parent.parent / 'msg_examples'


@dataclass(frozen=True)
class Command:
    """A command line: ``ros2 topic pub`` or ``ros2 service call``."""

    verb: str
    flags: tuple[str, ...]
    name: str
    type_name: str
    file: str

    @property
    def type(self):
        """The class of the message or service."""
        package, folder, name = self.type_name.split('/')
        return getattr(import_module(f'{package}.{folder}'), name)

    @property
    def qos(self):
        """The QoS that ``ros2 topic pub`` uses with these flags."""
        given = dict(zip(self.flags, self.flags[1:], strict=False))
        return QoSProfile(
            depth=1,
            reliability=ReliabilityPolicy[given.get('--qos-reliability', 'reliable').upper()],
            durability=DurabilityPolicy[given.get('--qos-durability', 'volatile').upper()],
        )


def command_of(path):
    """Return the command line in the comment at the top of an example."""
    (line,) = re.findall(r'^# ros2 (.*)$', path.read_text(), flags=re.MULTILINE)
    *words, name, type_name, stdin, less, file = line.split()
    assert (stdin, less) == ('--stdin', '<')
    return Command(' '.join(words[:2]), tuple(words[2:]), name, type_name, file)


def example(path):
    """Return what an example's command line sends: a message, or a request."""
    kind = command_of(path).type
    return message_from_yaml(getattr(kind, 'Request', kind), path)


def message_from_yaml(kind, path):
    """Return a message of the class ``kind`` with the fields that the file gives."""
    return filled(kind(), yaml.safe_load(path.read_text()))


def _kind_of(message, name):
    """The class of the messages in a field that is a sequence of them."""
    package, kind = message.get_fields_and_field_types()[name][len('sequence<'):-1].split('/')
    return getattr(import_module(f'{package}.msg'), kind)


def filled(message, values):
    """Fill a message with the fields that ``values`` give, and return it."""
    for name, value in values.items():
        present = getattr(message, name)
        if hasattr(present, 'get_fields_and_field_types'):
            filled(present, value)
        elif isinstance(present, array.array):
            setattr(message, name, array.array(present.typecode, value))
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            setattr(message, name, [filled(_kind_of(message, name)(), each) for each in value])
        else:
            setattr(message, name, type(present)(value))
    return message
