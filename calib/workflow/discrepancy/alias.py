"""Aliases: effects that these readings cannot tell apart, effects that hide in the unknowns, and what would tell
them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.analyse.score import Candidate, Field, orthonormal
from calib.blocks import Array
from calib.effect import Parameter
from calib.linearisation import Linearisation
from calib.unknown import Unknown

RAISES = 4.0  # expected rise of the sum of squares up to which another effect is an alias
FEW = 6  # instances up to which an unknown is a result, where no quantity is asked for
NOTICED = 0.1  # share of the standard uncertainty of a result from which a hidden effect is listed
PROPORTIONAL = 1e-9  # distance from it up to which two columns are proportional
RAISED = 0.5  # rise in these very readings up to which they leave open which of two it is: odds of 3 to 4 or better


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
            raised = float(np.sum((directions.T @ bare.residual) ** 2) - np.sum((stand_in.T @ bare.residual) ** 2))
            if left @ left <= RAISES or (estimated and raised <= RAISED):
                found[one].append(other)
    return found


def hidden(fit: Linearisation, field: Field, candidates: Sequence[Candidate]) -> list[Hidden]:
    """Candidates that would not show if they were of usual size, with what that would do to the results, worst first.

    The results are the quantities of the problem; where it has none, its shared unknowns.
    """
    what = () if fit.results else tuple(u for u in fit.layout.unknowns if u.count <= FEW and _is_free(fit, u))
    if not (what or fit.results):
        return []
    usual = [np.array([_usual(p) for p in one.effect.parameters]) for one in candidates]
    unseen = [i for i, signal in enumerate(field.signals) if float(np.sum((signal @ usual[i]) ** 2)) < RAISES]
    if not unseen:
        return []
    functions = fit.functions(*what)
    u = np.sqrt(np.maximum(np.diag(fit.factor.covariance(fit.free_part(functions.derivatives))), 1e-300))
    derivatives, _ = fit.rows
    columns = [c for i in unseen for c in candidates[i].columns]
    moved = -fit.factor.solve(np.asarray(derivatives.T @ fit.held_columns(columns)))
    changes = functions.derivatives[:, columns] + fit.free_part(functions.derivatives) @ moved
    found, begin = [], 0
    for i in unseen:
        one = candidates[i]
        change = changes[:, begin : begin + len(one.columns)]
        begin += len(one.columns)
        added = np.sqrt(np.sum((change * usual[i]) ** 2, axis=1))
        found += [
            (float(a / own), Hidden(one.label, name, float(a), unit))
            for name, unit, a, own in zip(functions.labels, functions.units, added, u, strict=True)
            if a > NOTICED * own
        ]
    return [one for _, one in sorted(found, key=lambda f: -f[0])]


def _is_free(fit: Linearisation, unknown: Unknown) -> bool:
    return bool(fit.layout.free[fit.layout.span(unknown)].any()) and unknown not in fit.effects.values()


def _usual(parameter: Parameter) -> float:
    """A size that is usual: the middle of what is plausible, on a logarithmic scale where that has a lower end."""
    low, high = parameter.plausible
    return float(np.sqrt(low * high)) if low > 0 else 0.5 * high


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
