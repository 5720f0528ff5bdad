"""`calib reproduce`: published papers recomputed from their own tables, printed number by printed number."""

from __future__ import annotations

import click

from calib import catalogue, units
from calib.cli.output import DONE, Output, output_options, typed
from calib.errors import InputError
from calib.report import numbers
from calib.workflow.reproduce import AGREES, Item, Reproduction

LINE = 160      # characters of a line of text


@click.command()
@click.argument("names", nargs=-1, metavar="[NAME ...]")
@output_options
def reproduce(names: tuple[str, ...], output: Output) -> int:
    """Recompute published papers: printed value, value by the paper's method, joint estimate, verdict and why.

    Without NAME: all of them. With --out: NAME.json for each, and report.html.
    """
    from calib.report import reproduction
    from calib.report.provenance import provenance

    there = catalogue.published()
    for name in names:
        if name not in there:
            near = units.near_matches(name, list(there))
            hint = f"did you mean '{near[0]}'? " if near else ""
            raise InputError(f"no paper '{name}' is here to reproduce; {hint}There are: {', '.join(there)}")
    chosen = names or tuple(there)
    found = []
    with output.progress("reproducing", len(chosen)) as step:
        for name in chosen:
            found.append(there[name].reproduce())
            step()
    output.result({"format": 1, "papers": [one.content() for one in found]})
    for one in found:
        say(output, one)
    if output.folder is not None:
        folder = output.folder
        written = [one.write(folder) for one in found]
        output.wrote(*written, reproduction.write(found, provenance([], typed()), output.path("report.html")))
    return DONE


def say(output: Output, found: Reproduction) -> None:
    """Counts of the verdicts; every number that differs with its reason; what cannot be determined, by reason."""
    compared = [item for item in found.items if item.printed is not None]
    beside = len(found.items) - len(compared)
    further = f"; {beside} further numbers with nothing printed beside them" if beside else ""
    summary = Reproduction(found.name, tuple(compared)).summary()
    output.say(f"{found.name}: {len(compared)} printed numbers, {summary}{further}")
    missing: dict[str, list[Item]] = {}
    for item in compared:
        if item.value is None:
            # Reasons that begin alike are one reason with a detail to each number.
            missing.setdefault(item.why[:60], []).append(item)
        elif item.verdict != AGREES:
            output.say(_line(f"  {item.key}: {_printed(item)} printed, {_value(item)} computed: {item.why}"))
    for items in missing.values():
        keys = ", ".join(item.key for item in items[:4]) + (" ..." if len(items) > 4 else "")
        output.say(_line(f"  not determinable, {len(items)}: {keys}: {items[0].why}"))
    output.say()


def _line(text: str) -> str:
    """One line of a terminal; the whole reason stands in the files."""
    return text if len(text) <= LINE else f"{text[: LINE - 4].rsplit(' ', 1)[0]} ..."


def _printed(item: Item) -> str:
    assert item.printed is not None
    return f"{item.printed.text} {'' if item.unit == '1' else item.unit}".strip()


def _value(item: Item) -> str:
    """The computed value to one digit more than was printed, so that the difference shows."""
    assert item.value is not None and item.printed is not None
    half = item.printed.half_digit
    return numbers.with_uncertainty(item.value, 2.0 * half)[0] if half else numbers.plain(item.value)
