"""Files written whole or not at all, JSON without NaN, and the hash that names a file in a report."""

from __future__ import annotations

import csv
import dataclasses
import hashlib
import io
import json
import math
import os
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calib.errors import InputError


def write_bytes(path: str | os.PathLike[str], content: bytes) -> Path:
    """Write a file whole or not at all, creating its folder.

    path: where it shall stand.
    content: its bytes.
    return: the path.
    raises InputError where the folder or the file cannot be written.
    """
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # A neighbour in the same folder: only a rename within one file system is indivisible.
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); give a folder you may write to") from error
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(content)
        Path(temporary).chmod(0o666 & ~_umask())
        Path(temporary).replace(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); free the disk or the file") from error
    finally:
        Path(temporary).unlink(missing_ok=True)
    return path


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def write_text(path: str | os.PathLike[str], text: str) -> Path:
    """Write a UTF-8 text file whole or not at all.

    path: where it shall stand.
    text: its content.
    return: the path.
    raises InputError where it cannot be written.
    """
    return write_bytes(path, text.encode("utf-8"))


def write_json(path: str | os.PathLike[str], content: Any) -> Path:
    """Write JSON in full double precision, whole or not at all; what is not a finite number becomes null.

    path: where it shall stand.
    content: nested mappings, sequences, dataclasses, arrays and plain values.
    return: the path.
    raises InputError where it cannot be written, TypeError for a value JSON does not know.
    """
    return write_text(path, json_text(content) + "\n")


def json_text(content: Any) -> str:
    """JSON text in full double precision; what is not a finite number becomes null.

    content: nested mappings, sequences, dataclasses, arrays and plain values.
    return: the text, two blanks of indentation.
    raises TypeError for a value JSON does not know.
    """
    return json.dumps(plain(content), indent=2, ensure_ascii=False, allow_nan=False)


def plain(content: Any) -> Any:
    """The same content in what JSON knows: dict, list, text, int, float, bool and None.

    content: nested mappings, sequences, dataclasses, arrays and plain values.
    return: the plain twin; a number that is not finite becomes None.
    raises TypeError for a value JSON does not know.
    """
    if content is None or isinstance(content, (str, bool)):
        return content
    if isinstance(content, (int, np.integer)):
        return int(content)
    if isinstance(content, (float, np.floating)):
        return float(content) if math.isfinite(content) else None
    if isinstance(content, np.bool_):
        return bool(content)
    if isinstance(content, np.ndarray):
        return plain(content.tolist())
    if isinstance(content, Path):
        return str(content)
    if dataclasses.is_dataclass(content) and not isinstance(content, type):
        return {field.name: plain(getattr(content, field.name)) for field in dataclasses.fields(content)}
    if isinstance(content, Mapping):
        return {str(key): plain(value) for key, value in content.items()}
    if isinstance(content, Iterable):
        return [plain(value) for value in content]
    raise TypeError(f"{type(content).__name__} has no form in JSON")


def write_csv(
    path: str | os.PathLike[str], header: Sequence[str], rows: Iterable[Sequence[Any]], source: str = ""
) -> Path:
    """Write a table as CSV (UTF-8, comma, decimal point, full precision), whole or not at all.

    path: where it shall stand.
    header: names of the columns, with units as in `x_mm`.
    rows: the lines; None and numbers that are not finite become empty cells.
    source: text of the first line `# source: ...`; nothing for none.
    return: the path.
    raises InputError where it cannot be written, ValueError for a line of another length than the header.
    """
    return write_text(path, csv_text(header, rows, source))


def csv_text(header: Sequence[str], rows: Iterable[Sequence[Any]], source: str = "") -> str:
    """The text of a CSV table, as `write_csv` writes it.

    header: names of the columns.
    rows: the lines, each as long as the header.
    source: text of the first line `# source: ...`; nothing for none.
    return: the text.
    raises ValueError for a line of another length than the header.
    """
    stream = io.StringIO()
    if source:
        stream.write(f"# source: {source}\n")
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(header)
    for row in rows:
        if len(row) != len(header):
            raise ValueError(f"a line of {len(row)} cells under a header of {len(header)}")
        writer.writerow([_cell(value) for value in row])
    return stream.getvalue()


def _cell(value: Any) -> Any:
    if value is None:
        return ""
    if isinstance(value, (float, np.floating)):
        return repr(float(value)) if math.isfinite(value) else ""
    return value


def read_json(path: str | os.PathLike[str]) -> Any:
    """The content of a JSON file.

    path: the file.
    return: its content.
    raises InputError where it cannot be read or is not JSON.
    """
    path = Path(path)
    try:
        return json.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check the path") from error
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: is not JSON ({error}); write it again with the program that made it") from error


def distinct_names(paths: Sequence[Path]) -> list[str]:
    """The names of files, with as many of the folders above as it takes to tell different files apart.

    paths: of the files. Returns a name for each, such as "job.toml", or "first/job.toml" beside "second/job.toml".
    """
    whole = [path.resolve().parts[1:] for path in paths]
    names = []
    for parts in whole:
        others = [other for other in whole if other != parts]
        depth = next((k for k in range(1, len(parts)) if all(other[-k:] != parts[-k:] for other in others)), len(parts))
        names.append("/".join(parts[-depth:]))
    return names


def sha256(*paths: str | os.PathLike[str]) -> str:
    """One hash over the content of files, in the order given.

    paths: the files.
    return: 64 hexadecimal digits.
    raises InputError where one cannot be read.
    """
    digest = hashlib.sha256()
    for path in paths:
        try:
            # The hash of each file, so that moving a line from one file to the next changes the whole.
            digest.update(hashlib.sha256(Path(path).read_bytes()).digest())
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror}); check the path") from error
    return digest.hexdigest()
