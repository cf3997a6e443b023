"""The benchmarks of the node run, shortened; how fast and how large it is is not tested here."""

import multiprocessing
import re
from concurrent.futures import ProcessPoolExecutor

import pytest
from commands import BENCHMARKS, run_benchmark
from test_benchmarks import rows

SCRIPTS = ('node_fuzz.py', 'node_ground.py', 'node_latency.py', 'node_load.py', 'node_soak.py')
# Whole solves, each killed at the end of its time, are among what is sent.
pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]


@pytest.fixture(scope='module')
def elsewhere():
    """A process for all scripts: they kill what they talk to, and this one must live on."""
    with ProcessPoolExecutor(1, multiprocessing.get_context('spawn')) as process:
        yield process


@pytest.fixture
def run(elsewhere):
    def run_elsewhere(script: str, *arguments, codes: tuple[int, ...] = (0,)) -> str:
        done = elsewhere.submit(run_benchmark, script, *arguments).result(280)
        assert done.code in codes, done.err
        return done.out

    return run_elsewhere


@pytest.fixture
def attacks(monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    import node_attacks

    return node_attacks


@pytest.fixture
def soak(monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    import node_soak

    return node_soak


@pytest.mark.parametrize('script', SCRIPTS)
def test_help(script):
    done = run_benchmark(script, '--help')
    assert done.code == 0 and 'usage' in done.out


def test_the_node_answers_after_each_of_100_bad_messages(tmp_path, run):
    results = tmp_path / 'results.md'
    text = run('node_fuzz.py', '--messages', 100, '--seed', 3, '--first', 7, '--results', results)
    assert text.startswith('100 messages of seed 3')
    assert '0 unknown errors in the log' in text
    assert float(rows(text)['100'][0]) > 0.0
    assert text.strip() in results.read_text()


def test_one_message_of_the_fuzzing_can_be_sent_again(attacks):
    first, again = (attacks.attack(7, 123) for _ in range(2))
    assert (first.what, first.target) == (again.what, again.target)
    assert repr(first.content) == repr(again.content)
    assert repr(attacks.attack(7, 124).content) != repr(first.content)


def test_all_kinds_of_messages_are_sent(attacks):
    sent = [attacks.attack(1, number) for number in range(1000)]
    names = {name for each in sent for name in each.what.split(' + ')}
    assert names >= {'random bytes', 'any numbers', 'any request', 'any parameters', 'flip',
                     'truncate', 'extend', 'absurd_length', 'odd_number', 'other_encoding'}
    assert {each.target for each in sent} >= {
        '/alpha_map', '/alpha_map_updates', '/start_pose', '/goal_pose', '/initialpose',
        'get_plan', 'new_route', 'replan', 'cancel', 'set_parameters_atomically',
        'set_parameters'}


def test_ten_calls_at_once_are_all_answered(tmp_path, run):
    results = tmp_path / 'results.md'
    # As many as the smaller depth keeps: the benchmark waits for calls that are lost.
    text = run('node_load.py', '--calls', 10, '--clients', 1, '--results', results)
    assert 'every call answered with a route; met' in text
    assert text.strip() in results.read_text()


def test_departures_for_some_seconds_leave_nothing_behind(tmp_path, run):
    results = tmp_path / 'results.md'
    text = run('node_soak.py', '--seconds', 1.5, '--period', 0.1, '--spacing', 5,
               '--results', results)
    cells = rows(text)
    calls, failed = cells['calls, failed'][0].split(', ')
    assert int(calls) >= 15 and failed == '0'
    departures, recordings = re.findall(r'\d+', cells['departures, recordings'][0])[:2]
    assert departures == recordings
    assert cells['left behind'] == ['nothing']
    assert 'too short to tell' in text
    assert text.strip() in results.read_text()


def test_growth_is_that_between_both_ends_of_a_run(soak):
    memory = [(float(k), 100.0 + (k > 60) * 5.0 + (k > 3000) * 21.0) for k in range(3600)]
    before, after, change = soak.growth(memory)
    assert (before, after) == (105.0, 126.0)
    assert change == pytest.approx(20.0)


def test_departures_while_the_map_changes(tmp_path, run):
    text = run('node_ground.py', '--seconds', 1.2, '--cells', 200,
               '--nodes', 400, '--results', tmp_path / 'results.md', codes=(0, 1))
    assert 'an obstacle of 3 x 3 cells jumps, once a second' in rows(text)


def test_every_kind_of_latency_is_told(tmp_path, run):
    results = tmp_path / 'results.md'
    text = run('node_latency.py', '--samples', 3, '--calls', 5, '--nodes', 400, '--maps', 2,
               '--results', results, codes=(0, 1))
    titles = re.findall('^### (.*)$', text, re.MULTILINE)
    assert [title.split()[0] for title in titles] == ['Beside', 'A', 'A']
    assert {
        'service `get_parameters`', 'bad map to its diagnostics', '`new_route`: answer arrived',
        '`get_plan`: answer with the path arrived',
    } <= set(rows(text))
    assert text.strip() in results.read_text()
