# SPDX-License-Identifier: Apache-2.0
"""The commands of README.md and docs that no other test runs: they parse, and their options exist.

`ros2 launch`, `ros2 bag`, `ros2 security`, RViz and Nav2 are not on the package index.
"""

import re
import shutil
import subprocess
from importlib import import_module

import numpy as np
import pytest
from audit_samples import record_drawn
from commands import ROOT, blocks, fenced, run_script
from test_package import setup_arguments

from ambush_planner.commands import cli

DOCUMENTS = [ROOT / 'README.md', *ROOT.glob('docs/*.md')]
TEXT = '\n'.join(path.read_text() for path in DOCUMENTS)
SCRIPTS = [text for path in DOCUMENTS for kind, text in fenced(path) if kind == 'sh']


def test_shell_blocks_parse_and_name_what_exists():
    quoted = '\n'.join(f"bash -n <<'END_OF_BLOCK'\n{text}END_OF_BLOCK" for text in SCRIPTS)
    assert not run_script(quoted, ROOT).stderr
    files = [*re.findall(r'--share ambush_planner\)/([\w./]+\.\w+)', TEXT),
             *(f'launch/{name}' for name in re.findall(r'ros2 launch ambush_planner (\S+)', TEXT))]
    assert files and all((ROOT / name).is_file() for name in files)
    scripts = {each.split(' = ')[0] for each in
               setup_arguments()['entry_points']['console_scripts']}
    assert scripts >= set(re.findall(r'ros2 run\s+ambush_planner\s+(\w+)', TEXT))


def test_options_of_commands_exist():
    """Those in the text, too."""
    code = [*SCRIPTS, *re.findall(r'(?s)`([^`]+)`', TEXT)]
    known = {name: set(import_module(f'ambush_planner.commands.{name}').parser()
                       ._option_string_actions) for name in cli.COMMANDS}
    for line in '\n'.join(code).replace('\\\n', ' ').splitlines():
        if found := re.search(r'\bambush[ _](\w+)\b(.*)', line):
            name, rest = found.groups()
            rest = rest.partition('--ros-args')[0]
            used = set(re.findall(r'(?<=\s)--?[a-z][\w-]*', rest))
            assert name not in known or used <= known[name], line


@pytest.mark.slow
def test_the_commands_of_the_python_page_work(tmp_path):
    rasterio = pytest.importorskip('rasterio', reason='GeoTIFF takes the extra "gis"')
    pytest.importorskip('matplotlib', reason='pictures need matplotlib')
    v, u = np.mgrid[0:165, 0:155] / 15.0
    grid = {'driver': 'GTiff', 'height': 165, 'width': 155, 'count': 1, 'crs': 'EPSG:32616',
            'transform': rasterio.Affine(180.0, 0.0, 0.0, 0.0, -180.0, 29700.0)}
    with rasterio.open(tmp_path / 'dem.tif', 'w', dtype='float32', **grid) as file:
        file.write((150.0 * np.sin(u) * np.cos(v)).astype('float32'), 1)
    terrain, frontier = blocks('docs/python.md', 'sh')
    # For one budget, on a network that is not refined, the commands take a tenth of the time.
    sooner = '--detours 1.1 --slacks 0.01 --set network.refine=0'
    done = run_script(f'{terrain}{frontier.rstrip()} {sooner}', tmp_path)
    assert done.returncode == 0, done.stderr
    for name in ('map.yaml', 'map.pgm', 'map.png', 'map.tif', 'map.qml', 'frontier.csv'):
        assert (tmp_path / name).stat().st_size, name


@pytest.mark.skipif(not shutil.which('ssh-keygen'), reason='signing needs ssh-keygen')
def test_signed_recordings_verify_until_one_changes(tmp_path):
    record_drawn(tmp_path / 'RUNS', 2)
    (tmp_path / '.ssh').mkdir()
    key = tmp_path / '.ssh/id_ed25519'
    subprocess.run(['ssh-keygen', '-q', '-t', 'ed25519', '-N', '', '-f', key], check=True)
    (tmp_path / 'signers').write_text(f'NAME {key.with_suffix(".pub").read_text()}')
    (signing,) = blocks('docs/recordings.md', 'sh')
    done = run_script(signing, tmp_path)
    assert done.returncode == 0 and done.stdout.count(': OK') == 2, done.stderr
    changed = next(tmp_path.glob('RUNS/**/*.mcap'))
    changed.write_bytes(changed.read_bytes()[:-1])
    verify = signing.splitlines()[-1]
    assert 'FAILED' in run_script(verify, tmp_path).stdout
