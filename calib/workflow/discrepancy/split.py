"""Which rows of a job are held out to judge the gap."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calib.job import Job
from calib.problem import Problem

EVERY = 5  # of the rows of a job without a column `split`, one in five is held out
PER_UNKNOWN = 2  # scalar readings for each unknown that must stay in the fit
FIT, CHECK = "fit", "check"
ONLY_FIT = "the gap is judged on the rows of the fit only."


def held_out_rows(job: Job, problem: Problem) -> tuple[dict[str, NDArray[np.bool_]], tuple[str, ...]]:
    """Rows held out, {group: (n,) true where held out}, and in sentences why there are none or what is not understood.

    job: rows marked `check` in a column `split` of a table are held out; without the column every fifth row is, where
    enough readings remain; problem: of the job.
    """
    observed = [o for o in problem.observations if not o.is_prior and o.readings is not None]
    split = [(int(row), word) for table in job.tables.values() if table.has("split")
             for row, word in zip(table.row_numbers, table.text("split"), strict=True)]
    if split:
        rows = [row for row, word in split if word == CHECK]
        check = {o.group: np.asarray(o.covariates["split"] == CHECK) if "split" in o.covariates
                 else np.isin(o.rows, rows) for o in observed}
        strange = sorted({word for _, word in split} - {FIT, CHECK})
        words = tuple(f"In the column `split` stands '{word}', which is neither `fit` nor `check`: such rows count as "
                      "`fit`." for word in strange)
        if all(mask.all() for mask in check.values()):
            return {}, (*words, f"Every row is marked `check`, so that none is left to adjust on: {ONLY_FIT} Mark as "
                                "`fit` those that the model may be adjusted to.")
        if any(mask.any() for mask in check.values()):
            return check, words
        return {}, (*words, f"No row is marked `check`, so {ONLY_FIT}")
    unknowns = sum(int(np.sum(~problem.is_held(u))) for u in problem.unknowns)
    readings = sum(o.readings.size for o in observed if o.readings is not None)
    if readings * (1 - 1 / EVERY) < PER_UNKNOWN * unknowns:
        return {}, (f"{readings} readings for {unknowns} unknowns are too few to hold any out: {ONLY_FIT} Read further "
                    "positions, and mark them `check` in a column `split`.",)
    return {o.group: np.arange(o.n) % EVERY == EVERY // 2 for o in observed}, ()
