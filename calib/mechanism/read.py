"""Files of recorded mechanisms: joint positions without a header, and measured poses in YAML."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calib.errors import InputError
from calib.mechanism.axis import Array

_LINE = re.compile(r"^(?P<indent> *)(?P<item>- "
                   r"+)?(?:(?P<key>'[^']*'|\"[^\"]*\"|[^:#\s][^:#]*):(?:\s+|$))?(?P<value>[^#]*)")


def joint_positions(path: Path, columns: int) -> Array:
    """Joint positions (n, columns) of a file without a header, one pose a line, separated by commas or blanks.

    Raises InputError naming file and line for a value that is no number or a line of another length.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({error}); check the file.") from None
    rows = []
    for number, line in enumerate(lines, 1):
        cells = [c for c in re.split(r"[,;\s]+", line.strip()) if c]
        if not cells or line.lstrip().startswith("#"):
            continue
        try:
            values = [float(c) for c in cells]
        except ValueError:
            raise InputError(f"{path}, line {number}: '{line.strip()[:60]}' is not a row of numbers; mend it, or mark "
                             "it with #.") from None
        if len(values) != columns:
            raise InputError(f"{path}, line {number}: {len(values)} numbers where {columns} joints are expected; "
                             "check that the file belongs to this mechanism.")
        rows.append(values)
    if not rows:
        raise InputError(f"{path}: holds no positions; check the file.")
    return np.array(rows)


@dataclass(frozen=True)
class MeasuredPoses:
    """Measured poses: names (n,), positions (n, axes), places (n, 3) and quaternions (n, 4) as w, x, y, z; path."""

    path: Path
    names: tuple[str, ...]
    positions: Array
    places: Array
    quaternions: Array


def measured_poses(path: Path, joints: str = "target_joints") -> MeasuredPoses:
    """Poses in the YAML of ROS-Industrial's kinematic calibration: for each name a `pose` (x, y, z [m], qw, qx, qy, qz)
    and a list of joint positions [rad].

    joints: key of that list. Raises InputError naming file and pose where something is missing or no number.
    """
    try:
        entries = _tree(path.read_text(encoding="utf-8-sig"))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({error}); check the file.") from None
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None
    names, positions, places, quaternions = [], [], [], []
    for name, entry in entries.items():
        try:
            pose = entry["pose"]
            places.append([float(pose[k]) for k in "xyz"])
            quaternions.append([float(pose[k]) for k in ("qw", "qx", "qy", "qz")])
            positions.append([float(v) for v in entry[joints]])
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"{path}, pose '{name}': {error} is missing or no number; it needs `pose` with x, y, z, "
                             f"qw, qx, qy, qz and the list `{joints}`.") from None
        names.append(name)
    if len({len(p) for p in positions}) != 1:
        raise InputError(f"{path}: the poses have different numbers of '{joints}'; give one value for each joint in "
                         "every pose.")
    return MeasuredPoses(path, tuple(names), np.array(positions), np.array(places), np.array(quaternions))


def _tree(text: str) -> dict[str, Any]:
    """Nested mappings and lists of plain values: the part of YAML that recorders of poses write."""
    lines = []
    for number, line in enumerate(text.splitlines(), 1):
        if line.strip() and not line.lstrip().startswith(("#", "---")):
            found = _LINE.match(line)
            if not found or not (found["item"] or found["key"]):
                raise ValueError(f"line {number} '{line.strip()[:60]}' is neither `key: value` nor `- value`; write "
                                 "plain YAML.")
            lines.append((number, len(found["indent"]), bool(found["item"]), (found["key"] or "").strip().strip("'\""),
                          found["value"].strip()))
    tree, end = _mapping(lines, 0)
    if end != len(lines):
        raise ValueError(f"line {lines[end][0]}: is indented less than what it belongs to; align it.")
    return tree


def _mapping(lines: list[Any], place: int) -> tuple[dict[str, Any], int]:
    tree: dict[str, Any] = {}
    indent = lines[place][1] if lines else 0
    while place < len(lines) and lines[place][1] == indent and not lines[place][2]:
        _, _, _, key, value = lines[place]
        place += 1
        if value:
            tree[key] = [] if value == "[]" else value
            continue
        items = []
        while place < len(lines) and lines[place][2] and lines[place][1] >= indent:
            items.append(lines[place][4])
            place += 1
        if items or place >= len(lines) or lines[place][1] <= indent:
            tree[key] = items
        else:
            tree[key], place = _mapping(lines, place)
    return tree, place
