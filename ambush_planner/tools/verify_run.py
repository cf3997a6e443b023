"""The work of ``ambush_verify``: a line a departure, and how many hold."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path

from ..recording.reader import recordings_in
from ..review.verify import Verdict, Verifier
from .audit_files import say


def run_verify(place: Path) -> bool:
    """Print what is found about each departure; return whether all hold.

    Raises
    ------
    UnreadableRecording
        There is nothing to read at all.
    """
    paths = recordings_in(place)
    say(f"verifying {_count(len(paths), 'recording')}")
    solves: list[Path] = []

    def planning(path: Path) -> None:
        solves.append(path)
        say(f"planning again: {path}")

    verifier = Verifier(planning)
    verdicts = []
    for path in paths:
        verdicts.append(verifier.verify(path))
        print(line(verdicts[-1]), flush=True)
    say(f"planned {_count(len(solves), 'time')}")
    print("".join(f"{gap}\n" for gap in gaps(verdicts)), end="")
    failed = sum(not verdict.holds for verdict in verdicts)
    what = f"{failed} of " * bool(failed) + _count(len(paths), "departure")
    print(f"{what}: {'not consistent' if failed else 'all hold'}")
    return not failed


def line(verdict: Verdict) -> str:
    """What was found, in one line."""
    found = [text for text in (verdict.summary, *verdict.problems) if text]
    noted = f" ({'; '.join(verdict.notes)})" * bool(verdict.notes)
    return f"{'holds' if verdict.holds else 'FAILS'}  {verdict.path}: {'; '.join(found)}{noted}"


def gaps(verdicts: Iterable[Verdict]) -> list[str]:
    """Which departures of a session are missing between others, a line for each such place."""
    sessions: dict[Path, set[int]] = defaultdict(set)
    for verdict in verdicts:
        if verdict.number:
            sessions[verdict.path.parent].add(verdict.number)
    return [
        f"{folder}: no recording of departures {before + 1} to {after - 1}; recording was off, it "
        "failed, or files were taken away"
        for folder, numbers in sessions.items()
        for before, after in pairwise(sorted(numbers)) if after > before + 1
    ]


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'s' * (number != 1)}"
