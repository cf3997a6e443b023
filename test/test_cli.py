"""What all commands share: one entry, options, exit codes, output fit for terminals and pipes."""

import json
import os
import re
import subprocess
import sys

import numpy as np
import pytest
from audit_samples import departure, drawn, record, sample_plan
from commands import documented_keys
from matplotlib.figure import Figure
from recording_samples import file_of, small_departure

from ambush_planner.commands import cli
from ambush_planner.maps.map_file import write_map
from ambush_planner.maps.occupancy import OccupancyMap

READERS = ('audit', 'replay', 'report', 'verify')


def ambush(*arguments, **more):
    return subprocess.run(
        [sys.executable, '-m', 'ambush_planner.commands.cli', *map(str, arguments)],
        capture_output=True, text=True, timeout=60, check=False, **more,
    )


def test_the_entry_lists_all_commands(capsys):
    with pytest.raises(SystemExit) as stop:
        cli.main(['--help'])
    assert stop.value.code == 0
    told = capsys.readouterr().out
    assert all(f'    {name} ' in told for name in cli.COMMANDS)
    for arguments in ([], ['unheard']):
        with pytest.raises(SystemExit) as stop:
            cli.main(arguments)
        assert stop.value.code == 2


@pytest.mark.parametrize('name', [*READERS, 'demo'])
def test_every_command_has_the_options_that_all_have(name, capsys):
    with pytest.raises(SystemExit) as stop:
        cli.main([name, '--help'])
    assert stop.value.code == 0
    told = capsys.readouterr().out
    for option in ('--version', '--json', '--quiet'):
        assert option in told
    assert 'Exit code: 0 all holds; 1 ' in told and '--json: {' in told
    assert max(map(len, told.splitlines())) < 100
    with pytest.raises(SystemExit) as stop:
        cli.main([name, '--version'])
    assert stop.value.code == 0 and re.match(r'ambush_planner \d', capsys.readouterr().out)


@pytest.mark.parametrize('name', READERS)
def test_what_is_not_there_exits_3_also_when_quiet(name, tmp_path, capsys):
    arguments = [name, '--quiet', str(tmp_path / 'none')]
    more = ['-o', str(tmp_path / 'out')] if name == 'report' else []
    assert cli.main([*arguments, *more]) == 3
    out, err = capsys.readouterr()
    assert out == '' and err.startswith(f'ambush_{name}: ') and err.count('\n') == 1


def test_the_name_of_the_program_says_the_command(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys, 'argv', ['/usr/bin/ambush_verify', str(tmp_path / 'none')])
    assert cli.main() == 3
    assert capsys.readouterr().err.startswith('ambush_verify: ')


def test_a_missing_package_is_named():
    code = (
        'import sys\nsys.modules["mcap"] = None\n'
        'from ambush_planner.commands import cli\nsys.exit(cli.main(["verify", "x"]))'
    )
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 3 and 'mcap is not installed; try: pip install' in done.stderr
    assert 'Traceback' not in done.stderr


def test_a_broken_pipe_is_silent(tmp_path):
    for k in range(30):
        (tmp_path / f'x_{k}.mcap').write_bytes(file_of(small_departure())[:-k - 1])
    process = subprocess.Popen(
        [sys.executable, '-m', 'ambush_planner.commands.cli', 'verify', str(tmp_path), '-q'],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )
    process.stdout.close()
    assert 'Traceback' not in process.stderr.read()
    process.wait(60)
    command = f'{sys.executable} -m ambush_planner.commands.cli verify {tmp_path} | head -n 1'
    done = subprocess.run(command, shell=True, capture_output=True, text=True, timeout=60)
    assert len(done.stdout.splitlines()) == 1
    assert 'Traceback' not in done.stderr and 'BrokenPipe' not in done.stderr


def test_json_is_one_object_and_nothing_else(tmp_path):
    (tmp_path / 'x.mcap').write_bytes(file_of(small_departure())[:-9])
    done = ambush('verify', tmp_path / 'x.mcap', '--json')
    assert done.returncode == 3
    result = json.loads(done.stdout)
    assert result['verdict'] == 'unreadable' and not result['departures'][0]['holds']


def test_names_are_relative_where_that_is_shorter(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert cli.place(tmp_path / 'a' / 'b.mcap') == os.path.join('a', 'b.mcap')
    assert cli.place(tmp_path.parent) == str(tmp_path.parent)
    assert cli.place(tmp_path / 'a\x1b[2J\udcff') == 'a\\x1b[2J\\udcff'


def test_colours_only_on_a_terminal(monkeypatch, capsys):
    assert cli.Console('x', as_json=False, quiet=False).marked('FAILS', False) == 'FAILS'
    monkeypatch.setattr(sys.stdout, 'isatty', lambda: True)
    monkeypatch.delenv('NO_COLOR', raising=False)
    assert '\x1b[31m' in cli.Console('x', as_json=False, quiet=False).marked('FAILS', False)
    monkeypatch.setenv('NO_COLOR', '1')
    assert cli.Console('x', as_json=False, quiet=False).marked('FAILS', False) == 'FAILS'


@pytest.mark.parametrize(('line', 'word'), [
    ('ambush ver', 'verify'), ('ambush verify --rep', '--replan'),
    ('ambush audit --ou', '--output'), ('ambush demo --ou', '--output'),
])
def test_words_are_completed(line, word, tmp_path):
    pytest.importorskip('argcomplete', reason='optional')
    found = tmp_path / 'found'
    done = ambush(env={
        **os.environ, '_ARGCOMPLETE': '1', 'COMP_LINE': line, 'COMP_POINT': str(len(line)),
        '_ARGCOMPLETE_STDOUT_FILENAME': str(found), '_ARGCOMPLETE_IFS': '\n',
    })
    assert 'Traceback' not in done.stderr
    assert any(each.startswith(word) for each in found.read_text().split())


@pytest.mark.parametrize(('terminal', 'quiet'), [(True, False), (False, False), (True, True)])
def test_a_bar_from_two_seconds_on_where_a_terminal_shows_it(terminal, quiet, monkeypatch, capsys):
    clock = iter([0.0, 0.0, 1.9, 2.1, 2.15, 2.3, 2.4])  # two for the console, then a call each
    monkeypatch.setattr(sys.stderr, 'isatty', lambda: terminal)
    monkeypatch.setattr(cli.time, 'monotonic', lambda: next(clock))
    bar = cli.Console('x', as_json=False, quiet=quiet).bar('read')
    told = []
    for share in (0.1, 0.2, 0.3, 0.5, 1.0):
        bar(share)
        told.append(capsys.readouterr().err)
    if terminal and not quiet:
        assert [each != '' for each in told] == [False, True, False, True, True]
        assert told[1].startswith('\r[######  ') and told[1].endswith(' 20% read')
        assert not told[-1].strip()  # wiped
    else:
        assert told == [''] * 5


@pytest.fixture(scope='module')
def place(tmp_path_factory):
    """A folder with recordings, an elevation model, a map, and places on it."""
    folder = tmp_path_factory.mktemp('a folder of a name that is as long as names of folders are')
    some_plan = sample_plan()
    record(folder / 'runs', [
        departure(some_plan, route, number) for number, route in enumerate(drawn(some_plan, 5), 1)
    ])
    write_map(folder / 'map.yaml', OccupancyMap(np.full((20, 30), 50, np.int8), 10.0))
    np.savez(folder / 'dem.npz', elevation=np.zeros((8, 9)), resolution=10.0)
    (folder / 'from.csv').write_text('name,x,y\na,15,15\n')
    (folder / 'to.csv').write_text('name,x,y\nb,285,185\n')
    return folder


LINES = {
    'audit': 'runs', 'replay': 'runs --every 0 --rate 1e9', 'report': 'runs -o reported --replace',
    'verify': 'runs', 'terrain': 'dem.npz -o made.yaml', 'views': 'map.yaml -o viewed --replace',
    'frontier': 'map.yaml --start 15 15 --goal 285 185 -o front.csv --detours 1.1 --slacks 0.1 '
                '--set network.spacing=40',
    'table': 'from.csv to.csv --map map.yaml -o table.csv --jobs 1 --set network.spacing=40',
}


@pytest.mark.parametrize('name', LINES)
def test_lines_are_short_names_relative_and_json_is_the_object_in_the_help(
    name, place, monkeypatch, capsys
):
    monkeypatch.chdir(place)
    # Nobody is there to listen.
    monkeypatch.setattr('ambush_planner.commands.replay._DISCOVERY', 0.0)
    monkeypatch.setattr('ambush_planner.commands.terrain.terrain_figure', lambda *_: Figure((1, 1)))
    module = cli._module(name)
    code = module.main(LINES[name].split())
    told = capsys.readouterr()
    said = told.out + told.err
    assert max(map(len, said.splitlines())) < 100
    assert str(place) not in said and '\x1b' not in said
    assert module.main([*LINES[name].split(), '--json']) == code
    result = json.loads(capsys.readouterr().out)
    assert set(result) == documented_keys(module)
    assert result['verdict'] == cli.Exit(code).name.lower()


def test_a_long_line_is_wrapped_and_names_stay_whole(monkeypatch, capsys):
    monkeypatch.setattr(sys.stderr, 'isatty', lambda: True)
    console = cli.Console('x', as_json=False, quiet=False)
    name = 'n' * 120
    for tell in (console.line, console.say, console.error):
        tell('word ' * 40 + name + ' word' * 3)
        told = ''.join(capsys.readouterr()).splitlines()
        assert name in [each.strip() for each in told]
        assert all(len(each) < 100 for each in told if name not in each)
