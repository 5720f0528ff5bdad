"""Aliases: effects that these readings cannot tell apart, effects that hide in the unknowns, and what would tell
them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.analyse.score import Candidate, Field, orthonormal
from calib.blocks import Array
from calib.linearisation import Linearisation

RAISES = 4.0  # expected rise of the sum of squares up to which another effect is an alias
PROPORTIONAL = 1e-9  # distance from it up to which two columns are proportional
RAISED = 1.0  # rise in these very readings up to which they leave open which of two it is


@dataclass(frozen=True)
class Hidden:
    """An effect that the unknowns absorb: what it could add to the uncertainty of a result if it were of usual size
    (SI)."""

    effect: str
    quantity: str
    u_added: float
    unit: str


def aliases(
    field: Field,
    chosen: Sequence[int],
    values: dict[int, Array],
    columns: Sequence[Array],
    positive: frozenset[int] = frozenset(),
    estimated: bool = True,
) -> dict[int, list[int]]:
    """For each chosen candidate the others that could stand in its place.

    field: nominal field; chosen: places of the chosen candidates; values: their parameters (k,) SI; columns: of all
    candidates (n, k) over all whitened rows; positive: places of those whose one parameter cannot be negative;
    estimated: whether the values are estimates or true. A stand-in raises the sum of squares by an expected 4 or less,
    or did raise it by so little that these readings do not choose between the two.
    """
    found: dict[int, list[int]] = {}
    for one in chosen:
        others = [columns[c] for c in chosen if c != one]
        frame = np.zeros((len(field.residual), 0))
        if others:
            together = np.concatenate(others, axis=1)
            frame = orthonormal(field.outside(together), np.linalg.norm(together, axis=0))
        bare = field.taking(frame)
        own = bare.outside(columns[one])
        signal = own @ values[one]
        directions = orthonormal(own, field.sizes[one])
        found[one] = []
        for other in range(len(columns)):
            if other in chosen or not field.frames[other].shape[1]:
                continue
            seen = bare.outside(columns[other])
            if other in positive and seen[:, 0] @ signal <= 0:
                continue
            stand_in = orthonormal(seen, field.sizes[other])
            left = signal - stand_in @ (stand_in.T @ signal)
            # The estimate holds noise of its own, one unit for each direction that the other does not share.
            noise = directions.shape[1] - float(np.sum((stand_in.T @ directions) ** 2))
            expected = float(left @ left) - estimated * noise
            raised = float(np.sum((directions.T @ bare.residual) ** 2) - np.sum((stand_in.T @ bare.residual) ** 2))
            if expected <= RAISES or (estimated and raised <= RAISED):
                found[one].append(other)
    return found


def hidden(fit: Linearisation, field: Field, candidates: Sequence[Candidate]) -> list[Hidden]:
    """Candidates that no reading shows, with what one of usual size would do to the results."""
    unseen = [c for c, frame in zip(candidates, field.frames, strict=True) if not frame.shape[1]]
    if not unseen or not fit.results:
        return []
    functions = fit.functions()
    derivatives, _ = fit.rows
    found = []
    for one in unseen:
        columns = fit.held_columns(one.columns)
        if not np.any(columns):
            continue
        moved = -fit.factor.solve(np.asarray(derivatives.T @ columns))
        change = functions.derivatives[:, list(one.columns)] + fit.free_part(functions.derivatives) @ moved
        usual = np.array(
            [
                np.sqrt(p.plausible[0] * p.plausible[1]) if p.plausible[0] > 0 else 0.5 * p.plausible[1]
                for p in one.effect.parameters
            ]
        )
        added = np.sqrt(np.sum((change * usual) ** 2, axis=1))
        u = np.sqrt(np.diag(fit.factor.covariance(fit.free_part(functions.derivatives))))
        found += [
            Hidden(one.label, name, float(a), unit)
            for name, unit, a, own in zip(functions.labels, functions.units, added, u, strict=True)
            if a > 1e-3 * own
        ]
    return found


def what_would_tell(one: Candidate, others: Sequence[Candidate], alike: Sequence[bool]) -> str:
    """A measurement that tells an effect from its aliases, in a sentence.

    alike: of each alias, whether it changes every reading in proportion to the effect.
    """
    mine = set(one.effect.inputs)
    advice = []
    for other, same in zip(others, alike, strict=True):
        theirs = set(other.effect.inputs)
        only = sorted((mine - theirs) or (theirs - mine))
        if only:
            rest = sorted((theirs if mine - theirs else mine) - set(only))
            advice.append(
                f"vary {' and '.join(w.replace('_', ' ') for w in only)}"
                + (f" independently of {' and '.join(w.replace('_', ' ') for w in rest)}" if rest else "")
                + f" to tell {one.label} from {other.label}"
            )
        elif same:
            advice.append(f"no reading of this kind tells {one.label} from {other.label}: measure one of them directly")
        else:
            advice.append(f"read more positions over a wider range to tell {one.label} from {other.label}")
    return "; ".join(dict.fromkeys(advice))


def proportional(one: Array, other: Array) -> bool:
    """Whether two sets of columns (n, k) span the same directions to rounding."""
    first, second = (orthonormal(c, np.linalg.norm(c, axis=0)) for c in (one, other))
    if first.shape[1] != second.shape[1] or not first.shape[1]:
        return False
    return bool(np.linalg.svd(first.T @ second, compute_uv=False)[-1] > 1 - PROPORTIONAL)
