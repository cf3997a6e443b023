"""What the commands share: one entry, options, output, exit codes, files that are written.

Each command is a module with ``parser()`` and ``main(arguments)``, see ``command``. The program's
own name chooses it (``ambush_verify``), or the first argument (``ambush verify``).
"""

from __future__ import annotations

import argparse
import importlib
import json
import math
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from enum import IntEnum
from errno import ENOTDIR
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from textwrap import fill
from typing import Any, TypeVar

from ..errors import AmbushPlannerError, shown

COMMANDS = {
    'audit': ('commands.audit', 'do departures follow their strategies, do they show patterns?'),
    'demo': ('commands.demo', 'departures on real ground, through the real node'),
    'frontier': ('commands.frontier', 'what a longer way, or a little more risk, buys'),
    'replay': ('commands.replay', 'publish recorded departures again'),
    'report': ('commands.report', 'recorded departures on one page for any browser'),
    'table': ('commands.table', 'what it costs to drive between all depots and all customers'),
    'terrain': ('commands.terrain', 'a risk map from an elevation model'),
    'verify': ('commands.verify', 'do recorded departures follow from their inputs?'),
    'views': ('commands.views', 'RViz and Foxglove, set up for a map or a recording'),
}
EXIT_CODES = (
    'Exit code: 0 all holds; 1 a finding; 2 wrong usage; 3 something cannot be read or written;\n'
    '4 not enough to tell. A finding goes before the others.'
)
WIDTH = 99
_PATIENCE, _REFRESHED = 2.0, 0.1  # s; of a bar
_BROKEN_PIPE, _INTERRUPTED = 141, 130  # as shells report these signals
_GREEN, _RED, _PLAIN = '\033[32m', '\033[31m', '\033[0m'
_Item = TypeVar('_Item')


class Exit(IntEnum):
    """What a command's exit code says."""

    HOLDS = 0
    FINDING = 1
    USAGE = 2
    UNREADABLE = 3
    TOO_FEW = 4


class UsageError(AmbushPlannerError):
    """The command cannot be run as it was asked for."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command that the program's name or the first argument says."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    name = Path(sys.argv[0]).stem.removeprefix('ambush_')
    if arguments is None and name in COMMANDS:
        return _run(name, given)
    parser = _entry_parser()
    _complete(parser)
    options = parser.parse_args(given[:1])
    return _run(options.command, given[1:])


def new_parser(command: str, description: str, epilog: str) -> argparse.ArgumentParser:
    """Return a command's parser with what all have; the text of ``epilog`` stands as it is."""
    parser = argparse.ArgumentParser(
        prog=f'ambush_{command}',
        description=description,
        epilog=epilog,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument('--version', action='version', version=f'ambush_planner {_version()}')
    parser.add_argument('--json', action='store_true', help='print the result as one JSON object')
    parser.add_argument('-q', '--quiet', action='store_true', help='print nothing but errors')
    return parser


def reader_parser(command: str, description: str, epilog: str) -> argparse.ArgumentParser:
    """Return the parser of a command that reads recordings."""
    parser = new_parser(command, description, epilog)
    parser.add_argument(
        'recordings', type=Path, metavar='FILE_OR_FOLDER',
        help='a recording, a session folder, or the recording.directory with all of them',
    )
    return parser


def positive(text: str) -> int:
    """Read an argument that is a number of things."""
    if not (text.isascii() and text.isdigit() and int(text) > 0):
        raise argparse.ArgumentTypeError(f'must be a positive whole number, got {text!r}')
    return int(text)


def number(least: float, most: float) -> Callable[[str], float]:
    """Return what reads an argument that is a number from ``least`` to ``most``."""
    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not least <= value <= most:
            raise argparse.ArgumentTypeError(
                f'must be a number from {least:g} to {most:g}, got {text!r}'
            )
        return value

    return read


def add_output(parser: argparse.ArgumentParser, what: str) -> None:
    """Let a command write into a folder."""
    parser.add_argument(
        '-o', '--output', type=Path, metavar='DIR', help=f'where {what} goes; made if missing'
    )
    parser.add_argument(
        '--replace', action='store_true', help='replace files that DIR holds already'
    )


class Console:
    """How a command talks: results on standard output, progress and trouble on standard error."""

    def __init__(self, command: str, *, as_json: bool, quiet: bool) -> None:
        self._command, self._json, self._quiet = command, as_json, quiet
        self._colour = sys.stdout.isatty() and 'NO_COLOR' not in os.environ
        self._begin = time.monotonic()
        self.result: dict[str, Any] = {}

    def line(self, text: str = '') -> None:
        """Print a line of the result."""
        if not (self._json or self._quiet):
            print(_wrapped(text), flush=True)

    def item(self, text: str) -> None:
        """Print what belongs to the line before it, indented and wrapped."""
        self.line(fill(text, WIDTH, initial_indent=' ' * 7, subsequent_indent=' ' * 9,
                       break_long_words=False, break_on_hyphens=False))

    def marked(self, mark: str, good: bool) -> str:
        """Return a word in green or red where a terminal shows it."""
        colour = _GREEN if good else _RED
        return f'{colour}{mark}{_PLAIN}' if self._colour else mark

    def say(self, text: str) -> None:
        """Tell the progress."""
        if not self._quiet:
            self._tell(text)

    @property
    def seconds(self) -> float:
        """How long the command has been running."""
        return time.monotonic() - self._begin

    def step(self, text: str) -> None:
        """Tell what comes next, with the time so far."""
        self.say(f'{self.seconds:5.1f} s  {text}')

    def error(self, text: object) -> None:
        """Tell what is wrong, on standard error, also when quiet."""
        self._tell(f'ambush_{self._command}: {text}')

    def _tell(self, text: str) -> None:
        # In a log each message is a line, to be searched for.
        shown_text = _wrapped(text) if sys.stderr.isatty() else text
        print(shown_text, file=sys.stderr, flush=True)

    def progress(self, items: Sequence[_Item], what: str) -> Iterator[_Item]:
        """Yield the items, with a bar from two seconds on where a terminal shows it."""
        bar = self.bar(what)
        for number, item in enumerate(items):
            yield item
            bar((number + 1) / len(items))

    def bar(self, what: str) -> Callable[[float], None]:
        """Return what shows how much is done, 0..1, from two seconds on."""
        begin, told = time.monotonic(), 0.0

        def show(share: float) -> None:
            nonlocal told
            now = time.monotonic() - begin
            if told and share >= 1.0:
                print('\r' + ' ' * WIDTH + '\r', end='', file=sys.stderr, flush=True)
            elif now > max(_PATIENCE, told + _REFRESHED):
                told = now
                text = f'\r[{"#" * int(30 * share):30}] {share:4.0%} {what}'
                print(text, end='', file=sys.stderr, flush=True)

        return show if sys.stderr.isatty() and not self._quiet else lambda share: None

    def finish(self, code: Exit) -> None:
        """Print the verdict and the result as JSON where that was asked for."""
        if self._json:
            result = {'verdict': code.name.lower(), **self.result}
            print(json.dumps(result, indent=1, default=str), flush=True)
        sys.stdout.flush()


Work = Callable[[argparse.Namespace, Console], Exit]


def command(parser: Callable[[], argparse.ArgumentParser], work: Work) -> Callable[..., int]:
    """Return the ``main(arguments)`` of a command."""
    return partial(run, parser, work)


def run(
    make_parser: Callable[[], argparse.ArgumentParser], work: Work,
    arguments: Sequence[str] | None = None,
) -> int:
    """Parse the arguments, do the work, and return the exit code, with the reason told."""
    parser = make_parser()
    _complete(parser)
    options = parser.parse_args(arguments)
    console = Console(
        parser.prog.removeprefix('ambush_'), as_json=options.json, quiet=options.quiet
    )
    try:
        code = work(options, console)
        console.finish(code)
        return int(code)
    except UsageError as error:
        parser.error(str(error))
    except BrokenPipeError:
        # Nobody reads on; what Python still holds back must not raise once more at its end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return _BROKEN_PIPE
    except (AmbushPlannerError, OSError) as error:
        console.error(error)
        return Exit.UNREADABLE
    except KeyboardInterrupt:
        console.error('interrupted')
        return _INTERRUPTED


def place(path: Path) -> str:
    """Return a file's name as short as it can be, fit for a terminal."""
    absolute = Path(os.path.abspath(path))
    here = Path.cwd()
    return shown(absolute.relative_to(here) if absolute.is_relative_to(here) else absolute)


def count(number: int, what: str) -> str:
    """Return a number of things, as ``3 recordings``."""
    return f'{number} {what}{"s" * (number != 1)}'


def refuse_existing(folder: Path, names: Iterable[str], replace: bool) -> None:
    """Check, before the work is done, that no file would be lost.

    Raises
    ------
    UsageError
        A file of one of the ``names`` exists in the folder, and ``replace`` is False.
    NotADirectoryError
        The folder is a file.
    """
    if os.path.lexists(folder) and not folder.is_dir():
        raise NotADirectoryError(ENOTDIR, os.strerror(ENOTDIR), str(folder))
    existing = [name for name in names if os.path.lexists(folder / name)]
    if existing and not replace:
        raise UsageError(
            f'{place(folder / existing[0])} exists already; add --replace, or name another folder '
            'with -o'
        )


def write_private(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write files (mode 0600) to the folder, which is made with mode 0700 if missing."""
    # Commands that write no recordings' secrets need no ROS, which that package does.
    from ..recordings.durable_files import make_private_folders, write_durably

    make_private_folders(Path(os.path.abspath(folder)))
    for name, data in files.items():
        write_durably(folder / name, data)


def _wrapped(text: str) -> str:
    """Wrap lines that are too long for a terminal; names of files and Markdown rows stay whole."""
    return '\n'.join(
        fill(line, WIDTH, subsequent_indent='  ', break_long_words=False, break_on_hyphens=False)
        if len(line) > WIDTH and line[0] != '|' else line for line in text.split('\n')
    )


def _entry_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='ambush', description='Random routes that an ambusher cannot foresee: the commands.',
        epilog='ambush COMMAND --help says more. ' + EXIT_CODES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument('--version', action='version', version=f'ambush_planner {_version()}')
    commands = parser.add_subparsers(dest='command', metavar='COMMAND', required=True)
    wanted = os.environ.get('COMP_LINE', '').split()
    for name, (_, summary) in COMMANDS.items():
        more = [_module(name).parser()] if name in wanted[1:2] else []
        for each in more:
            each.conflict_handler = 'resolve'
        commands.add_parser(name, help=summary, parents=more, add_help=not more)
    return parser


def _run(command: str, arguments: Sequence[str]) -> int:
    try:
        return _module(command).main(arguments)
    except ModuleNotFoundError as error:
        package = str(error.name).partition('.')[0]
        print(
            f"ambush_{command}: {package} is not installed; try: pip install "
            "'ambush_planner[jazzy,figures]'", file=sys.stderr,
        )
        return Exit.UNREADABLE


def _module(command: str) -> Any:
    package = __package__.rpartition('.')[0]
    return importlib.import_module(f'{package}.{COMMANDS[command][0]}')


def _complete(parser: argparse.ArgumentParser) -> None:
    """Complete a line of the shell, where argcomplete is installed."""
    if '_ARGCOMPLETE' in os.environ:
        try:
            import argcomplete
        except ModuleNotFoundError:
            return
        argcomplete.autocomplete(parser)


def _version() -> str:
    try:
        return version('ambush_planner')
    except PackageNotFoundError:
        return 'not installed'


if __name__ == '__main__':
    sys.exit(main())
