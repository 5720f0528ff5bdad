"""What is wrong with a survey before anything is solved: each finding names points, what they lack, and a cure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib import predict
from calib.errors import InputError
from problems.network.declare import declare_free
from problems.network.frames import MOVES, checked_frames, everywhere, places_taken, unrolled
from problems.network.lacking import Contradicting, Lacking
from problems.network.measures import contradicting_unit
from problems.network.start import positions
from problems.network.survey import ADJUSTED, CONSTRAINED, FIXED, Survey

GROSS = 0.3      # misfit of a start, in radians or relative to the length, that no reading can have
LENGTHS = ("distance", "slope distance", "scale bar")
LISTED = 6


def named(keys: list[str]) -> str:
    """Keys of points as people list them."""
    return ", ".join(f"'{key}'" for key in keys[:LISTED]) + (f" and {len(keys) - LISTED} more" if keys[LISTED:] else "")


def checked(survey: Survey) -> Survey:
    """The survey, with remarks about points, and coordinates of points, that nothing reads.

    Raises InputError where parts of the network are not joined, points or frames have fewer readings than unknown
    coordinates, frames make no sense together, or lengths contradict the coordinates by their unit.
    """
    survey = _without_unread(_with_frames_read(survey))
    _apart(survey)
    _somewhere(survey)
    _joined(survey)
    _enough(survey)
    _frames_read(survey)
    read = survey.read
    unread = [key for key, point in survey.points.items()
              if {ADJUSTED, CONSTRAINED} & {point.plane, point.height} and key not in read]
    if unread:
        survey = replace(survey, remarks=(
            *survey.remarks, f"Point {named(unread)} is to be adjusted and nothing reads it: it has no result. Add "
            "readings to it, or take it out of the list of points."))
    return survey


def _with_frames_read(survey: Survey) -> Survey:
    """The survey without epochs of frames that nothing reads."""
    if not survey.frames:
        return survey
    survey = replace(survey, frames=checked_frames(survey.frames, survey.parts))
    used = {i for _, inside in places_taken(survey).values() for i in inside}
    idle = [one.key for i, one in enumerate(survey.frames) if i not in used and one.free]
    remarks = [f"Frame {named(idle)} is free to move and nothing reads a point of it: it has no result. Add readings, "
               "or take it out of the frames."] if idle else []
    return replace(survey, frames=[one for i, one in enumerate(survey.frames) if i in used],
                   remarks=(*survey.remarks, *remarks))


def _without_unread(survey: Survey) -> Survey:
    """The survey without coordinates to be adjusted that no reading of their point depends on."""
    in_space = [key for one in survey.sightings for key in one.targets]
    in_space += [key for one in survey.ranging for key in one.targets]
    needed: dict[str, set[str]] = {key: set("xyz") for key in in_space}
    for batch in survey.every_batch:
        for key in {key for keys in batch.ends for key in keys.tolist()}:
            needed.setdefault(key, set()).update(batch.model.needs)
    points, unread = dict(survey.points), {"xy": list[str](), "z": list[str]()}
    for key, parts in needed.items():
        point = points[key]
        if "z" not in parts and point.height in (ADJUSTED, CONSTRAINED) and point.plane:
            points[key] = replace(point, height="")
            unread["z"].append(key)
        elif "x" not in parts and point.plane in (ADJUSTED, CONSTRAINED) and point.height:
            points[key] = replace(point, plane="")
            unread["xy"].append(key)
    remarks = [f"Point {named(keys)} is to be adjusted in {parts} and no reading depends on that: it has no {parts} in "
               "the result. Add readings that do, or take it out of adj." for parts, keys in unread.items() if keys]
    return replace(survey, points=points, remarks=(*survey.remarks, *remarks)) if remarks else survey


def _readings_of(survey: Survey) -> dict[str, int]:
    """Number of scalar readings that see each point; the first direction of a setting goes into its orientation."""
    count: dict[str, int] = {}
    for batch in survey.every_batch:
        dim = len(batch.model.components)
        for keys in batch.ends:
            for key, times in zip(*np.unique(keys, return_counts=True), strict=True):
                count[str(key)] = count.get(str(key), 0) + int(times) * dim
        if batch.kind == "direction":
            settings = np.asarray(batch.orientation).astype(str).tolist()
            for station in dict(zip(settings, batch.ends[0].tolist(), strict=True)).values():
                count[station] -= 1
    seen = [(one.target, 3) for one in survey.sightings] + [(one.target, 1) for one in survey.ranging]
    for targets, dim in seen:
        for key, times in zip(*np.unique(np.asarray(targets).astype(str), return_counts=True), strict=True):
            count[str(key)] = count.get(str(key), 0) + int(times) * dim
    return count


def _enough(survey: Survey) -> None:
    parts = survey.parts
    for key, count in _readings_of(survey).items():
        point = survey.points[key]
        free = [part for part in parts if point.role(part) in (ADJUSTED, CONSTRAINED)]
        if count < len(free):
            raise Lacking(f"point '{key}' has {len(free)} unknown coordinates ({', '.join(free)}) and {count} "
                          f"reading{'' if count == 1 else 's'} for them; it lacks {len(free) - count}: read it from "
                          "another station, or give its coordinates", everywhere(survey, [key]))


def _frames_read(survey: Survey) -> None:
    """Every frame needs as many readings to its points as it has free numbers."""
    whole = _readings_of(unrolled(survey)) if survey.frames else {}
    count = dict.fromkeys(range(len(survey.frames)), 0)
    members: dict[int, list[str]] = {i: [] for i in count}
    for name, (_, inside) in places_taken(survey).items():
        for i in inside:
            count[i] += whole.get(name, 0)
            members[i].append(name)
    for i, one in enumerate(survey.frames):
        if count[i] < len(one.free):
            raise Lacking(f"frame '{one.key}' has {len(one.free)} free numbers ({', '.join(one.free)}) and {count[i]} "
                          f"readings to its points; it lacks {len(one.free) - count[i]}: read more of its points, or "
                          "hold what does not move", members[i])


def _apart(survey: Survey) -> None:
    """No reading leads from a point to itself."""
    for batch in survey.every_batch:
        for other in batch.ends[1:]:
            for row in np.flatnonzero(batch.ends[0] == other)[:1]:
                raise InputError(f"row {batch.numbers[row]} of '{batch.group or batch.kind}' reads point "
                                 f"'{other[row]}' from itself; correct one of the two names, or take the row out")


def _somewhere(survey: Survey) -> None:
    """What is fixed has coordinates."""
    read = survey.read
    for key, point in survey.points.items():
        missing = [part for part in survey.parts
                   if point.role(part) == FIXED and np.isnan(point.position["xyz".index(part)])]
        if missing and key in read:
            raise Lacking(f"point '{key}' is fixed and has no {' and no '.join(missing)}; give its coordinates, or let "
                          "it be adjusted", everywhere(survey, [key]))


def _joined(survey: Survey) -> None:
    """Every point must hang together with the datum: fixed points, observed coordinates, or one free whole."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    place = {key: i + 1 for i, key in enumerate(survey.points)}          # 0 stands for the datum
    links: list[tuple[int, int]] = []
    parts = survey.parts
    for key, point in survey.points.items():
        if FIXED in {point.role(part) for part in parts}:
            links.append((0, place[key]))
    for batch in survey.every_batch:
        ends = [[place[key] for key in keys.tolist()] for keys in batch.ends]
        links += [(0, i) for i in ends[0]] if len(ends) == 1 else []
        for other in ends[1:]:
            links += list(zip(ends[0], other, strict=True))
    number = {i: len(place) + 1 + i for i in range(len(survey.frames))}
    for key, inside in places_taken(survey).values():
        links += [(place[key], number[i]) for i in inside]
        # A frame that cannot move in every way is tied to the network.
        links += [(0, number[i]) for i in inside[-1:] if set(survey.frames[i].free) < set(MOVES[parts])]
    instruments = [(s.station, s.target) for s in survey.sightings] + [(r.instrument, r.target) for r in survey.ranging]
    for of, targets in instruments:                        # an instrument joins its targets, as a node of its own
        node: dict[str, int] = {}
        for key, target in zip(*(np.asarray(k).astype(str).tolist() for k in (of, targets)), strict=True):
            links.append((node.setdefault(key, place[target]), place[target]))
    if not links:
        return
    i, j = np.array(links).T
    size = len(place) + 1 + len(number)
    label = connected_components(coo_matrix((np.ones(len(i)), (i, j)), (size, size)), directed=False)[1]
    sets: dict[int, list[str]] = {}
    for key in sorted(survey.read):
        sets.setdefault(int(label[place[key]]), []).append(key)
    anchored = label[0] in sets
    alone = {k: keys for k, keys in sets.items() if k != label[0]} if anchored else sets
    if len(alone) > (0 if anchored else 1):
        smallest = min(alone.values(), key=len)
        rest = "to the fixed points" if anchored else "to the rest"
        raise Lacking(f"the network falls apart: nothing joins {named(smallest)} {rest}; add readings between the two "
                      "parts, fix points in each, or adjust them one by one", everywhere(survey, smallest))


def started(survey: Survey) -> Survey:
    """The survey with a position for every point, and remarks where given positions were grossly wrong.

    Raises InputError where lengths and coordinates contradict each other in their unit, or a point cannot be placed.
    """
    placed = positions(survey)
    suspects = _gross(placed)
    if not suspects:
        return placed
    factor = _length_factor(placed)
    if factor is not None:
        raise Contradicting(
            f"the distances are {factor:.4g} times what the coordinates say: one of the two is not in metres; correct "
            "the unit of the distances or of the coordinates",
            [batch.group or batch.kind for batch in survey.batches if batch.kind in LENGTHS])
    fresh = {key: replace(point, position=(np.nan,) * 3)
             if FIXED not in (point.plane, point.height) else point for key, point in survey.points.items()}
    try:
        again = positions(replace(survey, points=fresh))
    except InputError:
        return placed
    left = len(_gross(again))
    if left > 1 and (error := contradicting_unit(survey, _gross, left)):
        raise error
    if left >= len(suspects):
        return placed
    scale = np.nanmax(np.ptp([p.position for p in again.points.values()], axis=0))
    moved = []
    for key, point in placed.points.items():
        apart = float(np.sqrt(np.nansum(np.subtract(point.position, again.points[key].position) ** 2)))
        if key in suspects and apart > 0.1 * scale:
            moved.append(f"'{key}' by {apart:.4g} m")
    if not moved:
        return placed
    return replace(again, remarks=(
        *survey.remarks, f"The given coordinates of {', '.join(moved[:LISTED])} lie far from where the readings put "
        "them; the adjustment started from the readings. Correct them, if they are more than start values."))


def _gross(survey: Survey) -> set[str]:
    """Adjusted points where the positions miss half of the readings by a large part of a radian or of a length.

    Where the other readings of a point fit, the one that does not is itself at fault.
    """
    problem = declare_free(survey)
    missed, count = dict[str, int](), dict[str, int]()
    predicted = predict(problem)
    for batch in survey.batches:
        values = batch.values
        if values is None or batch.model.points == 1 or batch.kind == "height difference" or not len(batch):
            continue
        miss = np.abs(values - predicted[batch.group or batch.kind])
        if batch.model.angular:
            miss = np.abs(miss - 2.0 * np.pi * np.rint(miss / (2.0 * np.pi)))
            gross = miss[:, 0] > GROSS
        else:
            gross = np.linalg.norm(miss, axis=1) > GROSS * np.linalg.norm(values, axis=1)
        for keys in batch.ends:
            for key, wrong in zip(keys.tolist(), gross.tolist(), strict=True):
                count[key], missed[key] = count.get(key, 0) + 1, missed.get(key, 0) + wrong
    return {key for key, wrong in missed.items() if wrong and 2 * wrong >= count[key]
            and {ADJUSTED, CONSTRAINED} & {survey.points[key].plane, survey.points[key].height}}


def _length_factor(survey: Survey) -> float | None:
    """By how much all distances differ from the coordinates, where it is the same large factor for most of them."""
    problem = declare_free(survey)
    predicted = predict(problem)
    ratios = np.concatenate([np.zeros(0), *(
        batch.values[:, 0] / predicted[batch.group or batch.kind][:, 0]
        for batch in survey.batches if batch.kind in LENGTHS and batch.values is not None
    )])
    if len(ratios) < 2:
        return None
    middle = float(np.median(ratios))
    alike = np.abs(ratios / middle - 1.0) < 0.05
    return middle if alike.mean() > 0.5 and not 1 / 1.5 < middle < 1.5 else None
