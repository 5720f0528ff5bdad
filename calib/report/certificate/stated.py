"""What a certificate says that no program may know: from the job's [certificate], refused by name where missing."""

from __future__ import annotations

import datetime
import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from calib.errors import InputError

NEEDED = {
    "certificate_number": "the unique number of the certificate",
    "country_code": "two letters, where it is issued, such as \"DE\"",
    "performance_location": "where it was done: laboratory, customer, laboratoryBranch, customerBranch or other",
    "laboratory": "who calibrated", "laboratory_city": "its town", "laboratory_country_code": "two letters",
    "responsible_person": "who answers for it",
    "customer": "for whom", "customer_city": "its town", "customer_country_code": "two letters",
    "item": "what was calibrated", "item_identification": "its serial or inventory number",
    "item_identified_by": "who gave that number: manufacturer, calibrationLaboratory, customer, owner or other",
    "influence_conditions": "under which it was done, such as \"air temperature (20.1 ± 0.2) °C\"",
    "calibration_date": "the (last) day of the calibration, such as 2024-05-17", "issue_date": "the day of issue",
}
CHOICES = {
    "performance_location": ("laboratory", "customer", "laboratoryBranch", "customerBranch", "other"),
    "item_identified_by": ("manufacturer", "calibrationLaboratory", "customer", "owner", "other"),
}
DATES = ("calibration_begin", "calibration_date", "issue_date", "receipt_date")


@dataclass(frozen=True)
class Stated:
    """The entries of [certificate], checked."""

    entries: Mapping[str, Any]

    def __getitem__(self, key: str) -> str:
        value = self.entries[key]
        return value.isoformat() if isinstance(value, datetime.date) else str(value)

    def get(self, key: str) -> str | None:
        """An entry that need not be there."""
        return self[key] if key in self.entries else None

    @property
    def begin(self) -> str:
        """The first day of the calibration."""
        return self.get("calibration_begin") or self["calibration_date"]


def stated(entries: Mapping[str, Any], path: Path) -> Stated:
    """Check what a job says for its certificate.

    entries: its table [certificate]; path: of the job, for messages.
    return: the entries, with spaces in order.
    raises InputError naming everything that is missing, a date that is none, dates out of order, a code that is none.
    """
    missing = [f"{key} ({meaning})" for key, meaning in NEEDED.items() if key not in entries]
    if missing:
        raise InputError(f"{path}, [certificate]: no certificate without {', '.join(missing)}; add them to the job "
                         "(nothing of it is ever invented)")
    found = {key: _entry(key, value, path) for key, value in entries.items()}
    for key in found:
        if key in CHOICES and found[key] not in CHOICES[key]:
            raise InputError(f"{path}, [certificate] {key}: '{found[key]}' is none of {', '.join(CHOICES[key])}")
        if key.endswith("country_code") and not re.fullmatch("[A-Z]{2}", str(found[key])):
            raise InputError(f"{path}, [certificate] {key}: '{found[key]}' is no country code; write two capital "
                             "letters (ISO 3166-1), such as \"DE\"")
    days = [found[key] for key in ("receipt_date", "calibration_begin", "calibration_date", "issue_date")
            if key in found]
    if days != sorted(days):
        raise InputError(f"{path}, [certificate]: the dates {', '.join(str(day) for day in days)} are not in order "
                         "(receipt, begin, calibration, issue); correct them")
    return Stated(found)


def _entry(key: str, value: Any, path: Path) -> Any:
    if key in DATES:
        if isinstance(value, datetime.datetime) or not isinstance(value, datetime.date):
            raise InputError(f"{path}, [certificate] {key}: '{value}' is no date; write it without quotation marks, as "
                             "in 2024-05-17")
        return value
    text = " ".join(str(value).split())
    if not text or any(unicodedata.category(letter) in ("Cc", "Cs", "Cn") for letter in text):
        raise InputError(f"{path}, [certificate] {key}: is empty or holds letters that cannot be printed; write it "
                         "anew")
    return text
