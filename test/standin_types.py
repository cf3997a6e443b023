"""Message types that PyPI does not have: enough of them to travel over DDS as bytes.

``tf2_msgs`` and ``map_msgs`` come with ROS only. The middleware needs a type's name and functions
that (de)serialise it; raw subscriptions and publishers never call the latter. So a stand-in is the
type support of another message under the real name, and real tools see real topics.
"""

import ctypes
from importlib import import_module

import numpy as np
from nav_msgs.msg import Path
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

_GRID_UPDATE = """
std_msgs/Header header
int32 x
int32 y
uint32 width
uint32 height
int8[] data
"""
STORE = get_typestore(Stores.ROS2_JAZZY)
if 'map_msgs/msg/OccupancyGridUpdate' not in STORE.types:
    STORE.register(get_types_from_msg(_GRID_UPDATE, 'map_msgs/msg/OccupancyGridUpdate'))

_C = ctypes.pythonapi
_C.PyCapsule_GetName.restype = ctypes.c_char_p
_C.PyCapsule_GetName.argtypes = [ctypes.py_object]
_C.PyCapsule_GetPointer.restype = ctypes.c_void_p
_C.PyCapsule_GetPointer.argtypes = [ctypes.py_object, ctypes.c_char_p]
_C.PyCapsule_New.restype = ctypes.py_object
_C.PyCapsule_New.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p]
_FIND = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_char_p)
_KEPT = []  # what C points to
_FAST_DDS = b'rosidl_typesupport_fastrtps_c'


class _Support(ctypes.Structure):
    """rosidl_message_type_support_t (rosidl_runtime_c/message_type_support_struct.h)."""

    _fields_ = [
        ('identifier', ctypes.c_char_p), ('data', ctypes.c_void_p), ('func', ctypes.c_void_p),
        ('hash', ctypes.c_void_p), ('description', ctypes.c_void_p), ('sources', ctypes.c_void_p),
    ]


class _Callbacks(ctypes.Structure):
    """message_type_support_callbacks_t (rosidl_typesupport_fastrtps_cpp): namespace, name, more."""

    _fields_ = [
        ('namespace', ctypes.c_char_p), ('name', ctypes.c_char_p), ('rest', ctypes.c_void_p * 5),
    ]


def message_type(package, name):
    """The type as it is installed, or a stand-in."""
    try:
        return getattr(import_module(f'{package}.msg'), name)
    except ImportError:
        return standin(package, name)


def encode(type_name, **fields):
    """Serialise a message by an independent library."""
    return bytes(STORE.serialize_cdr(STORE.types[type_name](**fields), type_name))


def grid_update(frame, x, y, values, stamp=(1, 0)):
    """A serialised map_msgs/OccupancyGridUpdate."""
    values = np.asarray(values, dtype=np.int8)
    return encode(
        'map_msgs/msg/OccupancyGridUpdate', header=_header(frame, stamp), x=x, y=y,
        width=values.shape[1], height=values.shape[0], data=values.ravel())


def tf_message(*transforms):
    """A serialised tf2_msgs/TFMessage of geometry_msgs/TransformStamped."""
    types = STORE.types
    vector = types['geometry_msgs/msg/Vector3']
    quaternion = types['geometry_msgs/msg/Quaternion']
    stamped = [
        types['geometry_msgs/msg/TransformStamped'](
            header=_header(
                each.header.frame_id, (each.header.stamp.sec, each.header.stamp.nanosec)),
            child_frame_id=each.child_frame_id,
            transform=types['geometry_msgs/msg/Transform'](
                translation=vector(*_numbers(each.transform.translation, 'xyz')),
                rotation=quaternion(*_numbers(each.transform.rotation, 'xyzw')),
            ),
        )
        for each in transforms
    ]
    return encode('tf2_msgs/msg/TFMessage', transforms=stamped)


def _numbers(message, names):
    return [getattr(message, name) for name in names]


def _header(frame, stamp):
    types = STORE.types
    time = types['builtin_interfaces/msg/Time'](sec=stamp[0], nanosec=stamp[1])
    return types['std_msgs/msg/Header'](stamp=time, frame_id=frame)


def standin(package, name):
    """A type of this name that raw publishers and subscriptions take."""
    Path.__class__.__import_type_support__()
    capsule = Path.__class__._TYPE_SUPPORT
    label = _C.PyCapsule_GetName(capsule)
    base = ctypes.cast(
        _C.PyCapsule_GetPointer(capsule, label), ctypes.POINTER(_Support)).contents
    find, fast_dds = _FIND(base.func), {}
    found = find(ctypes.addressof(base), _FAST_DDS)
    fast_dds[_FAST_DDS] = _renamed(found, package, name)

    def mine(_, identifier):
        found = fast_dds.get(identifier)
        return ctypes.addressof(found) if found else find(ctypes.addressof(base), identifier)

    whole = _Support.from_buffer_copy(base)
    function = _FIND(mine)
    whole.func = ctypes.cast(function, ctypes.c_void_p)
    _KEPT.extend((whole, function, label))

    class Meta(type):
        _CREATE_ROS_MESSAGE = _CONVERT_FROM_PY = _CONVERT_TO_PY = _DESTROY_ROS_MESSAGE = True
        _TYPE_SUPPORT = _C.PyCapsule_New(ctypes.addressof(whole), label, None)

    return Meta(name, (), {'__module__': f'{package}.msg._standin'})


def _renamed(found, package, name):
    """What Fast DDS takes of a type support, under another name."""
    support = _Support.from_buffer_copy(
        ctypes.cast(found, ctypes.POINTER(_Support)).contents)
    callbacks = _Callbacks.from_buffer_copy(
        ctypes.cast(support.data, ctypes.POINTER(_Callbacks)).contents)
    callbacks.namespace = callbacks.namespace.replace(b'nav_msgs', package.encode())
    callbacks.name = name.encode()
    support.data = ctypes.addressof(callbacks)
    _KEPT.append(callbacks)
    return support
