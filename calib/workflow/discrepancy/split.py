"""Which rows of a job are held out to judge the gap."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calib.job import Job
from calib.problem import Problem

EVERY = 5  # of the rows of a job without a column `split`, one in five is held out
PER_UNKNOWN = 2  # scalar readings for each unknown that must stay in the fit


def held_out_rows(job: Job, problem: Problem) -> tuple[dict[str, NDArray[np.bool_]], str]:
    """Rows held out, {group: (n,) true where held out}, and a sentence where there are none.

    job: rows marked `check` in a column `split` of a table are held out; without the column every fifth row is, where
    enough readings remain; problem: of the job.
    """
    observed = [o for o in problem.observations if not o.is_prior and o.readings is not None]
    if any(table.has("split") for table in job.tables.values()):
        rows = {int(row) for table in job.tables.values() if table.has("split")
                for row, split in zip(table.row_numbers, table.text("split"), strict=True) if split == "check"}
        check = {o.group: np.asarray(o.covariates["split"] == "check") if "split" in o.covariates
                 else np.isin(o.rows, list(rows)) for o in observed}
        if all(mask.all() for mask in check.values()):
            return {}, ("Every row is marked `check`, so that none is left to adjust on: the gap is judged on the rows "
                        "of the fit only. Mark as `fit` those that the model may be adjusted to.")
        if any(mask.any() for mask in check.values()):
            return check, ""
        return {}, "No row is marked `check`, so the gap is judged on the rows of the fit only."
    unknowns = sum(int(np.sum(~problem.is_held(u))) for u in problem.unknowns)
    readings = sum(o.readings.size for o in observed if o.readings is not None)
    if readings * (1 - 1 / EVERY) < PER_UNKNOWN * unknowns:
        return {}, (f"{readings} readings for {unknowns} unknowns are too few to hold any out: the gap is judged on "
                    "the rows of the fit only. Read further positions, and mark them `check` in a column `split`.")
    return {o.group: np.arange(o.n) % EVERY == EVERY // 2 for o in observed}, ""
