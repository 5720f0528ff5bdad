"""Survey networks: points and instruments that see one another, adjusted together, with any datum.

Distances, directions, angles, azimuths, zenith angles, height differences, vectors and coordinates, with full
covariance; scale bars and inclinations; laser trackers with six degrees of freedom, and interferometers of unknown base
point; frames that move rigidly. Points are fixed, adjusted, or the constrained ones of a free network. Reads the .gkf
files of GNU Gama and tables. Start values, if none are given, are found from the readings.
"""

from __future__ import annotations

import numpy as np

from calib import Effect, Linearisation, Problem, reliability
from calib.errors import InputError
from calib.job import Job
from problems.network import frames
from problems.network.blunders import blunders
from problems.network.checks import checked, started
from problems.network.declare import declare, settle
from problems.network.described import columns, options
from problems.network.effects import effects, with_candidates
from problems.network.epochs import by_epoch, compare_epochs
from problems.network.example import example, example_job
from problems.network.figures import result_tables
from problems.network.gkf import read_gkf
from problems.network.measures import fitting_unit
from problems.network.reduction import LEAVE_OUT, reduced
from problems.network.scene import scene
from problems.network.start import positions
from problems.network.stations import Ranging, Sightings
from problems.network.survey import Batch, Correlated, Point, Survey
from problems.network.tables import read_tables
from problems.network.tolerance import tolerable

accepts = ("problems.network", "network", ".gkf")
named_by_key = ("point",)
REST = {"lacking", "unreadable", "duplicated"}    # without which a .gkf is read as it stands or not at all
BLUNDER = 0.05    # of v'Pv may be left where the worst reading is taken out
source = "GNU Gama manual; Baarda (1968), reliability; Meissl (1962), free networks"


_latest: list[tuple[Job, Survey]] = []     # a network is read once for its problem and for its remarks


def surveyed(job: Job) -> Survey:
    """The survey of a .gkf file or of a job with tables, checked, with a position for every point."""
    if not any(of is job for of, _ in _latest):
        _latest[:] = [(job, _surveyed(job))]
    return _latest[0][1]


def _surveyed(job: Job) -> Survey:
    file = job.path.name if job.path.suffix == ".gkf" else job.options.text("network", "")
    allowed = _allowed(job) if job.path.suffix != ".gkf" else set()
    if file:
        return tolerable(reduced(read_gkf(job.path.parent / file, strict=not allowed & REST), allowed))
    return reduced(read_tables(job, allowed), allowed)


def _allowed(job: Job) -> set[str]:
    """What the options of a job let us leave out."""
    wanted = set(job.options.texts("leave_out", ()))
    wanted |= {"lacking"} if job.options.flag("leave_out_weak", False) else set()
    strange = sorted(wanted - set(LEAVE_OUT))
    if strange:
        raise InputError(f"{job.options.where('leave_out')}: '{strange[0]}' cannot be left out"
                         f"{frames.near(strange[0], set(LEAVE_OUT))}")
    return wanted


def from_job(job: Job) -> Problem:
    """Declare the network of a .gkf file or of a job with tables, with the effects that its instruments may have.

    [instruments.NAME] of a table states u, as "1 mm + 2 ppm" of lengths or "2 arcsec + 0.01 arcsec/m" of angles;
    station_centring and target_centring, lengths that count across a sight and along a distance; and pointing of
    angles: a length at the target ("0.3 mm", seen at its distance), an angle, or an angle per length. They add in
    squares. Points of a frame ([data.frames]) move rigidly with it, from epoch to epoch, in what is free of it; where
    they then stand in the network is the result `position`.
    Raises InputError naming points and what they lack, where the network cannot be adjusted.
    """
    problem = with_candidates(declare(settle(surveyed(job))))
    wanted = job.options.texts("free", ()) if job.path.suffix != ".gkf" else ()
    return problem.free(*(effect for name in wanted for effect in _named(problem, name, job)))


def _named(problem: Problem, name: str, job: Job) -> list[Effect]:
    """The effects of a name: the label of one, or the name that several instruments share."""
    found = [one for one in problem.effects if name == one.label]
    found = found or [one for one in problem.effects if name == one.name]
    if not found:
        raise InputError(f"{job.options.where('free')}: no instrument of this network has the constant '{name}'"
                         f"{frames.near(name, {text for one in problem.effects for text in (one.name, one.label)})}")
    return found


def remarks(job: Job) -> list[str]:
    """What was left out or taken otherwise than it was written, as sentences."""
    return list(surveyed(job).remarks)


def advice(fit: Linearisation) -> list[str]:
    """What to adjust: readings that do not belong, and a unit that no network fits; the worst first."""
    found = blunders(fit)
    own = [survey for _, survey in _latest if {batch.group or batch.kind for batch in survey.batches}
           <= {group.name for group in fit.groups}]      # a problem need not come from a job
    tests = reliability(fit) if found else None
    # One blunder explains all that is wrong: no unit needs to.
    single = tests is not None and fit.objective - np.nanmax(tests.w**2) < BLUNDER * fit.objective
    unit = fitting_unit(own[0], fit.objective, fit.dof) if found and own and not single else None
    return [f"{str(unit)[0].upper()}{str(unit)[1:]}."] if unit else found


def absent(job: Job) -> set[str]:
    """Labels of the coordinates that points of the network do not have: no reading depends on them."""
    survey = surveyed(job)
    return {f"point[{key}].{part}" for key, point in survey.points.items() for part in survey.parts
            if not point.role(part) and np.isnan(point.position["xyz".index(part)])}


__all__ = [
    "Batch",
    "Correlated",
    "Point",
    "Ranging",
    "Sightings",
    "Survey",
    "absent",
    "advice",
    "by_epoch",
    "checked",
    "columns",
    "compare_epochs",
    "declare",
    "effects",
    "example",
    "example_job",
    "from_job",
    "options",
    "positions",
    "read_gkf",
    "read_tables",
    "reduced",
    "remarks",
    "result_tables",
    "scene",
    "settle",
    "started",
    "surveyed",
    "tolerable",
    "with_candidates",
]
