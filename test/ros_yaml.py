# SPDX-License-Identifier: Apache-2.0
"""Messages from YAML, as ``ros2 topic pub`` reads them (rosidl_runtime_py has no wheel)."""

import array
from importlib import import_module
from pathlib import Path

EXAMPLES = Path(__file__).resolve().parent.parent / 'msg_examples'


def type_of(name):
    """The class of a message, service or action's part, such as std_srvs/srv/Trigger."""
    package, folder, kind = name.split('/')
    kind, _, part = kind.partition('_')
    found = getattr(import_module(f'{package}.{folder}'), kind)
    return getattr(found.Impl, part) if part else found


def filled(message, values):
    """Fill a message with the fields that ``values`` give, and return it."""
    kinds = message.get_fields_and_field_types()
    for name, value in values.items():
        present = getattr(message, name)
        if hasattr(present, 'get_fields_and_field_types'):
            filled(present, value)
        elif isinstance(present, array.array):
            setattr(message, name, array.array(present.typecode, value))
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            kind = type_of(kinds[name][len('sequence<'):-1].replace('/', '/msg/'))
            setattr(message, name, [filled(kind(), each) for each in value])
        else:
            setattr(message, name, type(present)(value))
    return message
