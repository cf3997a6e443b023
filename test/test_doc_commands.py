"""Each fenced block of README.md and docs is run by a test, or checked here if it needs a robot."""

import os
import re
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from audit_samples import departure, drawn, record, sample_plan
from test_package import setup_arguments

from ambush_planner.commands import cli

ROOT = Path(__file__).resolve().parent.parent
DOCUMENTS = {path.name: path.read_text() for path in (ROOT / 'README.md', *ROOT.glob('docs/*.md'))
             if path.parent == ROOT or path.name != 'README.md'}
BLOCKS = [(name, kind, text) for name, document in DOCUMENTS.items()
          for kind, text in re.findall(r'(?ms)^```(\w+)\n(.*?)^```$', document)]
# The blocks by page and kind, and the test that runs them. Those checked below run `ros2 launch`,
# `ros2 bag`, `ros2 security`, RViz or Nav2, none of which is on the package index.
RUN_BY = {
    ('README.md', 'sh'): (2, 'test_readme'),
    ('README.md', 'python'): (1, 'test_readme'),
    ('README.md', 'text'): (1, '.ci/run, which builds a colcon workspace'),
    ('gis.md', 'sh'): (6, 'test_gis_docs'),
    ('gis.md', 'python'): (1, 'test_gis_docs'),
    ('gis.md', 'text'): (2, '.ci/package, which installs the wheel; test_gis_docs'),
    ('nav2.md', 'python'): (1, 'test_launch'),
    ('nav2.md', 'xml'): (1, 'test_launch'),
    ('nav2.md', 'sh'): (5, 'checked below; test_launch starts what the first one starts, '
                           'test_lifecycle makes the transitions of the last one'),
    ('python.md', 'python'): (5, 'test_readme'),
    ('python.md', 'sh'): (3, 'below'),
    ('recordings.md', 'sh'): (2, 'checked below, with a stand-in in test_bag_play; below'),
    ('risk_layers.md', 'python'): (2, 'test_risk_layers'),
    ('risk_layers.md', 'yaml'): (1, 'test_risk_layers'),
    ('risk_layers.md', 'sh'): (1, 'test_risk_layers'),
    ('roads.md', 'python'): (2, 'test_risk_layers'),
    ('roads.md', 'sh'): (1, 'test_risk_layers'),
    ('security.md', 'sh'): (2, 'checked below; test_guarded_routes compares the policy'),
    ('tutorial.md', 'sh'): (7, 'test_tutorial'),
    ('tutorial.md', 'text'): (6, 'test_tutorial'),
}


def blocks(document, kind='sh'):
    return [text for name, fence, text in BLOCKS if (name, fence) == (document, kind)]


def run(script, folder):
    """Run a script with this environment's commands on the path; return the process."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ['PATH']])
    return subprocess.run(['bash', '-ec', script], cwd=folder, capture_output=True, text=True,
                          env={**os.environ, 'PATH': path, 'HOME': str(folder)}, timeout=240,
                          check=False)


def test_every_block_has_a_test():
    # Formulas and diagrams are no commands; test_docs.py parses the formulas.
    counts = Counter((name, kind) for name, kind, _ in BLOCKS if kind not in ('math', 'mermaid'))
    assert counts == {key: number for key, (number, _) in RUN_BY.items()}


@pytest.mark.parametrize('document', DOCUMENTS)
def test_shell_blocks_parse_and_name_what_exists(document):
    for text in blocks(document):
        assert run(f'set -n\n{text}', ROOT).returncode == 0, text
    text = DOCUMENTS[document]
    for name in re.findall(r'--share ambush_planner\)/([\w./]+)', text):
        assert (ROOT / name).is_file(), name
    for name in re.findall(r'ros2 launch ambush_planner (\S+)', text):
        assert (ROOT / 'launch' / name).is_file(), name
    scripts = {each.split(' = ')[0] for each in
               setup_arguments()['entry_points']['console_scripts']}
    assert scripts >= set(re.findall(r'ros2 run\s+ambush_planner\s+(\w+)', text))


@pytest.mark.parametrize('document', DOCUMENTS)
def test_options_of_commands_exist(document):
    """Those in the text, too."""
    code = re.findall(r'(?s)`([^`]+)`', DOCUMENTS[document]) + blocks(document)
    for line in '\n'.join(code).replace('\\\n', ' ').splitlines():
        if found := re.search(r'\bambush[ _](\w+)\b(.*)', line):
            name, rest = found.groups()
            if name in cli.COMMANDS:
                known = cli._module(name).parser()._option_string_actions
                rest = rest.partition('--ros-args')[0]
                assert set(re.findall(r'(?<=\s)--?[a-z][\w-]*', rest)) <= set(known), line


def test_launch_arguments_and_enclaves_exist():
    from xml.etree import ElementTree

    launch = ElementTree.parse(ROOT / 'launch/ambush_planner.launch.xml').getroot()
    declared = {each.get('name') for each in launch.findall('arg')}
    assert set(re.findall(r'(\w+):=', blocks('nav2.md')[0])) <= declared
    policy = ElementTree.parse(ROOT / 'config/ambush_planner.policy.xml').getroot()
    enclaves = {each.get('path') for each in policy.iter('enclave')}
    made, started = blocks('security.md')
    assert set(re.search('in (.*); do', made)[1].split()) == enclaves
    assert set(re.findall(r'(?:enclave |OVERRIDE=)(\S+)', started)) <= enclaves


@pytest.mark.slow
def test_the_commands_of_the_python_page_work(tmp_path):
    rasterio = pytest.importorskip('rasterio', reason='GeoTIFF takes the extra "gis"')
    pytest.importorskip('matplotlib', reason='pictures need matplotlib')
    v, u = np.mgrid[0:330, 0:310] / 30.0
    grid = {'driver': 'GTiff', 'height': 330, 'width': 310, 'count': 1, 'crs': 'EPSG:32616',
            'transform': rasterio.Affine(90.0, 0.0, 0.0, 0.0, -90.0, 29700.0)}
    for name, values in (('dem', 150.0 * np.sin(u) * np.cos(v)), ('roads', np.abs(v - 5.0) < 0.02)):
        with rasterio.open(tmp_path / f'{name}.tif', 'w', dtype='float32', **grid) as file:
            file.write(values.astype('float32'), 1)
    (tmp_path / 'depots.csv').write_text('name,x,y\na,2025,12015\n')
    (tmp_path / 'customers.csv').write_text('name,x,y\nb,26055,27945\nc,20000,3000\n')
    terrain, table, frontier = blocks('python.md')
    done = run(f'{terrain}{table}{frontier.rstrip()} --detours 1.1 --slacks 0.01', tmp_path)
    assert done.returncode == 0, done.stderr
    for name in ('map.yaml', 'map.pgm', 'map.png', 'map.tif', 'table.csv', 'frontier.csv',
                 'frontier.png'):
        assert (tmp_path / name).stat().st_size, name


@pytest.mark.skipif(not shutil.which('ssh-keygen'), reason='signing needs ssh-keygen')
def test_signed_recordings_verify_until_one_changes(tmp_path):
    a_plan = sample_plan()
    record(tmp_path / 'RUNS', [departure(a_plan, route, number)
                               for number, route in enumerate(drawn(a_plan, 2), 1)])
    (tmp_path / '.ssh').mkdir()
    key = tmp_path / '.ssh/id_ed25519'
    subprocess.run(['ssh-keygen', '-q', '-t', 'ed25519', '-N', '', '-f', key], check=True)
    (tmp_path / 'signers').write_text(f'NAME {key.with_suffix(".pub").read_text()}')
    _, signing = blocks('recordings.md')
    done = run(signing, tmp_path)
    assert done.returncode == 0 and done.stdout.count(': OK') == 2, done.stderr
    changed = next(tmp_path.glob('RUNS/**/*.mcap'))
    changed.write_bytes(changed.read_bytes()[:-1])
    verify = signing.splitlines()[-1]
    assert 'FAILED' in run(verify, tmp_path).stdout
