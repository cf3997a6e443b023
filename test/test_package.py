# SPDX-License-Identifier: Apache-2.0
"""package.xml, setup.py, the source's imports and the files agree."""

import ast
import re
import sys
import xml.etree.ElementTree as ElementTree
from functools import cache

import pytest
import setuptools
from commands import ROOT, run_python

NAME = 'ambush_planner'
# Folders whose modules the checkout has, but no installation.
NOT_INSTALLED = ('test', 'benchmarks', 'paper', 'examples')

# Import name -> rosdep key, if they differ.
ROSDEP_KEYS = {
    'PIL': 'python3-matplotlib',
    'hypothesis': 'python3-hypothesis',
    'matplotlib': 'python3-matplotlib',
    'numpy': 'python3-numpy',
    'pytest': 'python3-pytest',
    'networkx': 'python3-networkx',
    'scipy': 'python3-scipy',
    'setuptools': 'python3-setuptools',
    'yaml': 'python3-yaml',
}
# Import name -> name on the package index, if they differ.
REQUIREMENTS = {'PIL': 'matplotlib', 'mcap_ros2': 'mcap-ros2-support', 'pandas': 'geopandas',
                'yaml': 'PyYAML'}
# Import name -> extra, for packages that only pip has.
FROM_PIP = dict.fromkeys(
    ('geopandas', 'gpxpy', 'mgrs', 'pandas', 'pyogrio', 'pyproj', 'rasterio', 'shapely'), 'gis')
FROM_PIP |= dict.fromkeys(('lz4', 'mcap', 'mcap_ros2', 'zstandard'), 'recordings')


@cache
def setup_arguments():
    """Return the arguments of setup() in setup.py."""
    given = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(ROOT)
        patch.setattr(sys, 'argv', ['setup.py'])
        patch.setattr(setuptools, 'setup', lambda **arguments: given.update(arguments))
        exec(compile((ROOT / 'setup.py').read_text(), 'setup.py', 'exec'), {})
    return given


@cache
def manifest():
    """Return the root element of package.xml."""
    return ElementTree.parse(ROOT / 'package.xml').getroot()


def dependencies(*kinds):
    """Return the rosdep keys in package.xml of these kinds."""
    return [element.text for kind in kinds for element in manifest().findall(kind)]


@cache
def imported_packages(folder, walk):
    """Return the top-level names that sources import, without the standard library and ours."""
    ours = {NAME, *NOT_INSTALLED}
    ours |= {path.stem for name in NOT_INSTALLED for path in (ROOT / name).glob('*.py')}
    names = set()
    for path in (ROOT / folder).rglob('*.py'):
        for node in walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                names.update(alias.name.split('.')[0] for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                names.add(node.module.split('.')[0])
    return names - set(sys.stdlib_module_names) - ours


def test_manifest_and_setup_agree():
    arguments = setup_arguments()
    assert manifest().get('format') == '3'
    assert manifest().findtext('export/build_type') == 'ament_python'
    assert '@' in manifest().find('maintainer').get('email')
    assert manifest().findtext('name') == arguments['name'] == NAME
    assert manifest().findtext('version') == arguments['version']
    assert f'\nversion: {arguments["version"]}\n' in (ROOT / 'CITATION.cff').read_text()
    assert manifest().findtext('license') == arguments['license'] == 'Apache-2.0'


@pytest.mark.parametrize(('folder', 'walk', 'kinds'), [
    (NAME, ast.walk, ('exec_depend',)),
    # Imports inside tests follow importorskip.
    ('test', ast.iter_child_nodes, ('exec_depend', 'test_depend')),
])
def test_all_imports_are_declared_once_in_the_manifest(folder, walk, kinds):
    pip = {*FROM_PIP, 'highspy', 'threadpoolctl'}  # no rosdep keys
    names = imported_packages(folder, walk) - pip
    declared = dependencies(*kinds)
    assert {ROSDEP_KEYS.get(name, name) for name in names} <= set(declared)
    assert len(declared) == len(set(declared))


def test_what_is_used_by_name_is_declared_and_bloom_takes_all_keys():
    """Interfaces that may be missing, and the nodes of the launch file; bloom takes no pip key."""
    declared = set(dependencies('exec_depend'))
    sources = '\n'.join(path.read_text() for path in (ROOT / NAME / 'ros').glob('*.py'))
    used = set(re.findall(r"installed_type\('(\w+)\.", sources))
    launch = ElementTree.parse(ROOT / 'launch' / 'ambush_planner.launch.xml').getroot()
    used |= {node.get('pkg') for node in launch.findall('node')} - {NAME}
    assert {'bond', 'nav2_msgs', 'rviz2'} <= used <= declared
    assert not [key for key in declared if '-' in key and not key.startswith('python3-')]


def test_all_imports_are_declared_for_pip():
    arguments = setup_arguments()
    extras = arguments['extras_require']
    required = [*arguments['install_requires'], *extras['figures'], *extras['recordings']]
    names = {re.match(r'[\w-]+', requirement).group() for requirement in required}
    libraries = imported_packages(NAME, ast.walk) & set(ROSDEP_KEYS)
    assert {REQUIREMENTS.get(name, name) for name in libraries} <= names
    assert not [name for name in arguments['install_requires'] if 'ros-' in name or 'rcl' in name]
    for name, extra in FROM_PIP.items():
        wanted = REQUIREMENTS.get(name, name)
        assert any(requirement.startswith(wanted) for requirement in extras[extra])


def test_executables():
    scripts = setup_arguments()['entry_points']['console_scripts']
    targets = dict(re.split(r'\s*=\s*', script) for script in scripts)
    entry = f'{NAME}.commands:main'
    assert targets == {NAME: f'{NAME}.ros.program:main', 'ambush': entry}


def test_all_package_folders_and_data_files_are_installed():
    folders = {path.parent for path in (ROOT / NAME).rglob('*.py')}
    packages = {'.'.join(folder.relative_to(ROOT).parts) for folder in folders}
    assert set(setup_arguments()['packages']) == packages
    targets = dict(setup_arguments()['data_files'])
    assert targets['share/ament_index/resource_index/packages'] == [f'resource/{NAME}']
    assert targets[f'share/{NAME}'] == ['package.xml']
    for folder in ('config', 'launch', 'msg_examples'):
        files = sorted(f'{folder}/{path.name}' for path in (ROOT / folder).iterdir())
        assert files and targets[f'share/{NAME}/{folder}'] == files


def test_a_checkout_without_metadata_can_be_imported(tmp_path):
    (tmp_path / NAME).symlink_to(ROOT / NAME)
    without = (f'import sys; sys.path[:0] = [{str(tmp_path)!r}]; import importlib.metadata as m\n'
               'def version(name): raise m.PackageNotFoundError(name)\n'
               'm.version = version; import ambush_planner as a; print(a.__version__)')
    assert run_python(without).stdout.strip() == 'unknown'


def test_the_node_starts_where_only_rosdep_has_installed(tmp_path):
    """Without the libraries that only pip has, it can be imported; a recording names what lacks."""
    missing = {*FROM_PIP, 'highspy', 'threadpoolctl'}
    done = run_python(f'import sys; sys.modules.update(dict.fromkeys({missing!r}))\n'
                      'from ambush_planner.arrays import single_thread\n'
                      'import ambush_planner.ros.planner_node, ambush_planner.worker.child\n'
                      'from ambush_planner.recordings.recorder import Recorder\n'
                      'with single_thread(): print("ready")\n'
                      f'Recorder({str(tmp_path)!r}).record_departure([], {{}}, {{}})')
    assert done.stdout == 'ready\n', done.stderr
    assert done.stderr.strip().endswith(
        'is not installed; try: pip install mcap-ros2-support, or set recording.enabled to false')
