# SPDX-License-Identifier: Apache-2.0
"""What all commands share: one entry, options, exit codes, output for terminals and pipes."""

import json
import subprocess
import sys

import numpy as np
import pytest
from audit_samples import record_drawn, sample_plan
from commands import documented_keys, run_without

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


def test_missing_input_exits_3_even_if_quiet(tmp_path, capsys):
    for name in ('audit', 'replay', 'report', 'verify'):
        output = ['-o', str(tmp_path / 'out')] if name == 'report' else []
        assert cli.main([name, '--quiet', str(tmp_path / 'none'), *output]) == 3
        out, err = capsys.readouterr()
        assert out == '' and err.startswith(f'ambush {name}: ') and err.count('\n') == 1


def test_broken_pipe_is_silent(tmp_path):
    np.savez(tmp_path / 'dem.npz', elevation=np.zeros((40, 40)), resolution=50.0)
    process = subprocess.Popen(
        [*ENTRY, 'risk', 'dem.npz', '-o', 'made.yaml'], cwd=tmp_path,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )
    process.stdout.close()
    assert process.stderr.read() == ''
    assert process.wait(60) == 141


def test_solvers_print_nothing_between_our_lines(tmp_path):
    """HiGHS 1.16 greets a process that uses it for the first time."""
    write_map(tmp_path / 'map.yaml', OccupancyMap(np.full((20, 30), 50, np.int8), 10.0))
    line = ('plan map.yaml --start 15 15 --goal 285 185 --reach 15 --set network.refine=0 -o r.csv '
            '--json')
    plan = subprocess.run([*ENTRY, *line.split()], cwd=tmp_path, capture_output=True, timeout=120,
                          text=True)
    assert json.loads(plan.stdout)['verdict'] == 'holds', plan.stderr


@pytest.fixture(scope='module')
def inputs(tmp_path_factory):
    """A folder with recordings, an elevation model, a map, and places on it."""
    folder = tmp_path_factory.mktemp('inputs')
    record_drawn(folder / 'runs', 5)
    write_map(folder / 'map.yaml', OccupancyMap(np.full((20, 30), 50, np.int8), 10.0))
    np.savez(folder / 'dem.npz', elevation=np.zeros((40, 40)), resolution=50.0)
    (folder / 'layers.yaml').write_text('layers: [{terrain: dem.npz}]')
    (folder / 'to.csv').write_text('name,x,y\nb,285,185\n')
    sample_plan().save(folder / 'week.plan', n=0)
    (folder / 'trips.csv').write_text('x,y\n15,15\n150,90\n285,185\n')
    return folder


LINES = {
    'audit': 'runs', 'card': 'runs/run_0.mcap -o card.html --speed 20',
    'replay': 'runs --every 0 --rate 1e9', 'report': 'runs -o reported',
    'verify': 'runs',
    'risk': 'layers.yaml -o risk.yaml',
    'frontier': 'map.yaml --start 15 15 --goal 285 185 -o front.csv --detours 1.1 --slacks 0.1 '
                '--set network.spacing=40',
    'judge': 'map.yaml trips.csv --start 15 15 --goal 285 185 -o judged.png --reach 20 '
             '--set network.spacing=40 network.refine=0',
    'hold': 'map.yaml --start 15 15 --goal 285 185 -o hold.csv --radius 40 -k 1 '
            '--candidates to.csv --set network.spacing=40',
    'plan': 'map.yaml --start 15 15 --goal 285 185 -o made.plan --set network.spacing=40',
    'draw': 'week.plan', 'export': 'runs -o exported.csv',
}


@pytest.mark.parametrize('name', LINES)
def test_json_is_the_object_documented_in_the_help(name, inputs, monkeypatch, capsys):
    monkeypatch.chdir(inputs)
    # Replay does not wait for listeners.
    monkeypatch.setattr('ambush_planner.commands.replay._DISCOVERY', 0.0)
    command = cli._module(name)
    code = cli.main([name, *LINES[name].split(), '--json'])
    result = json.loads(capsys.readouterr().out)
    assert set(result) == documented_keys(command)
    assert result['verdict'] == cli.Exit(code).name.lower()
    assert str(inputs) not in str(result)


GIS = ('geopandas', 'gpxpy', 'matplotlib', 'pyproj', 'rasterio', 'shapely')
ROUTES = 'plan map.yaml --start 15 15 --goal 285 185 --set network.spacing=40 -o'


@pytest.mark.parametrize(('missing', 'line', 'extra'), [
    (['rclpy'], 'replay runs', 'jazzy'),
    (['matplotlib'], 'risk layers.yaml -o risk.yaml', 'figures'),
    (['matplotlib'], 'report runs -o page', ''), (['matplotlib'], 'audit runs', ''),
    (GIS, f'{ROUTES} few.csv', ''), (GIS, f'{ROUTES} few.png few.gpx', 'figures,gis'),
])
def test_commands_need_no_package_for_other_things_and_name_the_extra_of_one(
        inputs, missing, line, extra):
    done = run_without(missing, inputs, line)
    assert done.returncode == 2 * bool(extra), done.stderr
    assert not extra or done.stderr.endswith(
        f"not installed: in a checkout of ambush_planner, run pip install '.[{extra}]'\n")
    assert not list(inputs.glob('few.png'))
