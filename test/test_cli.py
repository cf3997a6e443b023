# SPDX-License-Identifier: Apache-2.0
"""Common ground of all commands: one entry, options, exit codes, output for terminals and pipes."""

import importlib
import json
import re
import subprocess
import sys

import numpy as np
import pytest
from audit_samples import record_drawn, sample_plan
from commands import documented_keys, run_here, run_python, run_without, without_progress
from rasters import write_geotiff

from ambush_planner.commands import cli
from ambush_planner.maps.map_file import write_map
from ambush_planner.maps.occupancy import OccupancyMap

ENTRY = [sys.executable, '-m', 'ambush_planner.commands.cli']


def exit_code(arguments):
    with pytest.raises(SystemExit) as stop:
        cli.main(arguments)
    return stop.value.code


def test_entry_lists_all_commands(capsys):
    assert exit_code(['--help']) == 0
    output = capsys.readouterr().out
    assert all(f'    {name} ' in output for name in cli.COMMANDS)
    assert exit_code([]) == exit_code(['unheard']) == exit_code(['verfy']) == 2
    assert "there is no command 'verfy'; did you mean 'verify'?" in capsys.readouterr().err


@pytest.mark.parametrize('name', sorted(cli.COMMANDS))
def test_help_fits_a_screen(name, monkeypatch, capsys):
    monkeypatch.setenv('COLUMNS', '80')
    assert exit_code([name, '--help']) == 0
    assert capsys.readouterr().out.count('\n') <= 45


def flat(path, step=50.0):
    """Write an elevation model of 40 x 40 cells, without a coordinate system."""
    write_geotiff(path, np.zeros((40, 40), 'float32'), None,
                  (step, 0.0, 0.0, 0.0, -step, 40.0 * step))


def test_broken_pipe_is_silent(tmp_path):
    flat(tmp_path / 'dem.tif')
    with subprocess.Popen([*ENTRY, 'risk', 'dem.tif', '-o', 'made.yaml'], cwd=tmp_path, text=True,
                          stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        process.stdout.close()
        assert without_progress(process.stderr.read()) == ''
        assert process.wait(60) == 141


def test_solvers_print_nothing_between_our_lines(tmp_path):
    """HiGHS 1.16 greets a process that uses it for the first time."""
    write_map(tmp_path / 'map.yaml', OccupancyMap(np.full((20, 30), 50, np.int8), 10.0))
    line = ('plan map.yaml --start 15 15 --goal 285 185 --reach 15 -o r.csv --json '
            '--set network.refine=0 network.spacing=40')
    plan = subprocess.run([*ENTRY, *line.split()], cwd=tmp_path, capture_output=True, timeout=120,
                          text=True)
    assert json.loads(plan.stdout)['verdict'] == 'holds', plan.stderr


IMPORTED = """
import contextlib, sys
from ambush_planner.commands import cli
for name in cli.COMMANDS:
    for line in ("--typo", "none.tif --start 1 1 --goal 2 2 --radius 9 none.gpx -o x.png"):
        with contextlib.suppress(SystemExit):
            cli.main([name, *line.split()])
print(sorted({"numpy", "scipy", "matplotlib", "yaml"} & set(sys.modules)))
"""


def test_mistakes_are_refused_before_anything_that_computes_is_imported(tmp_path):
    done = run_python(IMPORTED, tmp_path)
    assert done.stdout == '[]\n' and done.stderr.count('\n') == 2 * len(cli.COMMANDS), done.stderr
    assert done.stderr.count(': none.tif: No such file or directory') >= 8


@pytest.mark.parametrize('module', ['argparse', 'scipy.sparse'])
def test_ctrl_c_during_an_import_is_one_line(module, inputs):
    """The finder presses it when the module is asked for; argparse is imported first of all."""
    line = 'plan map.yaml --start 15 15 --goal 285 185 -o made.plan'
    done = run_python(f"""
import os, signal, sys

class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            os.kill(os.getpid(), signal.SIGINT)

sys.modules.pop({module!r}, None)
sys.meta_path.insert(0, Finder())
from ambush_planner.commands import main
sys.exit(main({line.split()!r}))
""", inputs)
    assert (done.returncode, done.stdout) == (130, '')
    assert without_progress(done.stderr) in (
        'ambush: interrupted\n', 'ambush plan: interrupted\n')


@pytest.fixture(scope='module')
def inputs(tmp_path_factory):
    """A folder with recordings, elevation models, a map, places on it, and files that do not fit.
    """
    folder = tmp_path_factory.mktemp('inputs')
    record_drawn(folder / 'runs', 5)
    write_map(folder / 'map.yaml', OccupancyMap(np.tile(np.arange(30, dtype=np.int8), (20, 1)),
                                                10.0))
    flat(folder / 'dem.tif')
    np.savez(folder / 'heights.npz', elevation=np.zeros((40, 40)))
    (folder / 'layers.yaml').write_text('layers: [{terrain: dem.tif}]')
    flat(folder / 'coarse.tif', 500.0)
    (folder / 'bad.npz').write_bytes(b'no')
    (folder / 'to.csv').write_text('name,x,y\nb,285,185\n')
    (folder / 'far.csv').write_text('name,x,y\nnear,200,40\nfar,400,40\n')
    (folder / 'degrees.csv').write_text('name,lat,lon\npost,36.5,-84.2\n')
    sample_plan().save(folder / 'week.plan', n=0)
    (folder / 'trips.csv').write_text('x,y\n15,15\n150,90\n285,185\n')
    return folder


LINES = {
    'audit': 'runs', 'card': 'runs/run_0.mcap -o card.html --speed 20',
    'replay': 'runs --every 0', 'report': 'runs -o reported',
    'verify': 'runs',
    'risk': 'layers.yaml -o risk.yaml',
    'frontier': 'map.yaml --start 15 15 --goal 285 185 -o front.csv --detours 1.1 --slacks 0.1 '
                '--set network.spacing=40',
    'judge': 'map.yaml trips.csv --start 15 15 --goal 285 185 -o judged.png --reach 20 '
             '--set network.spacing=40 network.refine=0',
    'hold': 'map.yaml --start 15 15 --goal 285 185 -o hold.png --radius 40 -k 1 '
            '--candidates to.csv --set network.spacing=40',
    'plan': 'map.yaml --start 15 15 --goal 285 185 -o made.plan --set network.spacing=40',
    'draw': 'week.plan', 'export': 'runs -o exported.csv',
}


@pytest.mark.parametrize('name', LINES)
def test_json_is_the_object_documented_in_the_help(name, inputs, monkeypatch, capsys):
    monkeypatch.chdir(inputs)
    # Replay does not wait for listeners.
    monkeypatch.setattr('ambush_planner.commands.replay._DISCOVERY', 0.0)
    command = importlib.import_module(f'ambush_planner.commands.{name}')
    code = cli.main([name, *LINES[name].split(), '--json'])
    result = json.loads(capsys.readouterr().out)
    assert set(result) == documented_keys(command)
    assert result['verdict'] == cli.Exit(code).name.lower()
    assert str(inputs) not in str(result)


ENDS = '--start 15 15 --goal 285 185'
HOLD, JUDGE = f'hold map.yaml {ENDS} -o h.png', f'judge map.yaml trips.csv {ENDS} -o j.png'


@pytest.mark.parametrize(('line', 'code', 'words'), [
    ('audit --quiet none', 3, 'none'), ('replay --quiet none', 3, 'none'),
    ('report --quiet none -o page', 3, 'none'), ('verify --quiet none', 3, 'none'),
    (f'frontier map.yaml {ENDS} -o f.csv --detour 0.5', 2, '--detour must'),
    (f'frontier map.yaml {ENDS} -o f.csv --detours 0.5', 2, '--detour must'),
    (f'frontier map.yaml {ENDS} -o f.csv --goal 95 95', 2, 'one position'),
    (f'frontier map.yaml {ENDS} -o f.txt', 2, r'\.csv'),
    (f'frontier heights.npz {ENDS} -o f.csv', 3, "no 'alpha'"),
    (f'frontier bad.npz {ENDS} -o f.csv', 3, r'bad\.npz'),
    (f'frontier none {ENDS} -o f.csv', 3, 'none'),
    ('card runs --speed 30 -o c.html', 2, 'name its recording'),
    ('card runs/run_0.mcap --speed 30 -o c.pdf', 2, r'suffix must be \.html'),
    ('card runs/run_0.mcap --speed 0 -o c.html', 2, 'number from 0.01'),
    ('card runs/run_0.mcap --speed 30 --start-time 25:00 -o c.html', 2, 'must be HH:MM'),
    (f'{HOLD} --radius 0.5', 2, r'radius \(at least a cell .* >= 10 \[m\], got 0.5'),
    (f'{HOLD} --radius 50 -k 0', 2, 'must be a number from 1 to 100'),
    (f'{HOLD} --radius 50 --candidates far.csv', 2,
     r"candidate 'far' at \(400, 40\) is off the map, which spans x 0 to 300 and y 0 to 200"),
    (f'{HOLD} --radius 50 --candidates degrees.csv', 3, 'system of the map is unknown'),
    (f'{HOLD} --radius 50 --candidates none.csv', 3, 'no such file'),
    ('risk none.npz -o m.yaml', 3, r'none\.npz: No such file'),
    ('risk coarse.tif -o m.yaml', 3, 'weapon range'),
    ('risk coarse.tif -o m.txt --weapon-range 900', 2, r'\.yaml'),
    (JUDGE, 2, r'how far does an ambusher reach\? Add --reach METRES'),
    (f'{JUDGE} --reach 20 --detour 1.2', 2, 'leave out --detour'),
    (f'{JUDGE} --reach 20 --set strategy.max_detour=1.1', 2, 'leave out --detour'),
    (f'{JUDGE} --reach 20 --secured 600', 2, 'secured area covers everything'),
])
def test_a_mistake_is_named_in_one_line_and_nothing_is_written(inputs, monkeypatch, line, code,
                                                               words):
    monkeypatch.chdir(inputs)
    before = sorted(inputs.rglob('*'))
    done = run_here(cli, *line.split())
    assert done.code == code and re.search(words, done.err), done.err
    said = re.sub(r'(?m)^ *\d+\.\d s .*\n', '', done.err)  # progress, if this takes over 2 s
    assert said.startswith(f'ambush {line.split()[0]}: ') and said.count('\n') == 1
    assert '--quiet' not in line or done.out == ''
    assert sorted(inputs.rglob('*')) == before


GIS = ('geopandas', 'gpxpy', 'matplotlib', 'pyproj', 'rasterio', 'shapely')
ROUTES = 'plan map.yaml --start 15 15 --goal 285 185 --set network.spacing=40 -o'


@pytest.mark.parametrize(('missing', 'lines', 'codes', 'extra'), [
    (['rclpy'], ['replay runs'], '2', 'jazzy'),
    (['matplotlib'], ['audit runs', 'report runs -o page', 'risk layers.yaml -o risk.yaml'],
     '0 2 2', 'figures'),
    (GIS, [f'{ROUTES} few.csv', f'{ROUTES} few.png few.gpx'], '0 2', 'figures,gis'),
])
def test_commands_need_no_package_for_other_things_and_name_the_extra_of_one(
        inputs, missing, lines, codes, extra):
    done = run_without(missing, inputs, *lines)
    assert done.stdout.splitlines()[-1:] == [codes], done.stderr
    assert done.stderr.endswith(
        f"not installed: in a checkout of ambush_planner, run pip install '.[{extra}]'\n")
    assert not list(inputs.glob('few.png'))
