"""Survey networks in the XML format of GNU Gama (.gkf), read into a Survey.

Lengths in m with standard deviations in mm; angles in gon with standard deviations in cc (1e-4 gon), or as
degrees-minutes-seconds with standard deviations in arcseconds. Every standard deviation is taken as stated.
Source: GNU Gama manual, chapter 2, XML input data format for gama-local.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from calib import units
from calib.errors import InputError
from calib.units import arcsec, gon, mm
from problems.network.attributes import angle, banded, key_of, known, number, positive
from problems.network.clusters import Record, batches
from problems.network.models import KINDS
from problems.network.survey import ADJUSTED, CONSTRAINED, FIXED, LEFT_HANDED, RIGHT_HANDED, Array, Point, Survey
from problems.network.xml import Element, read_xml

CC = 1e-4 * gon
ENDS = ("from", "to", "val", "stdev", "from_dh", "to_dh")
READINGS = {
    "direction": ("direction", ENDS[1:]),
    "distance": ("distance", ENDS),
    "s-distance": ("slope distance", ENDS),
    "z-angle": ("zenith angle", ENDS),
    "azimuth": ("azimuth", ENDS),
    "angle": ("angle", ("from", "bs", "fs", "val", "stdev", "from_dh", "bs_dh", "fs_dh")),
    "dh": ("height difference", ("from", "to", "val", "stdev", "dist")),
}
DEFAULTS = {"direction": "direction-stdev", "angle": "angle-stdev", "z-angle": "zenith-angle-stdev",
            "azimuth": "azimuth-stdev", "distance": "distance-stdev", "s-distance": "distance-stdev"}
PARAMETERS = ("sigma-apr", "sigma-act", "conf-pr", "tol-abs", "algorithm", "cov-band", "latitude", "ellipsoid",
              "update-constrained-coordinates", "angular", "angles", "language", "encoding", "epoch")
POINT = ("id", "x", "y", "z", "fix", "adj")


@dataclass
class _Network:
    """What was read so far; settings: number of settings of the circle at each point."""

    path: Path
    strict: bool = True
    left_out: list[str] = field(default_factory=list)
    sigma: float = 10.0
    sense: float = 1.0
    turned: list[int] = field(default_factory=list)
    defaults: dict[str, str] = field(default_factory=dict)
    points: dict[str, Point] = field(default_factory=dict)
    lines: dict[str, int] = field(default_factory=dict)
    clusters: list[tuple[list[Record], Array | None]] = field(default_factory=list)
    settings: dict[str, int] = field(default_factory=dict)
    reduced: str = ""
    tolerance: float | None = None
    row: int = 0
    observed: dict[str, dict[str, float]] = field(default_factory=dict)

    def wrong(self, element: Element, what: str) -> InputError:
        return InputError(f"{self.path}, line {element.line}: <{element.tag}> {what}")


def read_gkf(path: str | Path, strict: bool = True) -> Survey:
    """Read a survey network.

    path: of a .gkf file; strict: whether a reading that cannot be read or goes to a point that does not exist, and a
    point that stands at two places, are errors, or take no part and are remarked.
    Returns the survey; points without coordinates have positions that are not numbers.
    Raises InputError naming file, line and what to do where the file is no network of this format, defines entities,
    or contradicts itself.
    """
    path = Path(path)
    root = read_xml(path)
    network = root if root.tag == "network" else root.child("network")
    if network is None:
        raise InputError(f"{path}: has no <network> element; is it an input file of gama-local?")
    found = _Network(path, strict)
    axes, angles = network.attributes.get("axes-xy", "ne"), network.attributes.get("angles", "left-handed")
    known(found, network, ("axes-xy", "angles", "epoch"))
    if axes not in (*LEFT_HANDED, *RIGHT_HANDED):
        raise found.wrong(network, f"axes-xy='{axes}' is not one of {', '.join((*LEFT_HANDED, *RIGHT_HANDED))}")
    if angles not in ("left-handed", "right-handed"):
        raise found.wrong(network, f"angles='{angles}' is neither left-handed (clockwise) nor right-handed")
    found.sense = Survey({}, (), axes=axes, clockwise=angles == "left-handed").sense
    a_posteriori = True
    for parameters in network.children_of("parameters"):
        known(found, parameters, PARAMETERS)
        asked = [name for name in ("latitude", "ellipsoid") if name in parameters.attributes]
        found.reduced = asked[0] if asked else found.reduced
        if "tol-abs" in parameters.attributes:
            found.tolerance = positive(found, parameters, "tol-abs", 0.0) * mm
        found.sigma = positive(found, parameters, "sigma-apr", found.sigma)
        a_posteriori = parameters.attributes.get("sigma-act", "aposteriori") == "aposteriori"
    for section in network.children_of("points-observations"):
        _section(found, section)
    if found.reduced and any(record.kind == "zenith angle" for records, _ in found.clusters for record in records):
        # Without zenith angles gama-local takes every sight as level, and level sights are reduced by nothing.
        raise InputError(f"{path}: asks for reductions of directions and zenith angles to an ellipsoid "
                         f"({found.reduced}), which are not made here; reduce the readings to the plane and leave "
                         f"{found.reduced} out")
    records, remarks = _taking_part(found, strict)
    loose, correlated = batches(records)
    if found.turned:
        remarks.append(
            f"Axes {axes} and {angles} angles turn against each other: as gama-local does, the covariance matrices "
            f"(lines {', '.join(map(str, found.turned[:5]))}{' ...' if found.turned[5:] else ''}) are taken with y "
            "reversed. If they hold for the axes of the file, write angles that turn with the axes."
        )
    remarks += [*found.left_out, *_fixed_elsewhere(found)]
    description = network.child("description")
    title = "" if description is None else " ".join(description.text.split())
    return Survey(found.points, loose, correlated, axes=axes, clockwise=angles == "left-handed", remarks=tuple(remarks),
                  a_posteriori=a_posteriori, tolerance=found.tolerance,
                  name=f"network {path.stem}" + (f" ({title[:60]})" if title else ""))


def _fixed_elsewhere(found: _Network) -> list[str]:
    """Remarks on fixed points whose coordinates are observed and differ: gama-local moves the point there."""
    moved = [key for key, given in found.observed.items() if any(
        found.points[key].role(part) == FIXED and value != found.points[key].position["xyz".index(part)]
        for part, value in given.items())]
    return [f"The coordinates of {', '.join(moved[:5])}{' ...' if moved[5:] else ''} are observed, and fixed at other "
            "values: they stay where they are fixed (gama-local would move them). Write adj instead of fix to adjust "
            "them."] if moved else []


def _section(found: _Network, section: Element) -> None:
    known(found, section, ("distance-stdev", *sorted(set(DEFAULTS.values()) - {"distance-stdev"})))
    found.defaults = dict(section.attributes)
    for element in section.children:
        if element.tag == "point":
            _point(found, element)
        elif element.tag == "obs":
            _cluster(found, element, tuple(READINGS))
        elif element.tag == "height-differences":
            _cluster(found, element, ("dh",))
        elif element.tag in ("vectors", "coordinates"):
            _cluster(found, element, ("vec",) if element.tag == "vectors" else ("point",))
        else:
            raise found.wrong(element, "is not known here; there are: point, obs, height-differences, vectors, "
                              "coordinates")


# --- points and readings ----------------------------------------------------------------------------------------------


def _point(found: _Network, element: Element, observed: bool = False) -> str:
    """Note what a point is, and where unless its coordinates are observed; its key."""
    known(found, element, POINT)
    key = key_of(found, element, "id")
    before = found.points.get(key, Point())
    position = [number(found, element, part, math.nan) if part in element.attributes else old
                for part, old in zip("xyz", before.position, strict=True)]
    if math.isnan(position[0]) != math.isnan(position[1]):
        raise found.wrong(element, f"'{key}' has only one of x and y; give both or none")
    if observed:
        position = list(before.position)
    if element.attributes.keys() & set("xyz") and any(
        not math.isnan(old) and old != new for old, new in zip(before.position, position, strict=True)
    ):
        twice = found.wrong(element, f"'{key}' was given other coordinates in line {found.lines[key]}; two points of "
                            "one name, or one that moved: give each its own id, or delete one line")
        if found.strict or FIXED in (before.plane, before.height):
            raise twice
        found.left_out.append(f"Taken as without coordinates: {twice.sentence.removeprefix(f'{found.path}, ')}")
        position = [math.nan] * 3
    plane, height = before.plane, before.height
    for name in ("fix", "adj"):
        text = element.attributes.get(name, "").strip()
        if text not in ("", "xy", "xyz", "z", "XY", "XYZ", "XYz", "xyZ", "Z"):
            raise found.wrong(element, f"'{key}' has {name}='{text}'; write xy, z or xyz (capitals: constrained)")
        roles = {letter: FIXED if name == "fix" else CONSTRAINED if letter.isupper() else ADJUSTED for letter in text}
        wanted = {letter.lower(): role for letter, role in roles.items()}
        if "fix" in element.attributes and "adj" in element.attributes and name == "adj":
            both = set(element.attributes["fix"].lower()) & set(text.lower())
            if both:
                raise found.wrong(element, f"'{key}' is both fixed and adjusted in {', '.join(sorted(both))}; "
                                  "take one out")
        plane, height = wanted.get("x", plane), wanted.get("z", height)
    found.points[key] = Point((position[0], position[1], position[2]), plane, height)
    found.lines.setdefault(key, element.line)
    return key


def _cluster(found: _Network, cluster: Element, allowed: tuple[str, ...]) -> None:
    known(found, cluster, ("from", "orientation", "from_dh"))
    records: list[Record] = []
    setting = cluster.attributes.get("from", "")
    if any(child.tag == "direction" for child in cluster.children):
        found.settings[setting] = found.settings.get(setting, 0) + 1
        number = found.settings[setting]
        setting = setting if number == 1 else f"{setting} ({number})"
    matrix = cluster.child("cov-mat")
    for element in cluster.children:
        if element.tag == "cov-mat":
            continue
        if element.tag not in allowed:
            raise found.wrong(element, f"does not belong into <{cluster.tag}>; there are: {', '.join(allowed)}")
        records += [replace(r, setting=setting) for r in _readable(found, element, cluster)]
    missing = [r for r in records if any(u is None for u in r.u)]
    if matrix is None and missing:
        what = "a covariance matrix" if missing[0].kind in ("vector", "coordinates", "plane coordinates", "height") \
            else "a stdev, or its default in <points-observations>"
        if found.strict:
            raise InputError(f"{found.path}, line {missing[0].line}: the {missing[0].kind} has no uncertainty; add "
                             f"{what}")
        found.left_out += [f"Left out: row {r.row}: line {r.line}: the {r.kind} has no uncertainty; add {what}"
                           for r in missing]
        records = [r for r in records if None not in r.u]
    covariance = None
    if matrix is not None:
        scale = np.array([s for r in records for s in r.scale])
        covariance = banded(found, matrix, len(scale)) * np.outer(scale, scale)
        # In a system whose axes and circles turn against each other gama-local turns the axis y of all that is read,
        # and leaves the matrices as they stand: their correlations are those with the turned y.
        turned = np.array([found.sense if name in ("y", "dy") else 1.0 for r in records
                           for name in KINDS[r.kind].components])
        signs = np.outer(turned, turned)
        if np.any(covariance != covariance * signs):
            found.turned.append(matrix.line)
        covariance = covariance * signs
    found.clusters.append((records, covariance))


def _readable(found: _Network, element: Element, cluster: Element) -> list[Record]:
    """The records of an element; where it cannot be read and need not, a place holder without ends that is left out."""
    row = found.row
    try:
        return list(_records(found, element, cluster))
    except InputError as error:
        if found.strict:
            raise
        found.row = row + 1
        found.left_out.append(f"Left out: row {found.row}: {error.sentence.removeprefix(f'{found.path}, ')}")
        size = sum(part in element.attributes for part in "xyz") if element.tag == "point" else \
            3 if element.tag == "vec" else 1
        kind = {1: "height", 2: "plane coordinates", 3: "coordinates"}.get(size, "height")
        return [Record(kind, ("", "", ""), (math.nan,) * size, (1.0,) * size, (1.0,) * size, "m", (0.0, 0.0), "",
                       found.row, element.line)]


def _records(found: _Network, element: Element, cluster: Element) -> Iterator[Record]:
    if element.tag == "point":
        key = _point(found, element, observed=True)
        given = {p: number(found, element, p) for p in "xyz" if p in element.attributes}
        kind = {"xyz": "coordinates", "xy": "plane coordinates", "z": "height"}.get("".join(given), "")
        found.observed[key] = given
        if not kind:
            raise found.wrong(element, f"'{key}' in <coordinates> has neither x and y nor z; give what was observed")
        yield _record(found, element, kind, (key, "", ""), tuple(given.values()), (None,) * len(given), mm, "m")
        return
    start = cluster.attributes.get("from", "")
    if element.tag == "vec":
        known(found, element, ("from", "to", "dx", "dy", "dz", "from_dh", "to_dh"))
        values = tuple(number(found, element, name) for name in ("dx", "dy", "dz"))
        ends = (key_of(found, element, "from"), key_of(found, element, "to"), "")
        yield _record(found, element, "vector", ends, values, (None,) * 3, mm, "m")
        return
    kind, names = READINGS[element.tag]
    known(found, element, names)
    if element.tag == "direction" and not start:
        raise found.wrong(cluster, "holds directions and does not say from which point; add from=...")
    back = ""
    if element.tag == "angle":
        back, target = key_of(found, element, "bs"), key_of(found, element, "fs")
    else:
        target = key_of(found, element, "to")
    ends = (key_of(found, element, "from", start), target, back)
    if len({*ends} - {""}) < (3 if back else 2):
        raise found.wrong(element, f"goes from point '{ends[0]}' to itself; correct the ids")
    if element.tag in ("direction", "azimuth", "angle", "z-angle"):
        value, unit = angle(found, element)
        scale = CC if unit == "gon" else arcsec
    else:
        value, unit, scale = number(found, element, "val"), "m", mm
        if "distance" in kind and value <= 0:
            raise found.wrong(element, f"val is {value:g} m; a distance is positive")
    u = _stated(found, element, value)
    yield _record(found, element, kind, ends, (value,), (None if u is None else u * scale,), scale, unit,
                  number(found, cluster, "from_dh", 0.0))


def _record(found: _Network, element: Element, kind: str, ends: tuple[str, str, str], values: tuple[float, ...],
            u: tuple[float | None, ...], scale: float, unit: str, from_dh: float = 0.0) -> Record:
    found.row += 1
    heights = (number(found, element, "from_dh", from_dh), number(found, element, "to_dh", 0.0))
    return Record(kind, ends, values, u, (scale,) * len(values), unit, heights, "", found.row, element.line)


def _stated(found: _Network, element: Element, value: float) -> float | None:
    """Standard deviation in mm, cc or arcseconds; None where nothing states it."""
    if "stdev" in element.attributes:
        return positive(found, element, "stdev", 0.0)
    if element.tag == "dh":
        return found.sigma * math.sqrt(positive(found, element, "dist", 0.0)) if "dist" in element.attributes else None
    text = found.defaults.get(DEFAULTS[element.tag])
    if text is None:
        return None
    try:
        constant, per_km, power = [*map(float, text.split()), *(0.0, 1.0)[max(0, len(text.split()) - 1):]][:3]
    except ValueError:
        name = DEFAULTS[element.tag]
        raise found.wrong(element, f"{name}='{text}' is not one to three numbers; correct it") from None
    return constant + per_km * (abs(value) / 1000.0) ** power if "distance" in element.tag else constant


def _taking_part(
    found: _Network, strict: bool
) -> tuple[list[tuple[list[Record], Array | None]], list[str]]:
    """The readings between points that have the coordinates they need, and sentences about the others."""
    kept: list[tuple[list[Record], Array | None]] = []
    left_out: dict[tuple[str, str, str], list[int]] = {}
    for records, covariance in found.clusters:
        stays = []
        for record in records:
            bad = ""
            if not record.ends[0]:      # it could not be read, and is remarked already
                stays.append(False)
                continue
            for key in filter(None, record.ends):
                if key not in found.points and strict:
                    near = units.near_matches(key, list(found.points))
                    hint = f"did you mean '{near[0]}'? Else " if near else ""
                    raise InputError(f"{found.path}, line {record.line}: there is no point '{key}'; {hint}add a "
                                     f"<point id='{key}'> with fix or adj, or leave such readings out "
                                     "(leave_out_weak, docs/networks.md)")
                if not found.points.get(key, Point()).has(KINDS[record.kind].needs):
                    bad = bad or key
            if bad:
                left_out.setdefault((bad, record.kind, KINDS[record.kind].needs), []).append(record.row)
            stays.append(not bad)
        inside = np.repeat(stays, [len(r.values) for r in records])
        kept.append(([r for r, s in zip(records, stays, strict=True) if s],
                     None if covariance is None else covariance[np.ix_(inside, inside)]))
    return kept, [
        f"{len(rows)} reading(s) of kind {kind} (row {', '.join(map(str, rows[:5]))}{' ...' if rows[5:] else ''}) "
        f"take no part: point '{key}' is neither fixed nor adjusted in {needs}; write fix or adj with {needs} to use "
        "them."
        for (key, kind, needs), rows in left_out.items()
    ]
