"""What was written down beside each reading and drives effects, by the names that `instruments.influence` gives it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from calib.job import Job
    from calib.table import Table

WHOLE = ("direction", "block", "sweep", "setup", "repeat")
NORMAL = 293.15     # K, the reference temperature of ISO 1


def recorded(job: Job, table: Table) -> dict[str, Any]:
    """Covariates of the rows of a table, those that it has: {name: (n,) values, or (values, display unit)}.

    Columns: time, from the first reading of the job; temp or temperature, as `temperature_difference` from
    reference_temperature of [known] or [options] (20 degC); direction, block, sweep, setup, repeat.
    """
    found: dict[str, Any] = {}
    if table.has("time"):
        times = [one.number("time", "time") for one in job.tables.values() if one.has("time")]
        found["time"] = (table.number("time", "time") - min(float(t.min()) for t in times if len(t)), "min")
    for name in ("temp", "temperature"):
        if table.has(name):
            stated = job.options.quantity("reference_temperature", "temperature", NORMAL)
            reference = job.known.quantity("reference_temperature", "temperature", stated)
            found["temperature_difference"] = (table.number(name, "temperature") - reference, "K")
    return found | {name: table.whole(name) for name in WHOLE if table.has(name)}
