"""Jobs as text: what a job reads, packed so that another machine can unpack it; contents are named by their hash."""

from __future__ import annotations

import base64
import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path, PurePosixPath

from calib.errors import InputError
from calib.job import Job

LARGEST = 500_000_000  # bytes of one job; more belongs on a disk that all machines see


@dataclass(frozen=True)
class Parcel:
    """A job without its folders.

    job: path of the job in the parcel; files: {path in the parcel: SHA-256 of its content}; data: whether the folder
    `data` of the parcel is the job's folder of data; problem_file: path of a person's own problem file, or none.
    """

    job: str
    files: Mapping[str, str]
    data: bool = False
    problem_file: str = ""

    def text(self) -> str:
        """The parcel as JSON: names and hashes."""
        return json.dumps(asdict(self), sort_keys=True)

    @staticmethod
    def of_text(text: str) -> Parcel:
        """The parcel that a text describes."""
        return Parcel(**json.loads(text))

    def unpacked(self, contents: Mapping[str, str], folder: Path) -> tuple[Job, Path | None]:
        """The job, read from a folder that then holds its files, and the problem file.

        contents: {SHA-256: text} of at least this parcel's files, as `packed` returns them; folder: empty.
        raises InputError where a content is not what its hash says, or the job cannot be read.
        """
        for name, digest in self.files.items():
            written = in_bytes(contents[digest])
            place = PurePosixPath(name)
            if hashlib.sha256(written).hexdigest() != digest or place.is_absolute() or ".." in place.parts:
                raise InputError(f"{name}: arrived damaged; send the job again")
            path = folder / place
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(written)
        job = folder / self.job
        read = Job.read(job.parent if job.name == "case.toml" else job, folder / "data" if self.data else None)
        return read, folder / self.problem_file if self.problem_file else None


def packed(job: Job, problem_file: Path | None = None) -> tuple[Parcel, dict[str, str]]:
    """A job as text.

    job: as read; problem_file: a person's own, which travels with it.
    return: the parcel, and {SHA-256: content as text} of its files: the job, its tables, earlier results, and what its
    settings name.
    raises InputError where a file cannot be read or a job is too large to send.
    """
    beside = {_plain(path) for path in job.files}
    data: dict[str, Path] = {}
    for name, path in job.named.items():
        is_beside = path == job.path.parent / name
        if Path(name).is_absolute() or (not is_beside and ".." in Path(name).parts):
            raise InputError(f"{job.path}: names '{name}' by its place on this machine; other machines have other "
                             "folders: write it relative to the job, or give its folder with --data")
        if is_beside:
            beside.add(_plain(path))
        else:
            data[name] = path
    root = Path(os.path.commonpath([path.parent for path in beside])).parent
    places = {(PurePosixPath("job") / path.relative_to(root).as_posix()).as_posix(): path for path in sorted(beside)}
    places |= {f"data/{name}": path for name, path in data.items()}
    if problem_file is not None:
        places[f"own/{problem_file.name}"] = problem_file
    files, contents, size = {}, {}, 0
    for place, path in places.items():
        try:
            read = path.read_bytes()
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror}); check the path") from error
        size += len(read)
        if size > LARGEST:
            raise InputError(f"{job.path}: reads more than {LARGEST / 1e6:.0f} MB, too much to send to other machines; "
                             "leave --scheduler out")
        digest = hashlib.sha256(read).hexdigest()
        files[place], contents[digest] = digest, in_text(read)
    own = (PurePosixPath("job") / _plain(job.path).relative_to(root).as_posix()).as_posix()
    return Parcel(own, files, bool(data), f"own/{problem_file.name}" if problem_file is not None else ""), contents


def _plain(path: Path) -> Path:
    return Path(os.path.abspath(path))  # noqa: PTH100 - a link stays what it is called


def in_text(content: bytes) -> str:
    """Bytes as text, readable where they are UTF-8."""
    try:
        return "text:" + content.decode("utf-8")
    except UnicodeDecodeError:
        return "base64:" + base64.b64encode(content).decode("ascii")


def in_bytes(text: str) -> bytes:
    """The bytes that `in_text` was given."""
    kind, content = text.split(":", 1)
    return content.encode("utf-8") if kind == "text" else base64.b64decode(content)
