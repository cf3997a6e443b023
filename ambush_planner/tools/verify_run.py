"""The work of ``ambush_verify``: a line a departure, and how many hold."""

from __future__ import annotations

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
    failed = 0
    for path in paths:
        verdict = verifier.verify(path)
        failed += not verdict.holds
        print(line(verdict), flush=True)
    say(f"planned {len(solves)} times")
    what = f"{failed} of " * bool(failed) + _count(len(paths), "departure")
    print(f"{what}: {'not consistent' if failed else 'all hold'}")
    return not failed


def line(verdict: Verdict) -> str:
    """What was found, in one line."""
    found = [text for text in (verdict.summary, *verdict.problems) if text]
    noted = f" ({'; '.join(verdict.notes)})" * bool(verdict.notes)
    return f"{'holds' if verdict.holds else 'FAILS'}  {verdict.path}: {'; '.join(found)}{noted}"


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'s' * (number != 1)}"
