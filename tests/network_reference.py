"""The adjustments that GNU Gama printed beside its networks, found through CALIB_REFERENCE_DATA."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

import numpy as np

SPACE = "{http://www.gnu.org/software/gama/gama-local-adjustment}"
FOLDER = Path(os.environ.get("CALIB_REFERENCE_DATA", "nowhere")) / "gama" / "networks"
NETWORKS = sorted(FOLDER.glob("*.gkf"))


@dataclass(frozen=True)
class Adjustment:
    """What Gama printed: coordinates {(point, part): m}, their u before scaling {(point, part): m}, approximate
    coordinates, degrees of freedom, defect, sum of squares over sigma-apr squared, f and standardised residual of each
    reading, and the factor that Gama multiplies by."""

    values: dict[tuple[str, str], float]
    u: dict[tuple[str, str], float]
    approximate: dict[tuple[str, str], float]
    dof: int
    defect: int
    objective: float
    f: np.ndarray
    w: np.ndarray
    factor: float


def adjustment(path: Path) -> Adjustment:
    """Read the .xml beside a .gkf."""
    root = ET.parse(path.with_suffix(".xml")).getroot()

    def text(name: str) -> str:
        found = root.find(f".//{SPACE}{name}")
        assert found is not None and found.text is not None
        return found.text

    apriori = float(text("apriori"))
    used = apriori if text("used") == "apriori" else float(text("aposteriori"))
    factor = used / apriori
    matrix = root.find(f".//{SPACE}cov-mat")
    assert matrix is not None
    numbers = [float(str(one.text)) for one in matrix.findall(f"{SPACE}flt")]
    size, band = int(str(matrix.findtext(f"{SPACE}dim"))), int(str(matrix.findtext(f"{SPACE}band")))
    places = np.cumsum([0] + [min(band, size - 1 - i) + 1 for i in range(size - 1)])
    values = _points(root, "adjusted")
    # Gama's matrix is in mm^2 and scaled by the a posteriori sigma; a factor of zero leaves nothing to compare.
    u = {key: float(np.sqrt(max(numbers[places[i]], 0.0))) * 1e-3 / factor for i, key in enumerate(values)} \
        if factor else {}
    return Adjustment(values, u, _points(root, "approximate"), int(text("degrees-of-freedom")), int(text("defect")),
                      float(text("sum-of-squares")) / apriori**2, _all(root, "f"), _all(root, "std-residual"), factor)


def _points(root: ET.Element, name: str) -> dict[tuple[str, str], float]:
    section = root.find(f".//{SPACE}{name}")
    assert section is not None
    return {(str(point.findtext(f"{SPACE}id")), part.tag.removeprefix(SPACE).lower()): float(str(part.text))
            for point in section for part in point if part.tag != f"{SPACE}id"}


def _all(root: ET.Element, name: str) -> np.ndarray:
    return np.array([float(str(one.text)) for one in root.iter(f"{SPACE}{name}")])
