"""Candidate observations: groups of whitened rows in coordinates in which all of them together weigh one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib import units
from calib.blocks import Array
from calib.defect import defect_in_words
from calib.errors import InputError, RankDefect
from calib.factor import DenseFactor
from calib.linearisation import Functions, Linearisation
from calib.observations import Observations

Index = NDArray[np.int64]
ALONE = 1e-12     # of all information together: what is below no choice can see


@dataclass(frozen=True)
class Candidates:
    """n candidates of one linearisation.

    labels: (n,) in the user's words; members: {group: (rows of the group,) number of the candidate, -1 where fixed};
    rows: (n, m, p) whitened derivatives, padded with zeros, in coordinates in which all information together is the
    identity; fixed: (p, p) information that is always there; root: (free columns, p) from these coordinates;
    shared: (free columns,) columns that not one candidate alone sees; log_scale: log det of the information of the
    coordinates themselves; readings: (n,) scalar readings.
    """

    fit: Linearisation
    labels: tuple[str, ...]
    members: Mapping[str, Index]
    rows: Array
    fixed: Array
    root: Array
    shared: NDArray[np.bool_]
    log_scale: float
    readings: Index

    def __len__(self) -> int:
        return len(self.labels)

    @property
    def rank(self) -> int:
        """Number of unknowns that all candidates together determine."""
        return self.root.shape[1]

    def information(self, weights: Array) -> Array:
        """Information (p, p) of candidates with weights (n,)."""
        used = np.flatnonzero(weights)
        flat = self.rows[used].reshape(-1, self.rank)
        return self.fixed + flat.T @ (flat * np.repeat(weights[used], self.rows.shape[1])[:, None])

    def functions(self, functions: Functions) -> Array:
        """Linear functions (k, p) of these coordinates, in their display units."""
        scale = np.array([units.factor(unit) for unit in functions.units])
        return self.fit.free_part(functions.derivatives) @ self.root / scale[:, None]

    def unseen(self, chosen: Sequence[int]) -> list[str]:
        """Directions that a choice leaves unseen, each a sentence in the user's words."""
        values, vectors = np.linalg.eigh(self.information(self.indicator(chosen)))
        null = self.root @ vectors[:, values < ALONE]
        if not null.shape[1]:
            return []
        null[np.abs(null) < 1e-9 * np.abs(null).max(axis=0)] = 0.0
        derivatives = self.rows.reshape(-1, self.rank) @ np.linalg.pinv(self.root)
        size = np.linalg.norm(derivatives, axis=0)
        return defect_in_words(self.fit.layout, null, np.where(size > 0, size, 1.0))

    def indicator(self, chosen: Sequence[int]) -> Array:
        """Weights (n,): one where chosen."""
        weights = np.zeros(len(self))
        weights[list(chosen)] = 1.0
        return weights

    def rows_of(self, chosen: Sequence[int]) -> dict[str, Index]:
        """Row numbers of the data file of a choice, by group."""
        taken = {name: np.isin(numbers, list(chosen)) for name, numbers in self.members.items()}
        return {name: self.fit.group(name).rows[mask] for name, mask in taken.items() if mask.any()}

    def masks(self, chosen: Sequence[int]) -> dict[str, NDArray[np.bool_]]:
        """{group: which rows stay} of a choice, for `Problem.keep`: the chosen rows and those that are always there."""
        return {name: np.isin(numbers, [*chosen, -1]) for name, numbers in self.members.items()}


def candidates_of(fit: Linearisation, by: Any = None, always: Any = (), asked: Functions | None = None) -> Candidates:
    """Group the observations of a linearisation into candidates.

    by: None for a candidate each row, "row" where rows of one number belong together, the name of a covariate (or
    names), "group", or {group: (n,) keys}; always: names of groups, or {group: row numbers}, that are there in any
    case (as priors are); asked: functions that must stay visible.
    Raises InputError where the grouping does not fit, RankDefect where all candidates together see nothing of the
    unknowns.
    """
    members, labels = _grouping(fit, by, _always(fit, always))
    if not labels:
        raise InputError(f"{fit.name}: every observation is fixed, none is left to choose; take a group out of "
                         "`always`")
    stacked, owner = _stacked(fit, members)
    shared = _shared(fit, stacked, owner, asked)
    stacked = _without_private(stacked, owner, shared, len(labels))
    conditions = fit.conditions
    kept = type(conditions)(conditions.matrix[:, shared], conditions.target)
    factor = DenseFactor(stacked, np.zeros(len(stacked)), kept)
    if not factor.rank:
        raise RankDefect(f"{fit.name}: the candidates see none of the free unknowns; add observations that do, or free "
                         "what they see")
    turned = stacked @ factor.root
    root = np.zeros((len(shared), factor.rank))
    root[shared] = factor.root
    own = turned[owner < 0]
    readings = np.zeros(len(labels), dtype=np.int64)
    for name, numbers in members.items():
        readings += np.bincount(numbers[numbers >= 0], minlength=len(labels)) * fit.group(name).residual.shape[1]
    return Candidates(fit, tuple(labels), members, _padded(turned[owner >= 0], owner[owner >= 0], len(labels)),
                      own.T @ own, root, shared, -2.0 * float(np.sum(np.log(np.linalg.svd(factor.root, compute_uv=False)
                                                                            ))), readings)


def _always(fit: Linearisation, always: Any) -> dict[str, NDArray[np.bool_]]:
    """{group: which of its rows are fixed}."""
    if isinstance(always, (str, Observations)):
        always = (always,)
    named = dict(always) if isinstance(always, Mapping) else dict.fromkeys(always)
    fixed = {}
    for key, rows in named.items():
        group = fit.group(key.group if isinstance(key, Observations) else key)
        if rows is None:
            fixed[group.name] = np.ones(len(group.rows), dtype=bool)
            continue
        wanted = np.atleast_1d(np.asarray(rows))
        strange = [str(one) for one in wanted if one not in group.rows]
        if strange:
            raise InputError(f"always: '{group.name}' has no row {strange[0]}; its rows are {group.rows[0]} to "
                             f"{group.rows[-1]}")
        fixed[group.name] = np.isin(group.rows, wanted)
    return fixed


def _grouping(fit: Linearisation, by: Any, fixed: Mapping[str, NDArray[np.bool_]]
              ) -> tuple[dict[str, Index], list[str]]:
    explicit = _explicit(fit, by)
    places: dict[Any, int] = {}
    labels: list[str] = []
    members = {}
    for group in fit.groups:
        numbers = np.full(len(group.rows), -1, dtype=np.int64)
        open_rows = np.flatnonzero(~fixed.get(group.name, np.zeros(len(group.rows), dtype=bool)))
        if not group.is_prior and open_rows.size:
            keys, texts = _keys(fit, group, by, explicit)
            for row in open_rows:
                if keys[row] not in places:
                    places[keys[row]] = len(labels)
                    labels.append(texts[row])
                elif by is None:
                    raise InputError(f"{texts[row]} stands twice among the candidates; group rows of one number "
                                     "into one candidate with by=\"row\", or give each its own number")
                numbers[row] = places[keys[row]]
        members[group.name] = numbers
    return members, labels


def _explicit(fit: Linearisation, by: Any) -> dict[str, NDArray] | None:
    if by is None or isinstance(by, str):
        return None
    if isinstance(by, Mapping):
        return {(k.group if isinstance(k, Observations) else k): np.asarray(v) for k, v in by.items()}
    if isinstance(by, (list, tuple)) and by and all(isinstance(one, str) for one in by):
        names = {name for group in fit.groups for name in group.covariates}
        if set(by) <= names:
            return None
    open_groups = [g for g in fit.groups if not g.is_prior]
    array = np.asarray(by)
    if len(open_groups) == 1 and array.ndim == 1 and len(array) == len(open_groups[0].rows):
        return {open_groups[0].name: array}
    raise InputError("by: name a covariate, give one key a row of the only group, or {group: keys}; there are "
                     f"{', '.join(f'{g.name} ({len(g.rows)} rows)' for g in open_groups)}")


def _keys(fit: Linearisation, group: Any, by: Any, explicit: Mapping[str, NDArray] | None
          ) -> tuple[list[Any], list[str]]:
    """A key and a label for each row of a group."""
    n = len(group.rows)
    if by is None or (by == "row" and "row" not in group.covariates):
        return [(group.name, int(r)) for r in group.rows], [f"{group.name} row {r}" for r in group.rows]
    if explicit is not None:
        if group.name not in explicit or len(explicit[group.name]) != n:
            raise InputError(f"by: give one key for each of the {n} rows of '{group.name}', or name it in `always`")
        keys = [str(k) for k in explicit[group.name].tolist()]
        return keys, keys
    if by == "group" and "group" not in group.covariates:
        return [group.name] * n, [group.name] * n
    names = (by,) if isinstance(by, str) else tuple(by)
    for name in names:
        if name not in group.covariates:
            there = sorted({c for g in fit.groups for c in g.covariates})
            near = units.near_matches(name, there)
            hint = f"did you mean '{near[0]}'? " if near else ""
            raise InputError(f"by: '{group.name}' has no covariate '{name}'; {hint}There are: "
                             f"{', '.join(there) or 'none'}. Groups without it can be named in `always`")
    rows = list(zip(*(np.asarray(group.covariates[name]).tolist() for name in names), strict=True))
    return rows, [", ".join(f"{name} {_shown(value)}" for name, value in zip(names, row)) for row in rows]


def _shown(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _stacked(fit: Linearisation, members: Mapping[str, Index]) -> tuple[Array, Index]:
    """All whitened rows (N, p) over the free columns, and the candidate of each, -1 where fixed."""
    size = len(fit.layout.free_columns)
    pieces, owners = [], []
    for group in fit.groups:
        numbers = members[group.name]
        for block in group.whitened:
            mine = numbers[block.rows]
            apart = np.flatnonzero(np.any(mine != mine[:, :1], axis=1))
            if apart.size:
                rows = group.rows[block.rows[apart[0]]]
                raise InputError(f"rows {', '.join(map(str, rows))} of '{group.name}' have correlated errors and "
                                 "cannot be chosen apart; group them into one candidate with `by`")
            pieces.append(block.dense(fit.layout.position, size))
            owners.append(np.repeat(mine[:, 0], block.residual.shape[1]))
    return np.concatenate(pieces), np.concatenate(owners)


def _shared(fit: Linearisation, stacked: Array, owner: Index, asked: Functions | None) -> NDArray[np.bool_]:
    """Columns that more than one candidate sees; an unknown of one candidate alone comes and goes with it."""
    seen = stacked != 0
    first = np.where(seen, owner[:, None], np.iinfo(np.int64).max).min(axis=0)
    last = np.where(seen, owner[:, None], -2).max(axis=0)
    private = (first == last) & (first >= 0)
    if len(fit.conditions.target):
        private &= ~np.any(fit.conditions.matrix != 0, axis=0)
    if asked is not None:
        private &= ~np.any(fit.free_part(asked.derivatives) != 0, axis=0)
    # Where every unknown belongs to one candidate there is nothing they share, and nothing to eliminate for.
    return np.asarray(~private if not private.all() else np.ones_like(private))


def _without_private(stacked: Array, owner: Index, shared: NDArray[np.bool_], count: int) -> Array:
    """The shared columns, free of what each candidate must spend on the unknowns that only it sees."""
    kept = stacked[:, shared].copy()
    if shared.all():
        return kept
    private = stacked[:, ~shared]
    belongs = np.array([owner[np.flatnonzero(column)[0]] if column.any() else -1 for column in private.T])
    order = np.argsort(owner, kind="stable")
    begin = np.searchsorted(owner[order], np.arange(count + 1))
    for candidate in np.unique(belongs[belongs >= 0]):
        mine = order[begin[candidate] : begin[candidate + 1]]
        left, values, _ = np.linalg.svd(private[np.ix_(mine, np.flatnonzero(belongs == candidate))],
                                        full_matrices=False)
        basis = left[:, values > 1e-12 * values[0]]
        kept[mine] -= basis @ (basis.T @ kept[mine])
    return kept


def _padded(rows: Array, owner: Index, count: int) -> Array:
    """Rows (N, p) of candidates as (n, m, p); a candidate with more rows than unknowns is replaced by its triangle."""
    p = rows.shape[1]
    sizes = np.bincount(owner, minlength=count)
    order = np.argsort(owner, kind="stable")
    begin = np.concatenate([[0], np.cumsum(sizes)])
    width = int(min(sizes.max(), p))
    padded = np.zeros((count, width, p))
    if (sizes <= width).all():
        within = np.arange(len(rows)) - begin[owner[order]]
        padded[owner[order], within] = rows[order]
        return padded
    for candidate in range(count):
        mine = rows[order[begin[candidate] : begin[candidate + 1]]]
        corner = np.linalg.qr(mine, mode="r") if len(mine) > width else mine
        padded[candidate, : len(corner)] = corner
    return padded


def repeated(candidates: Candidates) -> list[tuple[int, int]]:
    """Pairs of candidates that see exactly the same."""
    seen: dict[bytes, int] = {}
    pairs = []
    for number, row in enumerate(np.round(candidates.rows, 12) + 0.0):
        key = row.tobytes()
        if key in seen:
            pairs.append((seen[key], number))
        else:
            seen[key] = number
    return pairs


def weights_of(candidates: Candidates, values: Mapping[str, float] | ArrayLike | None, default: float) -> Array:
    """A number for each candidate (n,): an array, or {label: number} with a default for the rest."""
    if values is None:
        return np.full(len(candidates), default)
    if isinstance(values, Mapping):
        strange = [str(key) for key in values if str(key) not in candidates.labels]
        if strange:
            raise InputError(f"costs: there is no candidate '{strange[0]}'; the first is '{candidates.labels[0]}'")
        return np.array([float(values.get(label, default)) for label in candidates.labels])
    numbers = np.asarray(values, dtype=float)
    if numbers.shape != (len(candidates),):
        raise InputError(f"costs: {numbers.size} numbers for {len(candidates)} candidates; give one for each")
    return numbers
