"""Published numbers against numbers computed anew: what was printed, what comes out, and the verdict."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from calib import files
from calib.errors import DeclarationError
from calib.table import shipped

AGREES, DIFFERS, NOT_DETERMINABLE = "agrees", "differs", "not determinable"
_NUMBER = re.compile(r"(?P<sign>[+-]?)(?P<whole>\d+)(?:\.(?P<decimals>\d+))?(?:[eE](?P<power>[+-]?\d+))?")
_RANGE = re.compile(r"(?P<low>[+-]?[\d.eE+-]*\d)\s*(?:to|~|\.\.\.|–)\s*(?P<high>[+-]?[\d.eE+-]*\d)")


@dataclass(frozen=True)
class Printed:
    """A published number as it was printed, in the unit it was printed in.

    text: as printed; number: its value, None for a range or a text; half_digit: half of its last printed digit;
    interval: limits of a printed range (either may be infinite), None for a single number.
    """

    text: str
    number: float | None = None
    half_digit: float = 0.0
    unit: str = "1"
    quantity: str = ""
    interval: tuple[float, float] | None = None

    @staticmethod
    def of(text: str, unit: str = "1", quantity: str = "") -> Printed:
        """A printed number from its text.

        text: as printed, such as "-0.169", "49e-6" or "6 to 7"; other texts are kept as texts.
        unit: the unit it was printed in; quantity: what it is.
        return: the printed number with half of its last digit.
        """
        text = text.strip().replace("−", "-")
        found = _NUMBER.fullmatch(text)
        if found:
            power = int(found["power"] or 0) - len(found["decimals"] or "")
            return Printed(text, float(text), 0.5 * 10.0**power, unit, quantity)
        between = _RANGE.fullmatch(text)
        if between:
            return Printed(text, None, 0.0, unit, quantity, (float(between["low"]), float(between["high"])))
        return Printed(text, None, 0.0, unit, quantity)

    @staticmethod
    def read(
        name: str, *, key: str = "key", value: str = "value", unit: str | None = "unit", quantity: str | None = None
    ) -> dict[str, Printed]:
        """The printed numbers of a shipped table, by key.

        name: table below problems/data; key, value, unit, quantity: the columns they stand in (unit None: none there;
        quantity None: the column `quantity` or `note` where there is one).
        return: {key: Printed}, in the order of the table.
        raises InputError where the table or a column is missing.
        """
        table = shipped(name)
        described = quantity or next((column for column in ("quantity", "note") if table.has(column)), None)
        keys, texts = table.text(key), table.text(value)
        unit_texts = table.text(unit, may_be_empty=True) if unit else [""] * len(table)
        quantities = table.text(described, may_be_empty=True) if described else [""] * len(table)
        return {
            str(one): Printed.of(str(text), str(its_unit) or "1", str(what))
            for one, text, its_unit, what in zip(keys, texts, unit_texts, quantities)
        }


def verdict(
    value: float | None, printed: Printed | None, *, sampling: float | None = None, magnitude: bool = False
) -> str:
    """Whether a computed number is the printed one.

    value: computed, in the printed unit; None where it cannot be computed.
    printed: the published number; without a number or a range in it nothing can be compared.
    sampling: half-width of the 95% sampling interval of a Monte Carlo number of the printed sample size.
    magnitude: compare without the sign, where the sign cannot be observed.
    return: "agrees" (to half of the last printed digit, within the printed range or the sampling interval), "differs"
    or "not determinable".
    """
    if value is None or printed is None or not math.isfinite(value):
        return NOT_DETERMINABLE
    if printed.interval is not None:
        return AGREES if printed.interval[0] <= value <= printed.interval[1] else DIFFERS
    if printed.number is None:
        return NOT_DETERMINABLE
    number = printed.number
    if magnitude:
        value, number = abs(value), abs(number)
    # The slack is that of decimal digits in binary: 0.15 counts as half a digit away from 0.1 and from 0.2.
    slack = 1e-12 * max(abs(value), abs(number))
    return AGREES if abs(value - number) <= max(printed.half_digit, sampling or 0.0) + slack else DIFFERS


@dataclass(frozen=True, init=False)
class Item:
    """One published number beside what was computed for it; all numbers in the printed unit.

    value: the paper's own formulas at full precision; rounded: the same along the paper's printed intermediates.
    u, joint_u: from the stated uncertainties; u_vc, joint_u_vc: with estimated variance components.
    joint: from one model of everything; why: the reason of the verdict; more: further entries of the JSON file.
    """

    key: str
    quantity: str
    unit: str
    printed: Printed | None
    value: float | None
    rounded: float | None
    u: float | None
    u_vc: float | None
    joint: float | None
    joint_u: float | None
    joint_u_vc: float | None
    why: str
    printed_u: float | None
    printed_text: str | None
    verdict: str
    more: Mapping[str, Any] = field(default_factory=dict)

    def __init__(
        self,
        key: str,
        quantity: str,
        unit: str,
        printed: Printed | None,
        *,
        value: float | None = None,
        rounded: float | None = None,
        u: float | None = None,
        u_vc: float | None = None,
        joint: float | None = None,
        joint_u: float | None = None,
        joint_u_vc: float | None = None,
        why: str = "",
        printed_u: float | None = None,
        printed_text: str | None = None,
        sampling: float | None = None,
        magnitude: bool = False,
        **more: Any,
    ) -> None:
        judged = verdict(value, printed, sampling=sampling, magnitude=magnitude)
        if not why and judged == DIFFERS and verdict(rounded, printed, magnitude=magnitude) == AGREES:
            why = "rounding of the printed intermediate results"
        if not why and judged != AGREES:
            raise DeclarationError(f"item '{key}' is '{judged}' without a reason; say in `why` what is missing or "
                                   f"where it differs (value {value}, printed {printed and printed.text})")
        if printed_text is None and printed is not None and printed.number is None:
            printed_text = printed.text
        if sampling is not None:
            more = {"sampling": sampling, **more}
        numbers = {"value": value, "rounded": rounded, "u": u, "u_vc": u_vc, "joint": joint, "joint_u": joint_u,
                   "joint_u_vc": joint_u_vc, "printed_u": printed_u}
        given = {"key": key, "quantity": quantity, "unit": unit, "printed": printed, "why": why, "verdict": judged,
                 "printed_text": printed_text, "more": more}
        for name, number in numbers.items():
            object.__setattr__(self, name, None if number is None else float(number))
        for name, content in given.items():
            object.__setattr__(self, name, content)

    def entry(self) -> dict[str, Any]:
        """The entry of NAME.json: plain values in the order of the file format.

        return: a dictionary ready for JSON; numbers in the printed unit.
        """
        texts = {} if self.printed_text is None else {"printed_text": self.printed_text}
        return {
            "key": self.key,
            "quantity": self.quantity,
            "unit": self.unit,
            "printed": None if self.printed is None else self.printed.number,
            "printed_u": self.printed_u,
            **texts,
            "value": self.value,
            "rounded": self.rounded,
            "u": self.u,
            "u_vc": self.u_vc,
            "joint": self.joint,
            "joint_u": self.joint_u,
            "joint_u_vc": self.joint_u_vc,
            "verdict": self.verdict,
            "why": self.why,
            **self.more,
        }


@dataclass(frozen=True)
class Reproduction:
    """A published comparison, number by number, with studies beside it.

    name: name of the paper's file, such as "five-axis"; items: one for every printed number; studies: further results
    by name, as JSON knows them; figures: by title, each a function without arguments returning a Matplotlib figure.
    """

    name: str
    items: tuple[Item, ...]
    studies: Mapping[str, Any] = field(default_factory=dict)
    figures: Mapping[str, Callable[[], Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "items", tuple(self.items))
        repeated = _repeated(item.key for item in self.items)
        if repeated:
            raise DeclarationError(f"reproduction '{self.name}' has two items of the key '{repeated}'; keep one")

    def __getitem__(self, key: str) -> Item:
        for item in self.items:
            if item.key == key:
                return item
        raise KeyError(key)

    def counts(self) -> dict[str, int]:
        """How many items have each verdict.

        return: {verdict: count}, in the order agrees, differs, not determinable.
        """
        return {kind: sum(item.verdict == kind for item in self.items) for kind in (AGREES, DIFFERS, NOT_DETERMINABLE)}

    def summary(self) -> str:
        """The counts in words, such as "15 agree, 3 differ, 2 cannot be determined"."""
        words = {AGREES: ("agrees", "agree"), DIFFERS: ("differs", "differ"),
                 NOT_DETERMINABLE: ("cannot be determined", "cannot be determined")}
        return ", ".join(f"{count} {words[kind][count != 1]}" for kind, count in self.counts().items() if count)

    def content(self) -> dict[str, Any]:
        """The content of NAME.json.

        return: a dictionary ready for JSON.
        """
        studies = {"studies": dict(self.studies)} if self.studies else {}
        return {"format": 1, "name": self.name, "quantities": [item.entry() for item in self.items], **studies}

    def write(self, folder: str | Path) -> Path:
        """Write NAME.json, whole or not at all.

        folder: where it shall stand.
        return: the path of the file.
        raises InputError where it cannot be written.
        """
        return files.write_json(Path(folder) / f"{self.name}.json", self.content())


def _repeated(keys: Iterable[str]) -> str | None:
    seen: set[str] = set()
    for key in keys:
        if key in seen:
            return key
        seen.add(key)
    return None
