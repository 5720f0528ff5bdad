"""Where a result comes from: version, data, seed and command, so that it can be made again."""

from __future__ import annotations

import importlib.metadata
import platform
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from calib import files

DISTRIBUTION = "calibration-framework"


@dataclass(frozen=True)
class Provenance:
    """What is needed to make a result again."""

    version: str
    python: str
    libraries: dict[str, str]
    command: str
    data: dict[str, str]
    data_sha256: str | None
    seed: int | None

    def content(self) -> dict[str, Any]:
        """The entry `provenance` of the JSON files."""
        return {
            "version": self.version, "data_sha256": self.data_sha256, "seed": self.seed, "command": self.command,
            "data": self.data, "python": self.python, "libraries": self.libraries,
        }

    def lines(self, *more: tuple[str, str]) -> list[tuple[str, str]]:
        """What every page says at its foot.

        more: lines of this kind of run, (name, text), shown after the version.
        return: (name, text) in order.
        """
        return [
            ("command", self.command),
            ("version", self.version),
            *more,
            ("python", self.python),
            ("libraries", ", ".join(f"{name} {version}" for name, version in self.libraries.items())),
            *((f"sha256 of {name}", digest) for name, digest in self.data.items()),
            ("seed", "none" if self.seed is None else str(self.seed)),
        ]


def provenance(data: Sequence[Path], command: str, seed: int | None = None) -> Provenance:
    """The provenance of a result made now.

    data: job and data files; command: as typed; seed: of random numbers, None where none were drawn.
    return: the provenance; data files by name, with no more folders of this machine than tell them apart.
    raises InputError where a file cannot be read.
    """
    libraries = {name: importlib.metadata.version(name) for name in ("casadi", "numpy", "scipy")}
    return Provenance(
        version(), f"{platform.python_implementation()} {sys.version.split()[0]}", libraries, command,
        dict(zip(files.distinct_names(data), map(files.sha256, data), strict=True)),
        files.sha256(*data) if data else None, seed,
    )


def version() -> str:
    """Version of the installed distribution; "not installed" in a bare checkout."""
    try:
        return importlib.metadata.version(DISTRIBUTION)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"
