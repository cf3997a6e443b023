# SPDX-License-Identifier: Apache-2.0
"""The program ``ambush`` and what its commands share: parsers, errors, exit codes.

Each command is a module of this package with ``parser()`` and ``main(arguments)``.
"""

from __future__ import annotations

import argparse
import importlib
import os
import re
import sys
from collections.abc import Callable, Collection, Sequence
from difflib import get_close_matches
from enum import IntEnum
from functools import partial
from importlib import resources
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NoReturn

from ..errors import (
    AmbushPlannerError,
    BudgetInfeasible,
    GoalBlocked,
    InvalidCoordinates,
    InvalidNetwork,
    InvalidOption,
    NoRoute,
    StartBlocked,
    StopBlocked,
    TimeLimit,
    telling_warnings,
)
from ..gone import remedy_for
from ..words import count as count
from .console import Console as Console
from .console import place as place

COMMANDS = {
    'plan': 'plan on a map: save the plan, or draw routes for a quick look',
    'draw': "draw a departure from a plan, with its driver's card, and record it",
    'card': 'write the map, legs and times of a departure for its driver',
    'judge': 'judge trips that were driven: your tracks, or recorded departures',
    'hold': 'find the places to secure that lower the value most',
    'risk': 'make a risk map from an elevation model, or from layers of risk',
    'export': 'write recorded departures to files for a GPS or a GIS',
    'frontier': 'compare length budgets and slacks on a map',
    'verify': 'check that recorded departures follow from their inputs',
    'audit': 'test whether departures follow their strategies',
    'report': 'show recorded departures on one page for any browser',
    'replay': 'publish recorded departures again (needs ROS)',
}
EXIT_CODES = (
    'Exit codes: 0 success; 1 a finding; 2 wrong usage; 3 a file cannot be read or written;\n'
    '4 not enough data to decide. A finding takes precedence.'
)
# Words for the options that every user sets.
WORDS = {
    'reach': ('game.ambush_radius', 'METRES', 'how far an ambusher reaches: 500, or 0.5km '
              '(default: 0, only the network nodes that he waits at)'),
    'secured': ('game.secured_radius', 'METRES', 'radius of the area that you secure around '
             'start, stops and goal: nobody can wait there (default: the reach and the tube)'),
    'detour': ('strategy.max_detour', 'RATIO', "largest mean length, as a multiple of the shortest "
               "route's (default: 1.2)"),
    'slack': ('strategy.risk_slack', 'SHARE', 'share of the value to give up for less predictable '
              'routes (default: 0.01)'),
}
# The extras of setup.py that bring the libraries which commands import; ``jazzy`` has all others.
_EXTRAS = {
    'figures': ('matplotlib',),
    'gis': ('geopandas', 'gpxpy', 'mgrs', 'pyogrio', 'pyproj', 'rasterio', 'shapely'),
    'recordings': ('lz4', 'mcap', 'mcap_ros2', 'zstandard'),
}
_SOUTHERN = re.compile('-[0-9.]+[,°]')  # LAT,LON
_TIME = re.compile(r'([01]?\d|2[0-3]):[0-5]\d')
_BROKEN_PIPE, _INTERRUPTED = 141, 130  # exit codes of a shell after SIGPIPE and SIGINT


class Exit(IntEnum):
    """Exit codes of all commands."""

    HOLDS = 0
    FINDING = 1
    USAGE = 2
    UNREADABLE = 3
    TOO_FEW = 4


class UsageError(AmbushPlannerError):
    """The arguments contradict each other or the files that exist."""


class MissingPackages(AmbushPlannerError):
    """A command needs packages that are not installed."""


# Exit codes of errors; all others are files that cannot be used.
_CODES = (
    ((InvalidOption, InvalidCoordinates, InvalidNetwork, StartBlocked, StopBlocked, GoalBlocked,
      MissingPackages), Exit.USAGE),
    ((NoRoute, BudgetInfeasible, TimeLimit), Exit.FINDING),
)
Work = Callable[[argparse.Namespace, Console], Exit]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command that the first argument names."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    parser = _entry_parser()
    if given and given[0] not in COMMANDS and (near := get_close_matches(given[0], COMMANDS, 1)):
        parser.error(f'there is no command {given[0]!r}; did you mean {near[0]!r}?')
    return _run_command(parser.parse_args(given[:1]).command, given[1:])


def new_parser(command: str, description: str, epilog: str, common: Sequence[str] = (),
               details: str = '', usage: str = '') -> argparse.ArgumentParser:
    """Return a parser with the options that all commands have.

    Help ends with ``epilog`` and the exit codes. If there are ``common`` options, ``--help`` shows
    only these, and ``usage``; ``--help-all`` shows all, and ``details`` after the epilog.
    """
    parser = _parser(f'ambush {command}', description, epilog + EXIT_CODES)
    if common:
        parser.usage = usage
        parser.formatter_class = partial(_Formatter, shown=('-h', '--help-all', *common))
        parser.add_argument('--help-all', action=_HelpAll, const=epilog + details + EXIT_CODES,
                            help='show all options')
    parser.add_argument('--json', action='store_true', help='print the result as one JSON object')
    parser.add_argument('-q', '--quiet', action='store_true', help='print errors only')
    return parser


def file_of(*suffixes: str) -> Callable[[str], Path]:
    """Return a parser of file names with one of the suffixes."""
    def file(text: str) -> Path:
        if Path(text).suffix.lower() not in suffixes:
            one_of = 'one of ' * (len(suffixes) > 1)
            raise argparse.ArgumentTypeError(
                f'{text}: its suffix must be {one_of}{", ".join(suffixes)}')
        return Path(text)

    return file


def existing(text: str) -> Path:
    """Parse the name of a file or folder; raises OSError if there is none."""
    Path(text).stat()
    return Path(text)


def require(packages: Collection[str]) -> None:
    """Raise MissingPackages if one of the packages is not installed."""
    if missing := [name for name in packages if find_spec(name) is None]:
        raise MissingPackages(_missing(missing))


def number(least: float, most: float, kind: type = float) -> Callable[[str], Any]:
    """Return a parser of numbers of a kind from ``least`` to ``most``."""
    def number(text: str) -> Any:
        if not least <= kind(text) <= most:
            raise argparse.ArgumentTypeError(
                f'must be a number from {least:g} to {most:g}, got {text!r}'
            )
        return kind(text)

    return number


def time_of_day(text: str) -> str:
    """Parse a time of day, as HH:MM."""
    if not _TIME.fullmatch(text):
        raise argparse.ArgumentTypeError(f'must be HH:MM, got {text!r}')
    return text.zfill(5)


def command(parser: Callable[[], argparse.ArgumentParser], work: Work) -> Callable[..., int]:
    """Return the ``main(arguments)`` of a command."""
    return partial(_run, parser, work)


def _run(make_parser: Callable[[], argparse.ArgumentParser], work: Work,
         arguments: Sequence[str] | None = None) -> int:
    """Parse the arguments, do the work, report errors, and return the exit code."""
    parser = make_parser()
    # argparse takes a token that begins with a minus for an option unless it is a number.
    given = sys.argv[1:] if arguments is None else arguments
    try:
        options = parser.parse_args(
            [f' {each}' if _SOUTHERN.match(each) else each for each in given])
    except OSError as error:  # of ``existing``
        parser.exit(Exit.UNREADABLE, f'{parser.prog}: {_words(error)}\n')
    console = Console(parser.prog, as_json=options.json, quiet=options.quiet)
    if 'wording' in options:
        console.words = partial(options.wording, options)
    try:
        with telling_warnings(console.warn):
            code = work(options, console)
        console.result_as_json(code.name.lower())
        return int(code)
    except UsageError as error:
        parser.error(str(error))
    except BrokenPipeError:
        # Python flushes standard output once more at exit; that must not raise again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return _BROKEN_PIPE
    except (AmbushPlannerError, OSError) as error:
        console.error(_words(error))
        return next((code for kinds, code in _CODES if isinstance(error, kinds)), Exit.UNREADABLE)
    except KeyboardInterrupt:
        console.error('interrupted')
        return _INTERRUPTED


def _words(error: AmbushPlannerError | OSError) -> str:
    """Say what is wrong; with an OSError, with which file."""
    if isinstance(error, OSError) and error.filename is not None:
        return f'{place(Path(error.filename))}: {error.strerror}'
    return str(error)


def resource(name: str) -> str:
    """Return the text of a file of this package."""
    return resources.files(__package__).joinpath(name).read_text('utf-8')


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        unknown, _, given = message.partition('unrecognized arguments: ')
        if not unknown and given.startswith('-'):
            given = given.split()[0].partition('=')[0]
            near = get_close_matches(given, self._option_string_actions, 1)
            message = remedy_for(f'{self.prog.partition(" ")[2]} {given}') or remedy_for(given) or (
                f'no option {given}' + (f'; did you mean {near[0]}?' if near else ''))
        self.exit(Exit.USAGE, f'{self.prog}: {message} (see {self.prog} --help)\n')


class _Formatter(argparse.RawDescriptionHelpFormatter):
    """Help with each argument of an option named once, and with the options ``shown`` or all."""

    def __init__(self, prog: str, shown: Sequence[str] = ()) -> None:
        super().__init__(prog, max_help_position=26)
        self._shown = shown

    def add_argument(self, action: argparse.Action) -> None:
        names = action.option_strings
        if not self._shown or not names or set(names) & set(self._shown):
            super().add_argument(action)

    def _format_args(self, action: argparse.Action, default_metavar: str) -> str:
        text = super()._format_args(action, default_metavar)
        return text.partition(' [')[0] if action.nargs == '+' else text

    def _format_action_invocation(self, action: argparse.Action) -> str:
        if not action.option_strings or action.nargs == 0:
            return super()._format_action_invocation(action)
        names = ', '.join(name for name in action.option_strings if len(name) == 2)
        name = names or action.option_strings[-1]
        return f'{name} {self._format_args(action, self._get_default_metavar_for_optional(action))}'


class _HelpAll(argparse.Action):
    """Show all options, with another epilog, and exit."""

    def __init__(self, option_strings: Sequence[str], dest: str, const: str, help: str) -> None:
        super().__init__(option_strings, dest, 0, const, argparse.SUPPRESS, help=help)

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> NoReturn:
        parser.usage, parser.epilog, parser.formatter_class = None, self.const, _Formatter
        parser.print_help()
        parser.exit()


class _Version(argparse.Action):
    """Print the version, and exit."""

    def __init__(self, option_strings: Sequence[str], dest: str, help: str) -> None:
        super().__init__(option_strings, dest, 0, help=help)

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> NoReturn:
        from .. import __version__

        parser.exit(message=f'ambush_planner {__version__}\n')


def _parser(program: str, description: str, epilog: str) -> _Parser:
    parser = _Parser(prog=program, description=description, epilog=epilog,
                     formatter_class=_Formatter)
    parser.add_argument('--version', action=_Version, help='print the version')
    return parser


def _entry_parser() -> argparse.ArgumentParser:
    parser = _parser('ambush', 'Random routes that an ambusher cannot predict.',
                     'A week: ambush plan MAP ... -o week.plan, then ambush draw week.plan '
                     'each morning.\nambush COMMAND --help explains a command.\n' + EXIT_CODES)
    commands = parser.add_subparsers(dest='command', metavar='COMMAND', required=True)
    for name, summary in COMMANDS.items():
        commands.add_parser(name, help=summary)
    return parser


def _run_command(name: str, arguments: Sequence[str]) -> int:
    try:
        command = importlib.import_module(f'{__package__}.{name}')
        return int(command.main(arguments))
    except ModuleNotFoundError as error:
        package = str(error.name).partition('.')[0]
        print(f'ambush {name}: {_missing([package])}', file=sys.stderr)
        return Exit.USAGE


def _missing(packages: Sequence[str]) -> str:
    """Say which packages are missing, and which extras have them."""
    extras = {next((extra for extra, names in _EXTRAS.items() if name in names), 'jazzy')
              for name in packages}
    verb = 'are' if len(packages) > 1 else 'is'
    return (f'{", ".join(packages)} {verb} not installed: in a checkout of ambush_planner, run '
            f"pip install '.[{','.join(sorted(extras))}]'")


if __name__ == '__main__':
    sys.exit(main())
