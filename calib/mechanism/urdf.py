"""URDF: robot descriptions read into a mechanism, and identified geometry written back; XML entities are never
expanded."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.parsers import expat

import numpy as np

from calib import geometry
from calib.errors import InputError
from calib.geometry import Transform
from calib.mechanism.axis import Array, Axis, Frame, Linear, Load, Rotary
from calib.mechanism.chain import Mechanism

MIMIC = "mimic"
MOVING = ("revolute", "continuous", "prismatic")


@dataclass(frozen=True)
class Joint:
    """One joint of a description: name, kind, parent and child links, parent_from_joint, axis (3,), limits [rad or m],
    effort: its torque or force limit."""

    name: str
    kind: str
    parent: str
    child: str
    origin: Transform
    axis: Array
    limits: tuple[float, float]
    effort: float | None


@dataclass(frozen=True)
class Description:
    """A robot description: where it was read, its name, links, joints, weights {link: (mass, centre)} and the XML
    tree."""

    path: str
    name: str
    links: tuple[str, ...]
    joints: tuple[Joint, ...]
    weights: dict[str, tuple[float, Array]]
    tree: ElementTree.Element

    @property
    def root(self) -> str:
        """The link that is the child of no joint."""
        children = {j.child for j in self.joints}
        return next(link for link in self.links if link not in children)


def identifier(name: str) -> str:
    """A name with everything that is no letter, digit or _ replaced by _."""
    return re.sub(r"\W", "_", name) if re.sub(r"\W", "_", name)[:1].isalpha() else "_" + re.sub(r"\W", "_", name)


def frame_name(link: str, base: str) -> str:
    """Name of the frame of a link: its identifier, and `base_` for a link `base` that is not the base itself."""
    return "base_" if link == "base" != base else identifier(link)


def read(path: str | Path) -> Description:
    """Read a URDF file.

    Raises InputError for a file that is no XML or declares entities, a joint whose parent or child link does not exist,
    a link with two parents (a loop), several roots, an axis of zero length, or a kind of joint that is no single axis.
    """
    try:
        text = Path(path).read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check the path.") from None
    return parse(text, str(path))


def parse(text: bytes | str, where: str = "URDF") -> Description:
    """The description in a text; where: named in errors. Raises InputError as `read` does."""
    tree = _tree(text, where)
    if tree.tag != "robot":
        raise InputError(f"{where}: the root element is <{tree.tag}>, not <robot>; give a URDF (xacro files are "
                         "expanded first).")
    links = tuple(_attribute(e, "name", where, "a <link>") for e in tree.findall("link"))
    joints = tuple(_joint(e, where) for e in tree.findall("joint"))
    if not links:
        raise InputError(f"{where}: holds no <link>; give a complete URDF.")
    for joint in joints:
        for what, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in links:
                raise InputError(f"{where}: joint '{joint.name}' has the {what} link '{link}', which does not exist; "
                                 f"there are: {', '.join(links)}. Correct the name or add the link.")
    parents: dict[str, Joint] = {}
    for joint in joints:
        if joint.child in parents:
            raise InputError(f"{where}: link '{joint.child}' is carried by two joints, '{parents[joint.child].name}' "
                             f"and '{joint.name}'; a URDF is a tree. Leave one out and close the loop by a constraint "
                             "(calib.mechanism.loop).")
        parents[joint.child] = joint
    roots = [link for link in links if link not in parents]
    if len(roots) != 1:
        found = f"{len(roots)} links without a parent ({', '.join(roots)})" if roots else "no link without a parent"
        raise InputError(f"{where}: has {found}, where one root is needed; join the parts by a fixed joint.")
    weights = {}
    for element in tree.findall("link"):
        mass = element.find("inertial/mass")
        name = element.get("name", "")
        weight = 0.0 if mass is None else _number(mass, "value", where, f"the mass of link '{name}'")
        if weight > 0:
            weights[name] = (weight, np.asarray(_origin(element.find("inertial/origin"), where, name).translation))
    return Description(where, tree.get("name", "robot"), links, joints, weights, tree)


def _tree(text: bytes | str, where: str) -> ElementTree.Element:
    """The XML tree; a document type or an entity declaration is refused, so that nothing is ever expanded or
    fetched."""
    builder = ElementTree.TreeBuilder(insert_comments=True)
    parser = expat.ParserCreate()

    def refused(*_: Any) -> int:
        raise InputError(f"{where}: declares a document type or XML entities, which a URDF does not need and which "
                         "are never expanded here; take the <!DOCTYPE ...> out.")
    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = parser.ExternalEntityRefHandler = refused
    depth = [0]

    def start(tag: str, attributes: dict[str, str]) -> None:
        depth[0] += 1
        builder.start(tag, attributes)

    def end(tag: str) -> None:
        depth[0] -= 1
        builder.end(tag)

    def comment(words: str) -> None:
        if depth[0]:
            builder.comment(words)
    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler, parser.CommentHandler = builder.data, comment
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        raise InputError(f"{where}, line {error.lineno}: is not XML ({expat.ErrorString(error.code)}); correct that "
                         "line.") from None
    return builder.close()


def _attribute(element: ElementTree.Element | None, name: str, where: str, what: str) -> str:
    value = None if element is None else element.get(name)
    if not value:
        raise InputError(f"{where}: {what} has no {name}; add it.")
    return value


def _number(element: ElementTree.Element, name: str, where: str, what: str) -> float:
    text = element.get(name, "0")
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise InputError(f"{where}: {what} has {name} = '{text}', which is no number; correct it.")
    return value


def _three(text: str | None, default: str, where: str, what: str) -> Array:
    try:
        values = np.array([float(v) for v in (text or default).split()])
    except ValueError:
        values = np.zeros(0)
    if values.shape != (3,) or not np.all(np.isfinite(values)):
        raise InputError(f"{where}: {what} is '{text}', not three numbers; correct it.")
    return values


def _origin(element: ElementTree.Element | None, where: str, name: str) -> Transform:
    if element is None:
        return Transform.identity()
    shift = _three(element.get("xyz"), "0 0 0", where, f"the origin xyz of '{name}'")
    turn = _three(element.get("rpy"), "0 0 0", where, f"the origin rpy of '{name}'")
    return Transform(geometry.rotation_from_rpy(*turn), shift)


def _joint(element: ElementTree.Element, where: str) -> Joint:
    name = _attribute(element, "name", where, "a <joint>")
    kind = _attribute(element, "type", where, f"joint '{name}'")
    parent = _attribute(element.find("parent"), "link", where, f"joint '{name}': its <parent>")
    child = _attribute(element.find("child"), "link", where, f"joint '{name}': its <child>")
    if kind not in (*MOVING, "fixed"):
        raise InputError(f"{where}: joint '{name}' is of type '{kind}', which is no single axis; write it as several "
                         f"joints of the types {', '.join(MOVING)}.")
    found = element.find("axis")
    axis = _three(None if found is None else found.get("xyz"), "1 0 0", where, f"the axis of joint '{name}'")
    if kind != "fixed" and not np.linalg.norm(axis) > 1e-12:
        raise InputError(f"{where}: the axis of joint '{name}' has zero length; give its direction, such as 0 0 1.")
    limit, limits = element.find("limit"), (-np.inf, np.inf)
    if limit is not None and kind in ("revolute", "prismatic"):
        lower, upper = (_number(limit, side, where, f"the limit of joint '{name}'") for side in ("lower", "upper"))
        limits = (lower, upper)
        if not limits[0] < limits[1]:
            raise InputError(f"{where}: joint '{name}' has the limits {limits[0]:g} .. {limits[1]:g}; give lower "
                             "below upper.")
    if element.find("mimic") is not None:
        kind = MIMIC
    effort = None
    if limit is not None and limit.get("effort") is not None:
        effort = _number(limit, "effort", where, f"the limit of joint '{name}'")
    return Joint(name, kind, parent, child, _origin(element.find("origin"), where, name), axis, limits, effort)


def mechanism(description: Description, base: str | None = None, tip: str | None = None,
              down: Any = (0.0, 0.0, -1.0)) -> Mechanism:
    """The mechanism of a description: every moving joint an axis, every link a frame, every inertial a load.

    A frame is called as its link (see `frame_name`). base: link whose frame is the base (the root if not given); tip:
    only the axes between base and this link; down: (3,) plumb direction in the base frame. Errors are named by the axes
    of the joint's own frame.
    Raises InputError where base or tip is no link, or the base is not on the way to the tip.
    """
    by_child = {j.child: j for j in description.joints}
    base = base or description.root
    for what, link in (("base", base), ("tip", tip)):
        if link is not None and link not in description.links:
            raise InputError(f"{description.path}: has no link '{link}' to be the {what}; there are: "
                             f"{', '.join(description.links)}.")
    homes: dict[str, Transform] = {base: Transform.identity()}
    carriers: dict[str, str | None] = {base: None}
    axes: list[Axis] = []
    wanted = None if tip is None else _way(by_child, base, tip, description.path)
    waiting = [j for j in description.joints if wanted is None or j.name in wanted]
    while waiting:
        ready = [j for j in waiting if j.parent in homes]
        if not ready:
            break           # links above a base that is not the root
        for joint in ready:
            waiting.remove(joint)
            if joint.kind == MIMIC:
                raise InputError(f"{description.path}: joint '{joint.name}' mimics another, and a mechanism has no "
                                 "coupled axes; name a tip that it does not carry, or make it a joint of its own.")
            home = homes[joint.parent] @ joint.origin
            homes[joint.child], carriers[joint.child] = home, carriers[joint.parent]
            if joint.kind in MOVING:
                along = np.abs(joint.axis) / np.linalg.norm(joint.axis)
                kind = Linear if joint.kind == "prismatic" else Rotary
                axes.append(kind(identifier(joint.name), home.turn(joint.axis), home.translation,
                                 carriers[joint.parent],
                                 joint.limits, home.rotation if along.max() > 1 - 1e-9 else None))
                carriers[joint.child] = identifier(joint.name)
    frames = [Frame(frame_name(link, base), home.translation, home.rotation, carriers[link])
              for link, home in homes.items()]
    loads = [Load(identifier(link), homes[link] @ centre, carrier, mass)
             for link, (mass, centre) in description.weights.items()
             if link in homes and (carrier := carriers[link]) is not None]
    return Mechanism(description.name, axes, frames, loads, down)


def _way(by_child: dict[str, Joint], base: str, tip: str, where: str) -> set[str]:
    names, link = set(), tip
    while link != base:
        if link not in by_child:
            raise InputError(f"{where}: link '{tip}' is not carried by '{base}'; give as base a link on the way to it.")
        names.add(by_child[link].name)
        link = by_child[link].parent
    return names


def written(description: Description, identified: Mechanism, base: str | None = None) -> str:
    """The URDF text with the origins of an identified mechanism (see `calib.mechanism.identified`); all else is kept.

    description: as read; identified: of the same axes and frames; base: as of `mechanism`. Returns the text.
    """
    import copy
    base = base or description.root
    tree = copy.deepcopy(description.tree)
    homes = {f.name: f.home for f in identified.frames}
    elements = {e.get("name"): e for e in tree.findall("joint")}
    for joint in description.joints:
        parent, child = (homes.get(frame_name(link, base)) for link in (joint.parent, joint.child))
        if parent is None or child is None:
            continue
        origin = parent.inverse() @ child
        element = elements[joint.name].find("origin")
        if element is None:
            element = ElementTree.SubElement(elements[joint.name], "origin")
        element.set("xyz", " ".join(repr(float(v)) for v in origin.translation))
        element.set("rpy", " ".join(repr(float(v)) for v in geometry.rpy_from_rotation(origin.rotation)))
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(tree, encoding="unicode") + "\n"
