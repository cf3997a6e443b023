"""The package's own papers agree: package.xml, setup.py, the source's imports, the files."""

import ast
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
import zipfile
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import pytest
import setuptools

from ambush_planner.commands.cli import COMMANDS

ROOT = Path(__file__).resolve().parent.parent
NAME = 'ambush_planner'

# Import name -> rosdep key, where the two differ.
ROSDEP_KEYS = {
    'PIL': 'python3-matplotlib',
    'argcomplete': 'python3-argcomplete',
    'hypothesis': 'python3-hypothesis',
    'matplotlib': 'python3-matplotlib',
    'lz4': 'mcap-ros2-support',
    'mcap': 'mcap-ros2-support',
    'mcap_ros2': 'mcap-ros2-support',
    'networkx': 'python3-networkx',
    'numpy': 'python3-numpy',
    'pytest': 'python3-pytest',
    'rosbags': 'python3-rosbags-pip',
    'scipy': 'python3-scipy',
    'setuptools': 'python3-setuptools',
    'yaml': 'python3-yaml',
    'zstandard': 'mcap-ros2-support',
}
# Import name -> name on the package index, where the two differ.
REQUIREMENTS = {'PIL': 'matplotlib', 'mcap_ros2': 'mcap-ros2-support', 'yaml': 'PyYAML'}

# Import name -> extra. Without a rosdep key: a machine that needs them gets them from pip.
FROM_PIP = {'distributed': 'dask', 'rasterio': 'terrain'}


@cache
def setup_arguments(*argv):
    """What setup.py hands to setuptools when it is called with argv."""
    given = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(ROOT)
        patch.setattr(sys, 'argv', ['setup.py', *argv])
        patch.setattr(setuptools, 'setup', lambda **arguments: given.update(arguments))
        exec(compile((ROOT / 'setup.py').read_text(), 'setup.py', 'exec'), {})
    return given


@cache
def manifest():
    """The root element of package.xml."""
    return ElementTree.parse(ROOT / 'package.xml').getroot()


def dependencies(kind):
    """The keys that package.xml declares with the tag `kind`."""
    return [element.text for element in manifest().findall(kind)]


def imported_packages(folder=NAME, walk=ast.walk):
    """Top-level names that sources import, the standard library's and our own left out."""
    names, ours = set(), {path.stem for name in ('test', 'benchmarks')
                          for path in (ROOT / name).glob('*.py')}
    for path in (ROOT / folder).rglob('*.py'):
        for node in walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                names.update(alias.name.split('.')[0] for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                names.add(node.module.split('.')[0])
    return names - set(sys.stdlib_module_names) - {NAME} - ours


def files_by_target(*argv):
    return {target: [Path(file) for file in files]
            for target, files in setup_arguments(*argv)['data_files']}


def tracked_files():
    listing = subprocess.run(
        ['git', 'ls-files', '-z', '--cached', '--others', '--exclude-standard'],
        cwd=ROOT, capture_output=True, check=False)
    if listing.returncode or not (ROOT / '.git').exists():
        pytest.skip('not a git checkout: nothing says which files belong to the project')
    paths = (ROOT / name.decode() for name in listing.stdout.split(b'\0') if name)
    return [path for path in paths if path.is_file()]


def test_manifest_is_of_format_3_for_ament_python():
    assert manifest().tag == 'package'
    assert manifest().get('format') == '3'
    assert manifest().findtext('export/build_type') == 'ament_python'
    assert '@' in manifest().find('maintainer').get('email')


def test_manifest_and_setup_agree():
    arguments = setup_arguments()
    assert manifest().findtext('name') == arguments['name'] == NAME
    assert manifest().findtext('version') == arguments['version']
    assert manifest().findtext('license') == arguments['license'] == 'Apache-2.0'
    assert re.fullmatch(r'\d+\.\d+\.\d+', arguments['version'])


def test_no_dependency_is_declared_twice():
    for kind in ('exec_depend', 'test_depend'):
        keys = dependencies(kind)
        assert len(keys) == len(set(keys))


def test_every_import_is_declared_in_the_manifest():
    names = imported_packages() - set(FROM_PIP)
    keys = {ROSDEP_KEYS.get(name, name) for name in names}
    assert keys <= set(dependencies('exec_depend'))


def test_every_import_of_the_tests_is_declared_in_the_manifest():
    """What is not is asked for by importorskip, or imported where it is known to be there."""
    names = imported_packages('test', ast.iter_child_nodes)
    keys = {ROSDEP_KEYS.get(name, name) for name in names}
    assert keys <= set(dependencies('exec_depend') + dependencies('test_depend'))


def test_pip_install_leaves_nothing_in_the_checkout(tmp_path):
    copy, wheels = tmp_path / 'checkout', tmp_path / 'wheels'
    for path in tracked_files():
        target = copy / path.relative_to(ROOT)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, target)
    if not (find_spec('wheel') or find_spec('setuptools.command.bdist_wheel')):
        pytest.skip('this setuptools makes wheels only with the package wheel')
    before = sorted(copy.rglob('*'))
    built = subprocess.run(
        [sys.executable, '-m', 'pip', 'wheel', '--no-deps', '--no-build-isolation', '--no-index',
         '-w', str(wheels), str(copy)],
        capture_output=True, text=True, timeout=120, check=False)
    assert built.returncode == 0, built.stdout + built.stderr
    assert sorted(copy.rglob('*')) == before
    (wheel,) = wheels.iterdir()
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    for package in setup_arguments()['packages']:
        assert f'{package.replace(".", "/")}/__init__.py' in names
    assert any(name.endswith(f'/lib/{NAME}/ambush') for name in names)


def test_every_library_import_is_declared_for_pip():
    arguments = setup_arguments()
    required = arguments['install_requires'] + arguments['extras_require']['figures']
    names = {re.match(r'[\w-]+', requirement).group() for requirement in required}
    libraries = imported_packages() & set(ROSDEP_KEYS) - {'argcomplete'}  # optional
    assert {REQUIREMENTS.get(name, name) for name in libraries} <= names


def test_what_pip_alone_has_is_an_extra():
    assert set(FROM_PIP) <= imported_packages()
    extras = setup_arguments()['extras_require']
    for name, extra in FROM_PIP.items():
        assert any(requirement.startswith(name) for requirement in extras[extra])


def test_ros_is_an_extra_and_no_requirement():
    arguments = setup_arguments()
    assert not [name for name in arguments['install_requires'] if 'ros-' in name or 'rcl' in name]
    assert all(name.startswith('ros-jazzy-') for name in arguments['extras_require']['jazzy'])
    assert any(name.startswith('pytest') for name in arguments['extras_require']['test'])


def test_executables():
    scripts = setup_arguments()['entry_points']['console_scripts']
    modules = dict(re.split(r'\s*=\s*', script) for script in scripts)
    assert modules['ambush_planner'] == 'ambush_planner.ros.planner_node:main'
    assert {f'ambush_{name}' for name in COMMANDS} | {'ambush'} <= set(modules)
    for name, target in modules.items():
        assert name.startswith('ambush')
        module, function = target.split(':')
        source = (ROOT / Path(*module.split('.'))).with_suffix('.py').read_text()
        functions = [node.name for node in ast.parse(source).body
                     if isinstance(node, ast.FunctionDef)]
        assert function in functions


def test_every_package_folder_is_installed():
    folders = {path.parent for path in (ROOT / NAME).rglob('*.py')}
    expected = {'.'.join(folder.relative_to(ROOT).parts) for folder in folders}
    assert set(setup_arguments()['packages']) == expected


def test_data_files_exist_and_leave_nothing_out():
    targets = files_by_target()
    assert targets['share/ament_index/resource_index/packages'] == [Path('resource', NAME)]
    assert targets[f'share/{NAME}'] == [Path('package.xml')]
    examples = sorted(path.relative_to(ROOT) for path in (ROOT / 'msg_examples').iterdir())
    assert examples
    assert targets[f'share/{NAME}/msg_examples'] == examples
    assert all((ROOT / file).is_file() for files in targets.values() for file in files)


def test_only_wheels_bring_a_launcher_for_each_executable():
    folder = f'lib/{NAME}'
    assert folder not in files_by_target()
    launchers = files_by_target('bdist_wheel')[folder]
    scripts = setup_arguments()['entry_points']['console_scripts']
    assert {path.name for path in launchers} == {script.split(' ')[0] for script in scripts}
    assert all((ROOT / path).stat().st_mode & 0o111 for path in launchers)


def test_licence_is_the_full_apache_text():
    text = (ROOT / 'LICENSE').read_text()
    assert 'Apache License' in text and 'Version 2.0, January 2004' in text
    assert 'END OF TERMS AND CONDITIONS' in text


def test_changelog_names_the_package():
    lines = (ROOT / 'CHANGELOG.rst').read_text().splitlines()
    assert f'Changelog for package {NAME}' in lines
    assert 'Forthcoming' in lines or any(manifest().findtext('version') in line for line in lines)


def test_no_file_holds_a_path_of_one_machine():
    machine_path = re.compile(rb'(?<![\w.])/(?:home|root|work|farm|Users)/')
    found = [path.name for path in tracked_files() if machine_path.search(path.read_bytes())]
    assert not found
