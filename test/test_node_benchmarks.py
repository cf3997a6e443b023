"""The benchmarks of the node run, shortened; how fast and how large it is is not tested here."""

import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest
from test_benchmarks import BENCHMARKS, rows

import ambush_planner

SCRIPTS = ("node_fuzz.py", "node_ground.py", "node_latency.py", "node_load.py", "node_soak.py")
# Whole solves, each killed at the end of its time, are among what is sent.
pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]


def run(script: str, *arguments, codes: tuple[int, ...] = (0,)) -> str:
    command = [sys.executable, BENCHMARKS / script, *map(str, arguments)]
    package = Path(ambush_planner.__file__).parent.parent  # the one under test
    path = os.pathsep.join(filter(None, (str(package), os.environ.get("PYTHONPATH"))))
    done = subprocess.run(
        command, env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True, timeout=280
    )
    assert done.returncode in codes, done.stderr
    return done.stdout


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


@pytest.mark.parametrize("script", SCRIPTS)
def test_help(script, monkeypatch, capsys):
    monkeypatch.syspath_prepend(BENCHMARKS)
    monkeypatch.setattr(sys, "argv", [script, "--help"])
    with pytest.raises(SystemExit, match="0"):
        runpy.run_path(BENCHMARKS / script, run_name="__main__")
    assert "usage" in capsys.readouterr().out


def test_the_node_answers_after_each_of_100_bad_messages(tmp_path):
    results = tmp_path / "results.md"
    text = run("node_fuzz.py", "--messages", 100, "--seed", 3, "--results", results)
    assert text.startswith("100 messages of seed 3")
    assert "0 unknown errors in the log" in text
    assert float(rows(text)["100"][0]) > 0.0
    assert text.strip() in results.read_text()


def test_one_message_of_the_fuzzing_can_be_sent_again(tmp_path, attacks):
    assert attacks.attack(7, 123).what == attacks.attack(7, 123).what
    text = run("node_fuzz.py", "--first", 123, "--messages", 1, "--seed", 7,
               "--results", tmp_path / "results.md")
    assert text.startswith("1 messages of seed 7")


def test_all_kinds_of_messages_are_sent(attacks):
    sent = [attacks.attack(1, number) for number in range(1000)]
    names = {name for each in sent for name in each.what.split(" + ")}
    assert names >= {"random bytes", "any numbers", "any request", "any parameters", "flip",
                     "truncate", "extend", "absurd_length", "odd_number", "other_encoding"}
    assert {each.target for each in sent} >= {
        "/alpha_map", "/alpha_map_updates", "/start_pose", "/goal_pose", "/initialpose",
        "get_plan", "new_route", "replan", "cancel", "set_parameters_atomically",
        "set_parameters"}


def test_twenty_calls_at_once_are_all_answered(tmp_path):
    results = tmp_path / "results.md"
    text = run("node_load.py", "--calls", 20, "--clients", 1, "--results", results)
    assert "every call answered with a route; met" in text
    assert text.strip() in results.read_text()


def test_departures_for_some_seconds_leave_nothing_behind(tmp_path):
    results = tmp_path / "results.md"
    text = run("node_soak.py", "--seconds", 1.5, "--period", 0.1, "--results", results)
    cells = rows(text)
    calls, failed = cells["calls, failed"][0].split(", ")
    assert int(calls) >= 15 and failed == "0"
    departures, recordings = re.findall(r"\d+", cells["departures, recordings"][0])[:2]
    assert departures == recordings
    assert cells["left behind"] == ["nothing"]
    assert "too short to tell" in text
    assert text.strip() in results.read_text()


def test_growth_is_that_between_both_ends_of_a_run(soak):
    memory = [(float(k), 100.0 + (k > 60) * 5.0 + (k > 3000) * 21.0) for k in range(3600)]
    before, after, change = soak.growth(memory)
    assert (before, after) == (105.0, 126.0)
    assert change == pytest.approx(20.0)


def test_departures_while_the_map_changes(tmp_path):
    text = run("node_ground.py", "--seconds", 1.2, "--cells", 200,
               "--nodes", 400, "--results", tmp_path / "results.md", codes=(0, 1))
    assert "an obstacle of 3 x 3 cells jumps, once a second" in rows(text)


def test_every_kind_of_latency_is_told(tmp_path):
    results = tmp_path / "results.md"
    text = run("node_latency.py", "--samples", 3, "--calls", 5, "--nodes", 400, "--maps", 2,
               "--results", results, codes=(0, 1))
    titles = re.findall("^### (.*)$", text, re.MULTILINE)
    assert [title.split()[0] for title in titles] == ["Beside", "A", "A"]
    assert {
        "service `get_parameters`", "bad map to its diagnostics", "`new_route`: answer arrived",
        "`get_plan`: answer with the path arrived",
    } <= set(rows(text))
    assert text.strip() in results.read_text()
