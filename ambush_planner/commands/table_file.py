"""The table of pairs as a CSV file, and the places that it is made of.

While it grows, rows go to ``TABLE.csv.part`` in the order in which they come, each flushed; the
finished table takes the place of ``TABLE.csv`` in one step. Both are read when it is made again.
"""

from __future__ import annotations

import csv
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from ..errors import AmbushPlannerError

COLUMNS = (
    'depot', 'customer', 'value', 'lower_bound', 'expected_length', 'shortest_length',
    'route_entropy', 'error', 'inputs',
)  # inputs: hash of all that the row follows from

Row = Mapping[str, str]


class BadTable(AmbushPlannerError, ValueError):
    """A CSV file is not what it should be."""


@dataclass(frozen=True)
class Place:
    """A named position [m]."""

    name: str
    xy: tuple[float, float]


def read_places(path: Path) -> list[Place]:
    """Read a CSV file with the columns name, x, y; further columns are left alone.

    Raises
    ------
    BadTable
        A column is missing, a position is not two finite numbers, or a name comes twice.
    OSError
        It cannot be opened.
    """
    places: dict[str, Place] = {}
    for line, row in _lines(path, ('name', 'x', 'y')):
        name = row['name'].strip()
        try:
            x, y = float(row['x']), float(row['y'])
        except ValueError:
            x = y = math.nan
        if not (math.isfinite(x) and math.isfinite(y)):
            raise BadTable(f'{path}, line {line}: x and y must be finite numbers [m], got '
                           f'{row["x"]!r} and {row["y"]!r}')
        if not name or name in places:
            raise BadTable(f'{path}, line {line}: each place needs a name of its own, got {name!r}')
        places[name] = Place(name, (x, y))
    if not places:
        raise BadTable(f'{path}: no places')
    return list(places.values())


def _lines(path: Path, columns: Sequence[str]) -> list[tuple[int, dict[str, str]]]:
    try:
        with path.open(encoding='utf-8-sig', newline='') as file:
            reader = csv.DictReader(file, restval='', skipinitialspace=True)
            missing = [name for name in columns if name not in (reader.fieldnames or ())]
            if missing:
                raise BadTable(f'{path}: no column {", ".join(missing)} in its first line')
            return [(reader.line_num, row) for row in reader]
    except (UnicodeDecodeError, csv.Error) as error:
        raise BadTable(f'{path}: not a CSV file: {error}') from error


class TableFile:
    """A table that grows; use it as a context manager.

    Raises
    ------
    BadTable
        At the path is something else than such a table.
    OSError
        It cannot be read, or the part cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._part = path.with_name(f'{path.name}.part')
        self._rows: dict[str, Row] = {}
        self._drop_half_a_line()
        for file in (path, self._part):
            if file.exists():
                self._take(row for _, row in _lines(file, COLUMNS))
        self._stream = open(self._part, 'a', encoding='utf-8', newline='', opener=private)
        self._writer = csv.DictWriter(self._stream, COLUMNS, lineterminator='\n')
        if self._part.stat().st_size == 0:
            self._writer.writeheader()

    def __enter__(self) -> TableFile:
        return self

    def __exit__(self, *_: object) -> None:
        self._stream.close()

    def _take(self, rows: Iterable[Row]) -> None:
        self._rows.update((row['inputs'], row) for row in rows if not row['error'])

    def _drop_half_a_line(self) -> None:
        """Remove what a kill left of a last line, or the file if there is no whole line."""
        with suppress(FileNotFoundError):
            size = self._part.read_bytes().rfind(b'\n') + 1
            if size:
                os.truncate(self._part, size)
            else:
                self._part.unlink()

    def has(self, inputs: str) -> bool:
        """Whether the row of these inputs is there, without an error."""
        return inputs in self._rows

    def add(self, row: Row) -> None:
        """Keep a row."""
        self._rows[row['inputs']] = row
        self._writer.writerow(row)
        self._stream.flush()

    def finish(self, inputs: Sequence[str]) -> None:
        """Write the table with the rows of ``inputs`` in this order, and remove the part."""
        whole = self._path.with_name(f'{self._path.name}.tmp')
        with open(whole, 'w', encoding='utf-8', newline='', opener=private) as file:
            writer = csv.DictWriter(file, COLUMNS, lineterminator='\n', extrasaction='ignore')
            writer.writeheader()
            writer.writerows(self._rows[key] for key in inputs)
            file.flush()
            os.fsync(file.fileno())
        os.replace(whole, self._path)
        self._stream.close()
        self._part.unlink()


def private(path: str, flags: int) -> int:
    """Opener of files that only the owner reads."""
    return os.open(path, flags, 0o600)
