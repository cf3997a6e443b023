"""A ROS interface built from its definition, as a ROS machine has it installed.

PyPI has no ``nav2_msgs``. But rclpy's wheels bring rosidl's generators, and the headers and
libraries that their code needs: with a C++ compiler that is all there has to be.
"""

import json
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import numpy as np

PREFIX = Path(sys.prefix)
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


def missing():
    """What an interface cannot be built without, '' if all is there."""
    try:
        import rosidl_adapter  # noqa: F401
        import rosidl_generator_py  # noqa: F401
    except ImportError as error:
        return f'no {error.name}'
    if not (SHARE / C / 'resource').is_dir():
        return "rosidl's templates are not below sys.prefix"
    if not all(map(shutil.which, ('gcc', 'g++'))):
        return 'no gcc and g++'
    return '' if Path(sysconfig.get_path('include'), 'Python.h').is_file() else 'no Python.h'


def build_interface(folder, package, name, definition):
    """Build an interface, like 'action/Name.action', and return what ``sys.path`` needs."""
    source = folder / package / name
    source.parent.mkdir(parents=True)
    source.write_text(definition)
    _generate(folder, package, Path(name))
    return _compile(folder, package)


def _generate(folder, package, source):
    from rosidl_adapter import convert_to_idl
    from rosidl_generator_c import generate_c
    from rosidl_generator_py import generate_py
    from rosidl_generator_type_description import generate_type_hash
    from rosidl_typesupport_c import generate_c as generate_dispatch
    from rosidl_typesupport_fastrtps_c import generate_typesupport_fastrtps_c
    from rosidl_typesupport_introspection_c import generate_c as generate_introspection

    idl = str(source.with_suffix('.idl'))

    def arguments(generator, **more):
        file = folder / f'{generator}.json'
        file.write_text(json.dumps({
            'package_name': package,
            'output_dir': str(folder / generator / package),
            'template_dir': str(SHARE / generator / 'resource'),
            'idl_tuples': [f'{folder / "idl"}:{idl}'],
            'ros_interface_dependencies': [],
            'target_dependencies': [],
            **more,
        }))
        return str(file)

    convert_to_idl(folder / package, package, source, folder / 'idl')
    installed = {each.parents[1] for each in SHARE.glob('*/[ms][sr][gv]/*.json')}
    hashes = generate_type_hash(arguments(
        'rosidl_generator_type_description',
        include_paths=[f'{each.name}:{each}' for each in sorted(installed)]))
    generate_c(arguments(C, type_description_tuples=[f'{idl}:{hashes[0]}']))
    generate_typesupport_fastrtps_c(arguments(FAST_DDS))
    generate_introspection(arguments(INTROSPECTION))
    generate_dispatch(arguments(DISPATCH), [FAST_DDS, INTROSPECTION])
    generate_py(arguments(PYTHON), [DISPATCH])
    for generator in (C, FAST_DDS, INTROSPECTION):
        template = SHARE / generator / 'resource' / f'{generator}__visibility_control.h.in'
        header = folder / generator / package / 'msg' / template.stem
        header.parent.mkdir(parents=True)
        header.write_text(template.read_text().replace('@PROJECT_NAME@', package).replace(
            '@PROJECT_NAME_UPPER@', package.upper()))


def _compile(folder, package):
    installed, lib = folder / PYTHON / package, PREFIX / 'lib'
    include = [PREFIX / 'include', *(PREFIX / 'include').iterdir(), *folder.glob('rosidl_*/'),
               sysconfig.get_path('include'), np.get_include()]
    objects = {False: [], True: []}
    for source in sorted(folder.glob('rosidl_*/**/*.c*')):
        target = source.with_name(f'{source.name}.o')
        _run(['g++' if source.suffix == '.cpp' else 'gcc', '-O0', '-w', '-fPIC', '-c', source,
              '-o', target, *(f'-I{each}' for each in include)])
        objects[PYTHON in source.parts].append(target)
    link = ['g++', '-shared', f'-L{lib}', f'-Wl,-rpath,{lib}', '-Wl,-rpath,$ORIGIN']
    needs = [f'-l:{each.name}' for pattern in (
        *(f'lib*__{part}.so' for part in (C, PYTHON, DISPATCH, FAST_DDS, INTROSPECTION)),
        'librosidl_*.so', 'libfastcdr.so', 'librcutils.so') for each in lib.glob(pattern)]
    names = [f'lib{package}__{part}.so' for part in (FAST_DDS, INTROSPECTION)]
    whole, other = (installed / name for name in names)
    _run([*link, f'-Wl,-soname,{whole.name}', '-o', whole, *objects[False], *needs])
    _run([*link, f'-Wl,-soname,{other.name}', '-o', other, '-Wl,--no-as-needed', whole])
    _run([*link, '-o', installed / f'{package}_s__{DISPATCH}.so', *objects[True], whole, *needs])
    (installed / '__init__.py').write_text(LOADER.format(names=names))
    return installed.parent


def _run(command):
    done = subprocess.run(
        [str(each) for each in command], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
