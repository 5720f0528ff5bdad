"""Tables of readings from CSV files: units from the headers, SI inside, nothing dropped and nothing guessed."""

from __future__ import annotations

import csv
import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from calib import columns, files, units
from calib.columns import Column
from calib.errors import InputError

DATA = Path(__file__).resolve().parent.parent / "problems" / "data"
_INDEX_NAMES = ("row", "n", "i", "no", "nr", "id")


@dataclass(frozen=True)
class Table:
    """A table read from a file: columns by name, numbers in SI, and for every row the line of the file it stands on.

    row_numbers: those of a column `row` where it numbers each row once, else counted from 1.
    """

    path: Path
    columns: tuple[Column, ...]
    cells: tuple[tuple[str, ...], ...]
    lines: tuple[int, ...]
    row_numbers: np.ndarray
    header_line: int
    source: str = ""
    decimal: str = "."

    @staticmethod
    def read(
        path: str | Path,
        *,
        decimal: str = ".",
        encoding: str = "utf-8",
        unit_of: Mapping[str, str] | None = None,
        column_of: Mapping[str, str] | None = None,
    ) -> Table:
        """Read a CSV file (comma, semicolon or tab; lines that start with # are remarks, the first one the source).

        path: the file.
        decimal: decimal sign, "." or "," (then cells are separated by semicolons or tabs).
        encoding: "utf-8" (with or without byte order mark) or another encoding by its Python name.
        unit_of: units of columns whose header has none, by column name.
        column_of: header in the file of each column that is named otherwise there, by column name.
        return: the table.
        raises InputError naming file, line, column and remedy: unreadable, empty, ragged or repeated rows.
        """
        path = Path(path)
        text = _decoded(path, encoding)
        source, header_line, header, lines, cells = _split(path, text)
        found = _columns(path, header_line, header, unit_of or {}, column_of or {})
        table = Table(path, found, cells, lines, _row_numbers(found, cells), header_line, source, decimal)
        table._refuse_repeated_rows()
        return table

    def __len__(self) -> int:
        return len(self.cells)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns, without their units."""
        return tuple(column.name for column in self.columns)

    def has(self, name: str) -> bool:
        """Whether there is a column of this name (or with exactly this header)."""
        return any(name in (column.name, column.header) for column in self.columns)

    def column(self, name: str, header: str = "") -> Column:
        """The column of a name.

        name: name without its unit, or the whole header where two columns share a name; header: how it may be written
        where it is missing, for the message.
        return: the column.
        raises InputError where it is missing (with near names) or not unique.
        """
        exact = [column for column in self.columns if column.header == name]
        found = exact or [column for column in self.columns if column.name == name]
        if len(found) == 1:
            return found[0]
        headers = ", ".join(column.header for column in self.columns)
        if found:
            both = ", ".join(column.header for column in found)
            raise InputError(f"{self.path}, line {self.header_line}: {len(found)} columns give '{name}' ({both}); "
                             "keep one of them")
        near = units.near_matches(name, list(self.names))
        hint = f"; did you mean '{near[0]}'?" if near else "."
        raise InputError(f"{self.path}, line {self.header_line}: column '{name}' is missing{hint} "
                         f"Columns there: {headers}. Add the column{f', as in {header}' if header else ''}")

    def number(self, name: str, dimension: str = "number") -> np.ndarray:
        """The numbers of a column in SI.

        name: name of the column.
        dimension: "length", "angle", "time", "temperature", "number", "angle/time" ...
        return: (n,) values in SI.
        raises InputError for a missing column or unit, a wrong unit, an empty cell, NaN or text.
        """
        column = self.column(name, name if dimension == "number" else _example(name, dimension))
        where = f"{self.path}, line {self.header_line}, column '{column.header}'"
        unit = column.unit
        if unit is None:
            if dimension != "number":
                raise InputError(f"{where}: has no unit, where {_article(dimension)} is wanted; "
                                 f"write it in the header, as in {_example(column.name, dimension)}")
            unit = "1"
        elif column.dimension != dimension:
            raise InputError(f"{where}: '{unit}' is a unit of {column.dimension}, where {_article(dimension)} "
                             f"is wanted; correct the header, as in {_example(column.name, dimension)}")
        place = self.columns.index(column)
        return np.array([self._read(row, place, unit) for row in range(len(self))])

    def whole(self, name: str) -> np.ndarray:
        """The whole numbers of a column without unit (counts, faces, blocks, directions).

        name: name of the column.
        return: (n,) integers.
        raises InputError where a cell is no whole number.
        """
        values = self.number(name)
        for row in np.flatnonzero(values != np.round(values)):
            raise InputError(f"{self.place(int(row), self.column(name))}: {values[row]:g} is not a whole number; "
                             "correct it")
        return values.astype(int)

    def text(self, name: str, *, may_be_empty: bool = False) -> np.ndarray:
        """The texts of a column (names of targets, stations, lines).

        name: name of the column.
        may_be_empty: true where an empty cell means something (a remark).
        return: (n,) texts without surrounding blanks.
        raises InputError for a missing column or an empty cell.
        """
        column = self.column(name)
        index = self.columns.index(column)
        values = [row[index].strip() for row in self.cells]
        for row, value in enumerate(values):
            if not value and not may_be_empty:
                raise InputError(f"{self.place(row, column)}: the cell is empty; write the name that belongs there")
        return np.array(values, dtype=str)

    def place(self, row: int, column: Column) -> str:
        """Where a cell stands, for messages.

        row: index from 0; column: the column.
        return: "file, line 7 (row 5), column 'x_mm'".
        """
        return f"{self.path}, line {self.lines[row]} (row {self.row_numbers[row]}), column '{column.header}'"

    def where(self, keep: np.ndarray) -> Table:
        """The table with some of its rows, which keep their numbers.

        keep: (n,) true for the rows that stay.
        return: the smaller table.
        """
        chosen = np.flatnonzero(keep)
        return dataclasses.replace(
            self,
            cells=tuple(self.cells[row] for row in chosen),
            lines=tuple(self.lines[row] for row in chosen),
            row_numbers=self.row_numbers[chosen],
        )

    def places(self, numbers: np.ndarray) -> np.ndarray:
        """Where the rows of some numbers (n,) stand in the table, counted from 0; the numbers must be in it."""
        order = np.argsort(self.row_numbers)
        return order[np.searchsorted(self.row_numbers, numbers, sorter=order)]

    def with_number(self, name: str, values: np.ndarray) -> Table:
        """The table with the numbers of one column replaced.

        name: name of the column; values: (n,) in SI.
        return: the new table; cells carry full precision in the unit of the column.
        raises InputError for a missing column, ValueError for another length.
        """
        column = self.column(name)
        index = self.columns.index(column)
        texts = [columns.text_of(value, column.unit) for value in np.asarray(values, dtype=float)]
        if len(texts) != len(self):
            raise ValueError(f"{len(texts)} values for {len(self)} rows of {self.path}")
        cells = tuple((*row[:index], text, *row[index + 1 :]) for row, text in zip(self.cells, texts))
        return dataclasses.replace(self, cells=cells, decimal=".")

    def write(self, path: str | Path) -> Path:
        """Write the table as CSV, whole or not at all.

        path: the file to write.
        return: the path.
        raises InputError where it cannot be written.
        """
        return files.write_csv(path, [column.header for column in self.columns], self.cells, self.source)

    def _read(self, row: int, place: int, unit: str) -> float:
        try:
            return columns.number(self.cells[row][place], unit, self.decimal)
        except InputError as error:
            raise InputError(f"{self.place(row, self.columns[place])}: {error}") from None

    def _refuse_repeated_rows(self) -> None:
        first: dict[tuple[str, ...], int] = {}
        for row, cells in enumerate(self.cells):
            if cells in first:
                raise InputError(f"{self.path}, line {self.lines[row]}: repeats line {self.lines[first[cells]]} "
                                 f"({', '.join(cells)}) in every column; take it out, or, if it is a second reading, "
                                 "number the readings in a column 'row' or 'repeat'")
            first[cells] = row
        for column in self.columns[:1]:
            if column.name.lower() not in _INDEX_NAMES:
                continue
            seen: dict[str, int] = {}
            for row, cells in enumerate(self.cells):
                if cells[0] in seen:
                    raise InputError(f"{self.place(row, column)}: '{cells[0]}' stands on line "
                                     f"{self.lines[seen[cells[0]]]} already; "
                                     "a row is there twice, or misnumbered: take it out or number it anew")
                seen[cells[0]] = row


def _row_numbers(found: Sequence[Column], cells: Sequence[Sequence[str]]) -> np.ndarray:
    named = [place for place, column in enumerate(found) if column.name == "row"]
    texts = [row[named[0]].strip() for row in cells] if named else []
    if texts and all(text.isdecimal() for text in texts) and len({int(text) for text in texts}) == len(texts):
        return np.array([int(text) for text in texts])
    return np.arange(1, len(cells) + 1)


def shipped(name: str) -> Table:
    """A table that ships with the problems, such as "five_axis/table1_level.csv".

    name: path below problems/data.
    return: the table.
    raises InputError where there is none of that name.
    """
    return Table.read(DATA / name)


def written(source: str, content: Mapping[str, ArrayLike]) -> str:
    """The text of a CSV file with some columns.

    source: what the first line says of them.
    content: {header: (n,)}, such as "x_mm" or "temp_C"; numbers [SI] go into the unit of the header, ten digits of
        each; texts and whole numbers stay as they are.
    return: the text.
    """
    cells = [_cells(columns.column(header), np.asarray(values)) for header, values in content.items()]
    return files.csv_text(list(content), list(zip(*cells, strict=True)), source)


def xyz_mm(places: ArrayLike) -> dict[str, np.ndarray]:
    """The columns x_mm, y_mm, z_mm of some places (n, 3) [m], for `written`."""
    return dict(zip(("x_mm", "y_mm", "z_mm"), np.asarray(places, float).T, strict=True))


def _cells(column: Column, values: np.ndarray) -> list[str]:
    if values.dtype.kind != "f":
        return [str(value) for value in values]
    return [f"{columns.in_unit(value, column.unit):.10g}" for value in values]


def _decoded(path: Path, encoding: str) -> str:
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check the path") from error
    if content.startswith((b"\xff\xfe", b"\xfe\xff")) and encoding == "utf-8":
        raise InputError(f"{path}: is UTF-16; save it as UTF-8, or set encoding = \"utf-16\" for this table")
    try:
        return content.decode("utf-8-sig" if encoding.lower() in ("utf-8", "utf8") else encoding)
    except LookupError:
        raise InputError(f"{path}: encoding '{encoding}' is not known; write utf-8, latin-1 or gb18030") from None
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise InputError(f"{path}, line {line}: byte 0x{content[error.start]:02x} is not {encoding}; "
                         "save the file as UTF-8, or name its encoding for this table, "
                         "as in encoding = \"latin-1\" or \"gb18030\"") from None


def _split(path: Path, text: str) -> tuple[str, int, list[str], tuple[int, ...], tuple[tuple[str, ...], ...]]:
    source, content = "", []
    for line, words in enumerate(text.splitlines(), start=1):
        if words.startswith("#"):
            remark = words.lstrip("# ").strip()
            source = source or remark.removeprefix("source:").removeprefix("Source:").removeprefix("source ").strip()
        elif words.strip(" ,;\t"):
            content.append((line, words))
    if not content:
        raise InputError(f"{path}: is empty; it needs a header line such as angle_deg,reading_arcsec "
                         "and one line a reading")
    header_line, first = content[0]
    separator = max(",;\t", key=lambda sign: (first.count(sign), sign == ","))
    rows = list(_rows(content, separator))
    header = [cell.strip() for cell in rows[0][1]]
    if len(rows) == 1:
        raise InputError(f"{path}: has a header (line {header_line}) and no rows; add one line a reading")
    for line, cells in rows[1:]:
        if len(cells) != len(header):
            comma = separator == "," and len(cells) > len(header)
            hint = (" If its decimal sign is a comma, write points, or separate the cells by semicolons and set "
                    "decimal = \",\" for this table.")
            raise InputError(f"{path}, line {line}: {len(cells)} cells under a header of {len(header)} "
                             f"(line {header_line}): complete the line or mend its separators.{hint if comma else ''}")
    lines = tuple(line for line, _ in rows[1:])
    return source, header_line, header, lines, tuple(tuple(row) for _, row in rows[1:])


def _rows(content: Sequence[tuple[int, str]], separator: str) -> Iterator[tuple[int, list[str]]]:
    # One file line is one row: a quotation mark may be a second of arc, so it never runs on to the next line.
    for line, words in content:
        cells = next(csv.reader([words], delimiter=separator))
        yield line, [cell.strip() for cell in cells]


def _columns(
    path: Path, line: int, header: list[str], unit_of: Mapping[str, str], column_of: Mapping[str, str]
) -> tuple[Column, ...]:
    found: list[Column] = []
    renamed = {theirs: ours for ours, theirs in column_of.items()}
    for index, text in enumerate(header, start=1):
        if not text:
            raise InputError(f"{path}, line {line}: column {index} has no name; name every column")
        if text in header[: index - 1]:
            raise InputError(f"{path}, line {line}: column '{text}' stands there twice; rename one")
        try:
            column = columns.column(text)
        except InputError as error:
            raise InputError(f"{path}, line {line}, column '{text}': {error}") from None
        column = dataclasses.replace(column, name=renamed.pop(text, column.name))
        if column.name in unit_of:
            column = dataclasses.replace(column, unit=unit_of[column.name])
        found.append(column)
    if renamed:
        raise InputError(f"{path}, line {line}: column '{next(iter(renamed))}' is missing; "
                         f"columns there: {', '.join(header)}")
    return tuple(found)


def _article(dimension: str) -> str:
    return f"a{'n' if dimension[0] in 'aeiou' else ''} {dimension}"


def _example(name: str, dimension: str) -> str:
    unit = {"length": "mm", "angle": "deg", "time": "min", "temperature": "C", "pressure": "hPa"}.get(dimension)
    return f"{name}_{unit} or {name} [{unit}]" if unit else f"{name} [unit of {dimension}]"
