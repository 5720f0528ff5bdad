"""Jobs: a TOML file, a folder with case.toml, or a network file, with its tables and everything it says in words."""

from __future__ import annotations

import dataclasses
import datetime
import os
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from calib import files, units
from calib.errors import InputError
from calib.settings import Origin, Settings, signed_quantity, unit_in
from calib.table import Table

DATA_FOLDER = "CALIB_REFERENCE_DATA"    # environment variable: a folder of large files, or of other projects' data

MEASUREMENTS = "measurements"
FORMAT = 1  # of a case folder
CERTIFICATE_TEXTS = ("laboratory", "customer", "item")
CERTIFICATE_DATES = ("calibration_date", "issue_date")


@dataclass(frozen=True)
class PriorKnowledge:
    """What is known beforehand of one quantity (value and u in SI, unit as written), or an earlier result.json."""

    quantity: str | None
    value: float
    u: float
    unit: str
    earlier: Path | None
    where: str


@dataclass(frozen=True)
class Exclusion:
    """Rows of one table that are left out, and why."""

    table: str
    rows: tuple[int, ...]
    reason: str


@dataclass(frozen=True)
class Tolerance:
    """Limits of one result [SI], with the unit they were written in."""

    quantity: str
    lower: float
    upper: float
    unit: str
    where: str


@dataclass(frozen=True)
class Job:
    """A job as read: paths, tables (without the excluded rows), settings by section.

    problem: name of the problem module, or of the scenario or suffix that a problem module accepts; complete: the
    tables with the excluded rows; files: the job, its tables in their order, then earlier results that it builds on.
    """

    path: Path
    problem: str
    tables: Mapping[str, Table]
    complete: Mapping[str, Table]
    settings: Settings
    priors: tuple[PriorKnowledge, ...] = ()
    exclude: tuple[Exclusion, ...] = ()
    tolerances: tuple[Tolerance, ...] = ()
    quantities: tuple[str, ...] = ()
    certificate: Mapping[str, Any] = field(default_factory=dict)
    files: tuple[Path, ...] = ()
    data_folder: Path | None = None

    @staticmethod
    def read(path: str | Path, data_folder: Path | None = None) -> Job:
        """Read a job.

        path: a .toml file, a folder with case.toml and measurements.csv, or a file of another suffix that a problem
        module accepts (that module reads it); data_folder: where a problem looks for large files that options name.
        return: the job.
        raises InputError naming file, line, key or column, and what to do.
        """
        if data_folder is not None and not data_folder.is_dir():
            raise InputError(f"{data_folder}: there is no such folder of data; check the path after --data")
        return dataclasses.replace(Job._read(Path(path)), data_folder=data_folder)

    @staticmethod
    def _read(path: Path) -> Job:
        if path.is_dir():
            if not (path / "case.toml").is_file():
                raise InputError(f"{path}: is a folder without case.toml; give the job file itself")
            return _case(path / "case.toml")
        if not path.is_file():
            near = units.near_matches(path.name, [one.name for one in path.parent.glob("*.toml")])
            hint = f"; did you mean '{path.parent / near[0]}'?" if near else "; check the path"
            raise InputError(f"{path}: there is no such job{hint}")
        if path.name == "case.toml":
            return _case(path)
        if path.suffix != ".toml":
            return Job(path, path.suffix, {}, {}, Settings({}, (), Origin(path, "")), files=(path,))
        return _job(path)

    @property
    def options(self) -> Settings:
        """The table [options]."""
        return self.settings.table("options")

    @property
    def instruments(self) -> Settings:
        """The tables [instruments.NAME]."""
        return self.settings.table("instruments")

    @property
    def known(self) -> Settings:
        """The table [known] of a case: constants to be taken as exact."""
        return self.settings.table("known")

    @property
    def report(self) -> Settings:
        """The table [report]."""
        return self.settings.table("report")

    def table(self, name: str) -> Table:
        """One table of readings.

        name: as in [data.NAME].
        return: the table, without the excluded rows.
        raises InputError where the job has none of that name.
        """
        if name in self.tables:
            return self.tables[name]
        there = ", ".join(self.tables) or "none"
        near = units.near_matches(name, list(self.tables))
        hint = f"did you mean '{near[0]}' to be it? " if near else ""
        raise InputError(f"{self.path}: table [data.{name}] is missing (there: {there}); {hint}Add [data.{name}] with "
                         "file = \"...csv\"")

    def instrument(self, table: str) -> Settings:
        """The instrument that a table was read with: [data.TABLE] instrument = "NAME" -> [instruments.NAME].

        table: as in [data.TABLE].
        return: the settings of the instrument.
        raises InputError where it is not named or not described.
        """
        data = self.settings.table("data").table(table)
        name = data.text("instrument")
        if name not in self.instruments:
            there = ", ".join(self.instruments) or "none"
            raise InputError(f"{data.where('instrument')}: there is no [instruments.{name}] (there: {there}); describe "
                             "it there with its kind and its uncertainty u")
        return self.instruments.table(name)

    def including_excluded(self) -> Job:
        """The same job with the excluded rows back in.

        return: the job that nothing is left out of.
        """
        return dataclasses.replace(self, tables=self.complete, exclude=())

    def refuse_unknown_keys(self) -> None:
        """Raise InputError naming every key that neither the job reader nor the problem module asked for."""
        # A case holds more than any one model needs (a thermometer nobody asks for); its format is fixed elsewhere.
        found = [] if self.path.name == "case.toml" else self.settings.unasked()
        if found:
            raise InputError("\n".join(found))

    def sha256(self) -> str:
        """Hash over the job file and its data files.

        return: 64 hexadecimal digits.
        """
        return files.sha256(*self.everything_read)

    @property
    def folders(self) -> tuple[Path, ...]:
        """Where a file that the job names may lie: beside it, in the folder of --data, in $CALIB_REFERENCE_DATA."""
        further = (Path(one) for one in (self.data_folder, os.environ.get(DATA_FOLDER)) if one)
        return tuple(dict.fromkeys((self.path.parent, *further)))

    def file(self, name: str) -> Path:
        """Where a file named in the job lies.

        name: relative to one of `folders`, or absolute.
        return: its path.
        raises InputError naming the places that were tried.
        """
        for folder in self.folders:
            if (folder / name).exists():
                return folder / name
        raise InputError(f"{self.path}: '{name}' is not in {', '.join(map(str, self.folders))}; correct the name, give "
                         f"its folder with --data, or set the environment variable {DATA_FOLDER} to it.")

    @property
    def named(self) -> dict[str, Path]:
        """Files that the settings name, tables and others such as a URDF: {name as written: path}."""
        if self.path.suffix != ".toml":
            return {}
        found = {}
        for text in _texts(tomllib.loads(self.path.read_text(encoding="utf-8-sig"))):
            if not text or len(text) > 1000 or "\n" in text:
                continue
            path = next((folder / text for folder in self.folders if (folder / text).is_file()), None)
            if path is not None:
                found[text] = path
        return found

    @property
    def everything_read(self) -> tuple[Path, ...]:
        """The files of the job and those that its settings name, each once."""
        known = {path.resolve() for path in self.files}
        return (*self.files, *dict.fromkeys(path for path in self.named.values() if path.resolve() not in known))


def _texts(settings: Any) -> Iterator[str]:
    if isinstance(settings, str):
        yield settings
    elif isinstance(settings, dict):
        for value in settings.values():
            yield from _texts(value)
    elif isinstance(settings, list):
        for value in settings:
            yield from _texts(value)


def _parsed(path: Path) -> Settings:
    try:
        text = path.read_text(encoding="utf-8-sig")
        return Settings(tomllib.loads(text), (), Origin(path, text))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check the path") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: byte {error.start} is not UTF-8; save the job file as UTF-8") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: is not TOML: {error}; correct that line (texts stand in quotation marks)") from None


def _job(path: Path) -> Job:
    settings = _parsed(path)
    problem = settings.text("problem")
    data = settings.table("data")
    complete: dict[str, Table] = {}
    sources = [path]
    for name in data:
        described = data.table(name)
        source = path.parent / described.text("file")
        sources.append(source)
        complete[name] = Table.read(
            source,
            decimal=described.text("decimal", ".", (".", ",")),
            encoding=described.text("encoding", "utf-8"),
            unit_of=dict(described.table("units")),
            column_of=dict(described.table("columns")),
        )
        if "instrument" in described:
            described.text("instrument")
    for section in ("options", "instruments", "known"):
        settings.table(section)
    for name in settings.table("instruments"):
        settings.table("instruments").table(name).text("kind", None)
    priors = tuple(_prior(one, path.parent) for one in settings.tables("priors"))
    sources += [one.earlier for one in priors if one.earlier is not None]
    exclude = tuple(_exclusion(one, complete) for one in settings.tables("exclude"))
    report = settings.table("report")
    return Job(
        path, problem, _without(complete, exclude), complete, settings, priors, exclude, _tolerances(report),
        tuple(report.texts("quantities", ())), _certificate(settings), tuple(sources),
    )


def _case(path: Path) -> Job:
    settings = _parsed(path)
    if settings.whole("format") != FORMAT:
        raise InputError(f"{settings.where('format')}: is {settings.whole('format')}, but this version reads format "
                         f"{FORMAT}; write the case in it, or use a version of calib that reads yours")
    settings.text("case")
    scenario = settings.text("scenario")
    for column in settings.tables("columns"):
        for key in ("name", "meaning", "unit"):
            column.text(key)
    source = path.parent / f"{MEASUREMENTS}.csv"
    tables = {MEASUREMENTS: Table.read(source)}
    for section in ("options", "instruments", "known"):
        settings.table(section)
    return Job(path, scenario, tables, tables, settings, files=(path, source))


def _prior(settings: Settings, folder: Path) -> PriorKnowledge:
    earlier = settings.text("from", None)
    if earlier is not None:
        return PriorKnowledge(settings.text("quantity", None), 0.0, 0.0, "", folder / earlier, settings.where())
    name, stated = settings.text("quantity"), settings.text("u")
    unit = _stated_unit(stated, settings.where("u"))
    try:
        kind = units.dimension(unit)
        u = units.quantity(stated, kind)
    except InputError as error:
        raise InputError(f"{settings.where('u')}: {error}") from None
    if not u > 0:
        raise InputError(f"{settings.where('u')}: '{stated}' is no positive uncertainty; hold the quantity to fix it")
    # A plain number is in the unit of its u, so that value = 0.0 needs no unit.
    plain = not isinstance(settings.get("value", 0.0), str)
    value = float(units.to_si(settings.number("value", 0.0), unit)) if plain else settings.quantity("value", kind)
    return PriorKnowledge(name, value, u, unit, None, settings.where())


def _stated_unit(text: str, where: str) -> str:
    unit = unit_in(text)
    if not unit:
        raise InputError(f"{where}: '{text}' has no unit; write number and unit, as in \"10 urad\"")
    return unit


def _exclusion(settings: Settings, tables: Mapping[str, Table]) -> Exclusion:
    name = settings.text("table", next(iter(tables)) if len(tables) == 1 else None)
    if name is None or name not in tables:
        raise InputError(f"{settings.where('table')}: say which table the rows are of; there are: {', '.join(tables)}")
    if "rows" not in settings or not isinstance(settings["rows"], list) or not settings["rows"]:
        raise InputError(f"{settings.where('rows')}: list the rows to leave out, as in rows = [14]")
    rows = settings["rows"]
    there = tables[name].row_numbers
    for row in rows:
        if isinstance(row, bool) or not isinstance(row, int) or row not in there:
            raise InputError(f"{settings.where('rows')}: row {row!r} is not in table '{name}' (rows {there.min()} "
                             f"to {there.max()}); correct the number")
    reason = settings.text("reason")
    if not reason.strip():
        raise InputError(f"{settings.where('reason')}: is empty; say why the rows are left out (every report "
                         "shows it)")
    return Exclusion(name, tuple(rows), reason)


def _without(complete: Mapping[str, Table], exclude: tuple[Exclusion, ...]) -> dict[str, Table]:
    tables = dict(complete)
    for one in exclude:
        table = tables[one.table]
        tables[one.table] = table.where(~np.isin(table.row_numbers, one.rows))
        if not len(tables[one.table]):
            raise InputError(f"{table.path}: every row is excluded; leave some in")
    return tables


def _tolerances(report: Settings) -> tuple[Tolerance, ...]:
    stated = report.table("tolerances")
    found = []
    for name in stated:
        if isinstance(stated[name], Settings):
            lower, upper = (stated.table(name).text(side) for side in ("lower", "upper"))
        else:
            upper = stated.text(name)
            lower = f"-{upper}"
        unit = _stated_unit(upper, stated.where(name))
        try:
            limits = [signed_quantity(text, units.dimension(unit)) for text in (lower, upper)]
        except InputError as error:
            raise InputError(f"{stated.where(name)}: {error}") from None
        if not limits[0] < limits[1]:
            raise InputError(f"{stated.where(name)}: the lower limit lies not below the upper; correct the tolerance")
        found.append(Tolerance(name, limits[0], limits[1], unit, stated.where(name)))
    return tuple(found)


def _certificate(settings: Settings) -> dict[str, Any]:
    if "certificate" not in settings:
        return {}
    certificate = settings.table("certificate")
    missing = [key for key in (*CERTIFICATE_TEXTS, *CERTIFICATE_DATES) if key not in certificate]
    if missing:
        raise InputError(f"{settings.where('certificate')}: {', '.join(missing)} missing; add what is missing "
                         "(it is never invented), or take the table out")
    for key in CERTIFICATE_DATES:
        if not isinstance(certificate[key], datetime.date):
            raise InputError(f"{certificate.where(key)}: is not a date; write it without quotation marks, "
                             "as in 2024-05-17")
    return {key: certificate[key] for key in certificate}
