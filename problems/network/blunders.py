"""Readings that do not belong: which one, by how much, and what to do with it."""

from __future__ import annotations

import numpy as np

from calib import Linearisation, reliability, units

LARGEST = 200_000    # scalar readings up to which every report looks for blunders
CHANCE = 0.001       # that any reading of a network without blunders is named


def worst_reading(fit: Linearisation) -> tuple[str, int, str] | None:
    """Group, row and description of the reading that is most surely a blunder; None where none is."""
    if (found := blunders(fit)):
        tests = reliability(fit)
        i = int(np.nanargmax(np.abs(tests.w)))
        return str(tests.group[i]), int(tests.row[i]), found[0]
    return None


def blunders(fit: Linearisation) -> list[str]:
    """Sentences about readings whose residual no random error explains, the worst first; at most three.

    One blunder disturbs its neighbours: only the worst reading is sure, the others may be right.
    """
    if sum(group.size for group in fit.groups) > LARGEST:
        return []
    tests = reliability(fit)
    worst = np.argsort(-np.abs(tests.w))[:3]
    found: list[str] = []
    for i in worst[tests.p_value[worst] * len(tests) < CHANCE]:
        group = fit.group(str(tests.group[i]))
        row = int(np.flatnonzero(group.rows == tests.row[i])[0])
        ends = [str(group.covariates[name][row]) for name in ("station", "target") if name in group.covariates]
        size = units.from_si(tests.residual[i] / max(tests.redundancy[i], 1e-12), str(tests.unit[i]))
        component = f", {tests.component[i]}" if tests.component[i] else ""
        words = f"{tests.group[i]} {' to '.join(ends)}".strip() + component
        found.append(
            f"Row {tests.row[i]} ({words}) is off by about {size:.3g} {tests.unit[i]} (w = {tests.w[i]:.1f}): check "
            "it, read it again, or leave it out with a reason." if not found else
            f"Row {tests.row[i]} ({words}, w = {tests.w[i]:.1f}) may only follow from that one."
        )
    return found
