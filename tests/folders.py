"""Files of a job put into a folder, as a person would."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path


def put(folder: Path, files: Mapping[str, str]) -> Path:
    """Write {name: text} into a folder, which is made; returns the path of its job.toml."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    return folder / "job.toml"
