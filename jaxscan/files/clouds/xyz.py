"""Tables of points as text: `x y z r g b` as this library writes it, and what other programs write.

A table has a separator and a sign for decimals, a line of names or none, words in some of its columns, and sometimes
several scans, each behind a line with its number of points.
"""

import itertools
import os
import re
from collections.abc import Iterator
from typing import BinaryIO, NamedTuple

import numpy as np

from jaxscan.errors import CloudError
from jaxscan.files.clouds.columns import (
    AXES,
    COLOURS,
    Columns,
    Extent,
    Reading,
    assign,
    guessed,
    is_known,
    listed,
    stored_cloud,
)
from jaxscan.files.clouds.header import About, StoredCloud
from jaxscan.files.clouds.points import LONGEST_LINE, Records, blocks, numbers_of, text_lines
from jaxscan.files.disk import Part
from jaxscan.reconstruction import PointCloud


# A micrometre is far below any scanner's noise, and near the resolution of float32.
_PLACE = "%.6f %.6f %.6f"
_TITLE_LINES = 30
_SAMPLE_LINES = 100
_MOST_COLUMNS = 256
_BLOCK_LINES = 1 << 15
"""Lines at a time: as words and numbers of Python each takes ten times the memory."""
_MOST_KEPT = 32 << 20
"""Bytes of numbers that are kept between the two looks at a table."""
_COMMENT = re.compile(r"\s*(?://|#|%|!)+\s*")
_COMMA_NUMBER = re.compile(r"[+-]?\d+(?:,\d+)?(?:[eE][+-]?\d+)?\Z")
_BETWEEN, _WITHIN = re.compile(r",[ ]"), re.compile(r"\d,\d")
_THOUSANDS = re.compile(r"[+-]?\d{1,3}(?:\.\d{3})+,\d+\Z")


def write_xyz(cloud: PointCloud, path: Part, about: About) -> None:
    """Write `x y z r g b` of the valid points, a line each; metres. Without colours `x y z`."""
    plain = "rgb" in cloud.lacks
    line = _PLACE + ("\n" if plain else " %d %d %d\n")
    with open(path, "w", encoding="ascii", newline="\n") as file:
        for points in blocks(cloud, _BLOCK_LINES):
            rows = zip(points.xyz.tolist(), points.rgb.tolist(), strict=True)
            file.writelines(line % (*position, *(() if plain else colour)) for position, colour in rows)


def read_xyz(file: BinaryIO, reading: Reading) -> StoredCloud:
    """The points of a table of numbers, as a single profile.

    Columns are those of the line of names where there is one; else x, y, z, and what their numbers show: three whole
    numbers of 0 to 255 or three of 0 to 1 are a colour, a unit vector is a normal, one number that is left over the
    intensity. Semicolons or blanks beside commas say that the commas are decimal.
    """
    table = _Table.of(file)
    seen = _look_through(table)
    columns, by = _columns_of(table, seen, reading)
    points = _used(table, columns, seen)
    return stored_cloud(
        points,
        table.comments,
        reading,
        columns=columns._replace(places={name: k for k, name in enumerate(points.dtype.names or ())}),
        by=by,
        reach=seen.extent.colours(columns),
        words=(*seen.words, *([table.dialect.words] if table.dialect.words else [])),
    )


# --- how numbers are written


class _Dialect(NamedTuple):
    """How the numbers of a line are separated."""

    separator: str | None
    comma: bool
    """Whether a comma is the sign for decimals."""

    @property
    def words(self) -> str:
        """The dialect in words, for the note; empty for the usual one."""
        return "commas are decimal, by what stands between the columns" if self.comma else ""

    def cells(self, line: str) -> list[str]:
        """The cells of a line; a separator at its end has none behind it."""
        cells = [cell.strip().strip("\"'").strip() for cell in line.strip().split(self.separator)]
        return cells[:-1] if len(cells) > 1 and not cells[-1] else cells

    def plain(self, line: str) -> str:
        """The same numbers with blanks between them and decimal points."""
        if self.separator is not None:
            line = line.replace(self.separator, " ")
        if self.comma:
            line = line.replace(",", ".")
        return line.replace('"', " ") if '"' in line else line

    def number(self, cell: str) -> str:
        """A cell as NumPy reads it."""
        return cell.replace(",", ".") if self.comma else cell


def _dialect_of(lines: list[str]) -> _Dialect:
    """How the numbers of some lines are written."""
    text = "".join(lines)
    if ";" in lines[0]:
        separator: str | None = ";"
    elif "\t" in lines[0].strip() and all(len(line.strip().split("\t")) >= 3 for line in lines):
        separator = "\t"
    else:
        words = [word for line in lines[:20] for word in line.split()]
        by_blanks = min(len(line.split()) for line in lines) >= 3
        decimal = [word for word in words if "," in word]
        if "," not in text or (by_blanks and decimal and all(_COMMA_NUMBER.match(word) for word in decimal)):
            separator = None
        else:
            separator = ","
    cells = [cell.strip().strip("\"'") for line in lines for cell in line.strip().split(separator)]
    if separator == "," and _BETWEEN.search(text) and _WITHIN.search(text):
        # A comma between columns is followed by a blank, one within a number is not.
        if all(_COMMA_NUMBER.match(cell) for line in lines for cell in line.strip().split(", ")):
            return _Dialect(", ", comma=True)
    if separator == ",":
        _check_commas(lines)
        return _Dialect(separator, comma=False)
    if any(_THOUSANDS.match(cell) for cell in cells):
        raise ValueError("points group thousands beside decimal commas; write the numbers without")
    with_comma = [cell for cell in cells if "," in cell]
    return _Dialect(separator, comma=any(_COMMA_NUMBER.match(cell) for cell in with_comma))


def _check_commas(lines: list[str]) -> None:
    """Refuse commas that are both decimal and between columns: fractions begin with zeros, whole numbers do not."""
    rows = [[cell.strip() for cell in line.strip().split(",")] for line in lines]
    numbers = [cell for row in rows for cell in row[1:] if cell.isdigit()]
    if not any("." in cell for row in rows for cell in row) and any(len(one) > 1 and one[0] == "0" for one in numbers):
        raise ValueError("commas are both decimal and between columns; write ; between them")


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


# --- a table


class _Table(NamedTuple):
    """A table in its file."""

    file: BinaryIO
    start: int
    dialect: _Dialect
    titles: tuple[str, ...]
    title: str
    width: int
    texts: frozenset[int]
    comments: tuple[str, ...]
    """Lines before it that are neither names nor numbers."""
    stated: int | None
    """The number of points that stands before them."""

    @staticmethod
    def of(file: BinaryIO) -> "_Table":
        """Find the table of a file, which is at its beginning."""
        before: list[str] = []
        stated: int | None = None
        mark = file.read(3)
        if mark[:2] in (b"\xff\xfe", b"\xfe\xff"):
            raise CloudError("is text in UTF-16, expected UTF-8 or ASCII; save it so.")
        file.seek(3 if mark == b"\xef\xbb\xbf" else 0)
        while True:
            start = file.tell()
            line = file.readline(LONGEST_LINE).decode("utf-8", "replace")
            words = re.split(r"[\s;,]+", line.strip())
            if sum(map(_is_number, words)) >= 3 and not _COMMENT.match(line):
                break
            if len(words) == 2 and all(map(_is_number, words)):
                raise CloudError("found 2 numbers a line, expected x, y and z at least.")
            if not line or len(before) == _TITLE_LINES:
                raise CloudError(f"not a table of numbers: the first {_TITLE_LINES} lines hold none.")
            if len(words) == 1 and words[0].isascii() and words[0].isdigit() and len(words[0]) < 12:
                stated = int(words[0])
            before += [line.strip()] if line.strip() and not words[0].isdigit() else []
        sample = [line, *(text for text in text_lines(file, _SAMPLE_LINES - 1) if text.strip())]
        file.seek(start)
        sample = [line for line in sample if sum(map(_is_number, re.split(r"[\s;,]+", line.strip()))) >= 3]
        dialect = _dialect_of(sample)
        width = len(dialect.cells(line))
        rows = [dialect.cells(one) for one in sample]
        if not 3 <= width <= _MOST_COLUMNS:
            raise CloudError(f"found {width} numbers a line, expected x, y and z at least.")
        texts = frozenset(
            k for row in rows if len(row) == width for k in range(width) if not _is_number(dialect.number(row[k]))
        )
        titles, title = _titles_of(before, dialect, width)
        comments = tuple(one for one in before if one != title)
        return _Table(file, start, dialect, titles, title, width, texts, comments, stated)

    def read(self, notes: list[str]) -> Iterator[tuple[int, np.ndarray]]:
        """The numbers, float64 [n, width], some lines at a time, each with the number of its scan; words are NaN."""
        self.file.seek(self.start)
        lines, dialect, scan = text_lines(self.file, os.fstat(self.file.fileno()).st_size), self.dialect, 0
        kinds = np.dtype([(f"column{k}", "f8") for k in range(self.width)])
        stated, found = self.stated, 0
        plain: list[str] = []

        def taken() -> Iterator[tuple[int, np.ndarray]]:
            nonlocal found
            if plain:
                table = numbers_of(iter(plain), kinds).view("f8").reshape(-1, self.width)
                found += len(table)
                plain.clear()
                yield scan, table

        for line in lines:
            text = line.strip()
            if not text or text[0] in "#%!" or text.startswith("//"):
                continue
            counted = len(text) < 12 and text.isascii() and text.isdigit()
            if counted or text == self.title:
                # Another scan; it may have both.
                yield from taken()
                if found:
                    notes += _count_notes(stated, found, scan)
                    scan, stated, found = scan + 1, None, 0
                stated = int(text) if counted else stated
                continue
            plain.append(self._without_words(text) if self.texts else dialect.plain(text))
            if len(plain) == _BLOCK_LINES:
                yield from taken()
        yield from taken()
        notes += _count_notes(stated, found, scan)

    def _without_words(self, text: str) -> str:
        cells = self.dialect.cells(text)
        if len(cells) != self.width:
            raise ValueError(f"found {len(cells)} columns, expected {self.width}")
        return " ".join("nan" if k in self.texts else self.dialect.number(cell) for k, cell in enumerate(cells))


def _count_notes(stated: int | None, found: int, scan: int) -> list[str]:
    """A note where a scan has more points than its first line says; with fewer the file is cut short."""
    if stated is None or found == stated:
        return []
    said = f"scan {scan + 1} says that it has {stated} points, and has {found}"
    if found < stated:
        raise ValueError(said)
    return [f"{said}: all are read"]


def _titles_of(before: list[str], dialect: _Dialect, width: int) -> tuple[tuple[str, ...], str]:
    """The names of the columns, and the line that holds them; none where no line does."""
    for line in reversed(before):
        text = _COMMENT.sub("", line, count=1)
        ways = [dialect.cells(text), re.split(r"[\s;,]+", text.strip(" ;,"))]
        names = next((cells for cells in ways if len(cells) == width), None)
        known = max(sum(map(is_known, cells)) for cells in ways)
        if names is None and known >= 3:
            names = _with_blanks(ways[1], width, line)
        if names is not None and (known >= 2 or (text == line and not any(map(_is_number, names)))):
            return tuple(names), line
    return (), ""


def _with_blanks(words: list[str], width: int, line: str) -> list[str]:
    """Columns whose names contain blanks: known names at both ends, and one unnamed column between them."""
    left = len(list(itertools.takewhile(is_known, words)))
    right = len(list(itertools.takewhile(is_known, reversed(words[left:]))))
    if len(words) < width or left + right > width or left < 3:
        raise CloudError(
            f'the line "{line:.60}" names {len(words)} columns, and the table has {width}; say what they are '
            "with jaxscan convert --columns."
        )
    between = width - left - right
    middle = " ".join(words[left : len(words) - right])
    return [*words[:left], *([middle] + [""] * (between - 1) if between else []), *words[len(words) - right :]]


class _Seen(NamedTuple):
    """The result of the first pass over a table."""

    points: int
    extent: Extent
    words: tuple[str, ...]
    rows: list[np.ndarray] | None
    """The numbers themselves, so that the text of a small table is parsed once; None where they take much memory."""


def _look_through(table: _Table) -> _Seen:
    points, extent, scans = 0, None, 0
    kept: list[np.ndarray] | None = []
    notes: list[str] = []
    for scan, rows in table.read(notes):
        points += len(rows)
        if kept is not None:
            kept = [*kept, rows] if points * rows[:1].nbytes <= _MOST_KEPT else None
        one = Extent.of(rows)
        extent = one if extent is None else extent.with_more(one)
        scans = max(scans, scan + 1)
    if extent is None:
        raise ValueError("it has no rows")
    words = [f"{scans} scans, one behind the other, in one frame"] if scans > 1 else []
    return _Seen(points, extent, (*words, *notes), kept)


def _columns_of(table: _Table, seen: _Seen, reading: Reading) -> tuple[Columns, str]:
    """Decide which column is which; also the evidence."""
    numbered = [f"column {k + 1}" for k in range(table.width)]
    if reading.columns:
        found, by = listed(table.titles or numbered, reading.columns), "--columns"
    elif table.titles:
        shown = f"{' '.join(table.title.split()):.60}"
        found = assign(table.titles, what=f'the names of the line "{shown}"')
        by = f'the line "{shown}"'
    else:
        found = guessed(seen.extent, points=seen.points, counted=table.stated is not None)
        by = "their numbers" if len(found.places) > len(AXES) or found.unused else "their place"
    if wrong := [name for name in AXES if found.places[name] in table.texts]:
        raise CloudError(
            f"the column of {wrong[0]} holds words, expected numbers; choose others with jaxscan convert --columns."
        )
    return found._replace(places={name: k for name, k in found.places.items() if k not in table.texts}), by


def _used(table: _Table, columns: Columns, seen: _Seen) -> Records:
    """The points with the columns that a cloud uses."""
    # Singles are exact for colours.
    kinds = np.dtype([(name, "f4" if name in COLOURS else "f8") for name in columns.places])

    def read() -> Iterator[np.ndarray]:
        for rows in (rows for _, rows in table.read([])) if seen.rows is None else seen.rows:
            points = np.empty(len(rows), kinds)
            for name, k in columns.places.items():
                with np.errstate(over="ignore"):
                    points[name] = rows[:, k]
            yield points

    return Records(kinds, seen.points, read)
