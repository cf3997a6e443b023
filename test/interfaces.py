# SPDX-License-Identifier: Apache-2.0
"""ROS interfaces that PyPI lacks, built from their definitions and installed below ``sys.prefix``.

rclpy's wheels bring rosidl's generators with the headers and libraries that their code needs; only
a C++ compiler has to be there. Each interface is built once for a virtual environment.
"""

import fcntl
import json
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from importlib import import_module, invalidate_caches
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

# As Jazzy and Nav2 for Jazzy define them; comments there make no difference.
DEFINITIONS = {
    'map_msgs': {'msg/OccupancyGridUpdate.msg': """
std_msgs/Header header
int32 x
int32 y
uint32 width
uint32 height
int8[] data
"""},
    'tf2_msgs': {'msg/TFMessage.msg': 'geometry_msgs/TransformStamped[] transforms\n'},
    'bond': {'msg/Status.msg': """
std_msgs/Header header
string id
string instance_id
bool active
float32 heartbeat_timeout
float32 heartbeat_period
"""},
    'nav2_msgs': {'srv/IsPathValid.srv': """
nav_msgs/Path path
---
bool is_valid
int32[] invalid_pose_indices
"""} | {f'action/{name}.action': f"""
{goal}
geometry_msgs/PoseStamped start
string planner_id
bool use_start
---
uint16 NONE=0
uint16 UNKNOWN={first}00
uint16 INVALID_PLANNER={first}01
uint16 TF_ERROR={first}02
uint16 START_OUTSIDE_MAP={first}03
uint16 GOAL_OUTSIDE_MAP={first}04
uint16 START_OCCUPIED={first}05
uint16 GOAL_OCCUPIED={first}06
uint16 TIMEOUT={first}07
uint16 NO_VALID_PATH={first}08
{more}
nav_msgs/Path path
builtin_interfaces/Duration planning_time
uint16 error_code
string error_msg
---
""" for name, goal, first, more in (
        ('ComputePathToPose', 'geometry_msgs/PoseStamped goal', 2, ''),
        ('ComputePathThroughPoses', 'geometry_msgs/PoseStamped[] goals', 3,
         'uint16 NO_VIAPOINTS_GIVEN=309'),
    )},
}
PREFIX = Path(sys.prefix)
BUILT = PREFIX / 'built_interfaces_3'  # a new name for each change of the definitions
SHARE = PREFIX / 'share'
C, PYTHON = 'rosidl_generator_c', 'rosidl_generator_py'
DISPATCH, FAST_DDS, INTROSPECTION = (
    f'rosidl_typesupport_{kind}' for kind in ('c', 'fastrtps_c', 'introspection_c'))
# The dispatching type support looks for these by name, and finds what is loaded already.
LOADER = """
import ctypes
from pathlib import Path

for name in {names}:
    ctypes.CDLL(str(Path(__file__).with_name(name)))
"""


def install(package):
    """Make an interface's package importable in this process, or skip the test."""
    if find_spec(package):
        return
    if why := _missing():
        pytest.skip(why, allow_module_level=True)
    folder = BUILT / package
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / 'lock').open('w') as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / package).exists():
            with tempfile.TemporaryDirectory() as scratch:
                built = _build(Path(scratch), package, DEFINITIONS[package])
                shutil.copytree(built / package, folder / package)
    sys.path.append(str(folder))
    invalidate_caches()


def uninstall(package):
    """Undo ``install`` for the tests that follow in this process."""
    sys.path[:] = [path for path in sys.path if path != str(BUILT / package)]
    for name in [name for name in sys.modules if name.split('.')[0] == package]:
        del sys.modules[name]


def _missing():
    """Name the part without which an interface cannot be built, '' if all is there."""
    if not all(map(find_spec, ('rosidl_adapter', C, PYTHON, DISPATCH))):
        return 'no rosidl generators'
    if not all(map(shutil.which, ('gcc', 'g++'))):
        return 'no gcc and g++'
    return '' if Path(sysconfig.get_path('include'), 'Python.h').is_file() else 'no Python.h'


def _build(folder, package, definitions):
    """Build the interfaces of a package and return the folder of the package."""
    for name, definition in definitions.items():
        source = folder / package / name
        source.parent.mkdir(parents=True, exist_ok=True)
        source.write_text(definition)
    _generate(folder, package, [Path(name) for name in definitions])
    return _compile(folder, package)


def _generate(folder, package, sources):
    idls = [str(source.with_suffix('.idl')) for source in sources]

    def arguments(generator, **more):
        file = folder / f'{generator}.json'
        file.write_text(json.dumps({
            'package_name': package,
            'output_dir': str(folder / generator / package),
            'template_dir': str(SHARE / generator / 'resource'),
            'idl_tuples': [f'{folder / "idl"}:{idl}' for idl in idls],
            'ros_interface_dependencies': [],
            'target_dependencies': [],
            **more,
        }))
        return str(file)

    for source in sources:
        import_module('rosidl_adapter').convert_to_idl(
            folder / package, package, source, folder / 'idl')
    installed = {each.parents[1] for each in SHARE.glob('*/[ms][sr][gv]/*.json')}
    hasher = 'rosidl_generator_type_description'
    hashes = import_module(hasher).generate_type_hash(arguments(
        hasher, include_paths=[f'{each.name}:{each}' for each in sorted(installed)]))
    import_module(C).generate_c(arguments(C, type_description_tuples=[
        f'{idl}:{each}' for idl in idls for each in hashes if Path(each).stem == Path(idl).stem]))
    import_module(FAST_DDS).generate_typesupport_fastrtps_c(arguments(FAST_DDS))
    import_module(INTROSPECTION).generate_c(arguments(INTROSPECTION))
    import_module(DISPATCH).generate_c(arguments(DISPATCH), [FAST_DDS, INTROSPECTION])
    import_module(PYTHON).generate_py(arguments(PYTHON), [DISPATCH])
    for generator in (C, FAST_DDS, INTROSPECTION):
        template = SHARE / generator / 'resource' / f'{generator}__visibility_control.h.in'
        header = folder / generator / package / 'msg' / template.stem
        header.parent.mkdir(parents=True, exist_ok=True)
        header.write_text(template.read_text().replace('@PROJECT_NAME@', package).replace(
            '@PROJECT_NAME_UPPER@', package.upper()))


def _compile(folder, package):
    installed, lib = folder / PYTHON / package, PREFIX / 'lib'
    include = [PREFIX / 'include', *(PREFIX / 'include').iterdir(), *folder.glob('rosidl_*/'),
               sysconfig.get_path('include'), np.get_include()]
    link = ['gcc', '-shared', '-O0', '-w', '-fPIC', *(f'-I{each}' for each in include),
            f'-L{lib}', f'-Wl,-rpath,{lib}', '-Wl,-rpath,$ORIGIN']
    needs = [f'-l:{each.name}' for pattern in (
        *(f'lib*__{part}.so' for part in (C, PYTHON, DISPATCH, FAST_DDS, INTROSPECTION)),
        'librosidl_*.so', 'libfastcdr.so', 'librcutils.so') for each in lib.glob(pattern)]
    sources = sorted(folder.glob('rosidl_*/**/*.c*'))
    bindings = [source for source in sources if PYTHON in source.parts]
    names = [f'lib{package}__{part}.so' for part in (FAST_DDS, INTROSPECTION)]
    whole, other = (installed / name for name in names)
    _run([*link, f'-Wl,-soname,{whole.name}', '-o', whole, *sorted({*sources} - {*bindings}),
          *needs, '-lstdc++'])
    _run([*link, f'-Wl,-soname,{other.name}', '-o', other, '-Wl,--no-as-needed', whole])
    _run([*link, '-o', installed / f'{package}_s__{DISPATCH}.so', *bindings, whole, *needs])
    (installed / '__init__.py').write_text(LOADER.format(names=names))
    return installed.parent


def _run(command):
    done = subprocess.run([*map(str, command)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
