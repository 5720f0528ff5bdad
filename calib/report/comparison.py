"""comparison.json and report.html of a comparison: one problem under many formulations."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from calib import files, units
from calib.report import numbers, plots
from calib.report.provenance import Provenance
from calib.report.template import Cell, Drawing, Grid, render
from calib.workflow.compare.side_by_side import STATED, Compared, Comparison
from calib.workflow.compare.study import Performance

ANSWERS = 4        # results in the first sentence
SHOWN = 8          # results whose values stand in the table; comparison.json holds all
AGREE = 1e-6       # in units of u: methods that differ by less give the same answer


def content(comparison: Comparison) -> list[dict[str, Any]]:
    """comparison.json: one entry a formulation and method, numbers in the display unit of each result."""
    scale = {name: units.factor(unit) for name, unit in zip(comparison.wanted.names, comparison.wanted.units)}
    unit_of = dict(zip(comparison.wanted.names, comparison.wanted.units))
    return [{
        "formulation": line.formulation, "method": line.method, "accepted": line.accepted, "why": line.why,
        "value": {name: value / scale[name] for name, value in line.values.items()},
        "u": {name: value / scale[name] for name, value in line.u.items()},
        "unit": {name: unit_of[name] for name in line.values},
        "u_from": line.u_from, "difference_in_u": dict(line.difference), "objective": line.objective,
        "certificate": None if line.certificate is None else files.plain(line.certificate),
        "converged": line.converged, "iterations": line.iterations, "seconds": line.seconds,
        "memory_bytes": line.memory, "starts": _starts(line), "bound": _bound(line), "study": _study(line),
        "note": line.note, "source": line.source,
    } for line in comparison.lines]


def _starts(line: Compared) -> dict[str, Any] | None:
    if line.starts is None:
        return None
    found = line.starts
    return {"sought": found.sought, "tried": len(found.found), "successes": found.successes, "elsewhere":
            found.elsewhere, "every_start_within": found.safe, "region": found.region, "seed": found.seed}


def _bound(line: Compared) -> dict[str, Any] | None:
    if line.bound is None:
        return None
    return {"lower": float(line.bound.lower), "gap": float(line.bound.gap), "proven": bool(line.bound.proven),
            "sentence": line.bound.sentence}


def _study(line: Compared) -> list[dict[str, Any]]:
    def by_name(performance: Performance, values: Any) -> dict[str, float]:
        return dict(zip(performance.names, values.tolist(), strict=True))
    return [{"noise": one.noise, "trials": len(one.errors), "failures": one.failures,
             "bias_in_u": by_name(one, one.bias), "u_of_bias": by_name(one, one.u_of_bias),
             "spread_over_u": by_name(one, one.spread), "efficiency": by_name(one, one.efficiency)}
            for one in line.study]


def sentences(comparison: Comparison) -> list[str]:
    """What the comparison says, first things first."""
    reference = comparison.reference
    if reference is None:
        whys = dict.fromkeys(line.why or line.note for line in comparison.lines)
        return ["No method solves the declared problem: " + "; ".join(why for why in whys if why) + "."]
    same = [line for line in comparison.lines if line.accepted and line.converged and line.difference
            and _largest(line) <= AGREE and line.u_from == STATED]
    told = [_answer(comparison, reference)]
    told += [f"{len(same)} of {len([x for x in comparison.lines if x.accepted])} that accept the problem give the same "
            f"answer to {AGREE:g} u; {len(comparison.refused)} refuse it, and say why."]
    told += [f"{line.formulation.capitalize()}: {line.bound.sentence}" for line in comparison.lines
             if line.bound is not None]
    other = [line for line in comparison.lines if line.accepted and line.difference and _largest(line) > AGREE]
    if other:
        far = max(other, key=_largest)
        name = max(far.difference, key=lambda key: abs(far.difference[key]))
        told.append(f"The largest difference: {far.formulation} ({far.method}) gives {name} "
                    f"{numbers.plain(abs(far.difference[name]), 3)} u away.")
    starts = reference.starts
    if starts is not None and len(starts.found):
        told.append(f"{reference.method} found the answer from {starts.successes} of {len(starts.found)} random starts"
                    f"; every start within {numbers.plain(starts.safe, 2)} times the region did (region: "
                    f"{starts.region}).")
        if starts.elsewhere:
            told.append(f"{starts.elsewhere} of them arrived at another place with the same v'Pv: a mirror image or a "
                        "whole turn, between which no reading decides.")
    return told


def _answer(comparison: Comparison, reference: Compared) -> str:
    """The values of the reference with U, k = 2."""
    parts = []
    for name, unit in list(zip(comparison.wanted.names, comparison.wanted.units))[:ANSWERS]:
        if reference.u.get(name, 0.0) > 0.0:
            one = units.factor(unit)
            value, expanded = numbers.with_uncertainty(reference.values[name] / one, 2.0 * reference.u[name] / one)
            parts.append(f"{name} = {value} ± {expanded} {unit}".removesuffix(" 1"))
    more = len(comparison.wanted.names) - len(parts)
    return "; ".join(parts) + " (k = 2)" + (f", and {more} more" if more > 0 else "") + "."


def _largest(line: Compared) -> float:
    return max((abs(value) for value in line.difference.values()), default=0.0)


def write(comparison: Comparison, provenance: Provenance, path: str | Path) -> Path:
    """Write report.html, whole or not at all; returns the path. Raises InputError where it cannot be written."""
    return files.write_text(path, html(comparison, provenance))


def html(comparison: Comparison, provenance: Provenance) -> str:
    """The page as text: self-contained, nothing is loaded from elsewhere."""
    reference = comparison.reference
    return render(
        "comparison.html.j2", title=f"{comparison.problem.name}: formulations side by side",
        passed=reference is not None, answers=sentences(comparison), effort=_effort(comparison),
        results=_results(comparison), refused=_refused(comparison), notes=_notes(comparison),
        differences=_differences(comparison), reach=_reach(comparison), studies=_studies(comparison),
        spread=_spread(comparison),
        provenance=provenance.lines(),
    )


def _called(line: Compared) -> str:
    return f"{line.formulation}: {line.method}"


def _effort(comparison: Comparison) -> Grid:
    rows: list[list[str | Cell]] = []
    for line in comparison.lines:
        if not line.accepted:
            continue
        certificate = "–" if line.certificate is None else "passed" if line.certificate.passed else "failed"
        style = "good" if certificate == "passed" else "warning" if certificate == "failed" else ""
        starts = "–" if line.starts is None else f"{line.starts.successes} of {len(line.starts.found)}"
        safe = "–" if line.starts is None else numbers.plain(line.starts.safe, 2)
        rows.append([_called(line), numbers.plain(line.objective, 6), _in_u(_largest(line)) if line.difference else "–",
                     Cell(certificate, style), "–" if line.iterations is None else str(line.iterations),
                     numbers.plain(1e3 * (line.seconds or 0.0), 3), numbers.plain((line.memory or 0) / 1024, 3), starts,
                     safe])
    return Grid(["formulation: method", "v′Pv", "largest difference / u", "certificate", "iterations", "time / ms",
                 "memory / KiB", "starts", "all within"], rows)


def _in_u(value: float) -> str:
    return "0" if value == 0.0 else f"{value:.1e}" if value < 1e-3 else numbers.plain(value, 3)


def _results(comparison: Comparison) -> Grid:
    names = comparison.wanted.names[:SHOWN]
    factor = {name: units.factor(unit) for name, unit in zip(comparison.wanted.names, comparison.wanted.units)}
    header = ["formulation: method", *(f"{n} / {u}" if u != "1" else n
                                       for n, u in zip(names, comparison.wanted.units)), "u from"]
    rows: list[list[str | Cell]] = []
    for line in comparison.lines:
        if line.accepted and line.values:
            cells = []
            for name in names:
                value, u = line.values.get(name), line.u.get(name)
                known = value is not None and u is not None
                shown = numbers.with_uncertainty(value / factor[name], u / factor[name]) if known else ("–", "")  # type: ignore[operator]
                cells.append(f"{shown[0]} ({shown[1]})" if shown[1] else "–")
            rows.append([_called(line), *cells, line.u_from])
    return Grid(header, rows)


def _refused(comparison: Comparison) -> Grid | None:
    rows: list[list[str | Cell]] = [[_called(line).rstrip(": "), Cell(line.why, "prose")]
                                    for line in comparison.refused]
    return Grid(["refuses", "why"], rows) if rows else None


def _notes(comparison: Comparison) -> Grid | None:
    rows: list[list[str | Cell]] = [[_called(line), Cell(line.note, "prose")]
                                    for line in comparison.lines if line.accepted and line.note]
    return Grid(["formulation: method", "remark"], rows) if rows else None


def _differences(comparison: Comparison) -> Drawing | None:
    """Differences of every result in units of the reference's u, a row a formulation."""
    lines = [line for line in comparison.lines if line.accepted and line.difference]
    if len(lines) < 2:
        return None
    figure, axes = plots.canvas(0.9 + 0.3 * len(lines), fitted=True)
    axes.axvspan(-1.0, 1.0, color=plots.FAINT, alpha=0.25, linewidth=0)
    for place, line in enumerate(lines):
        values = np.array(list(line.difference.values()))
        colour = plots.SERIES[0] if line.formulation == lines[0].formulation else plots.SERIES[1]
        axes.scatter(values, np.full(len(values), place), s=26, color=colour, alpha=0.7, linewidths=0)
    axes.set_yticks(range(len(lines)), [_called(line) for line in lines])
    axes.invert_yaxis()
    axes.set_xscale("symlog", linthresh=1.0)
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}".replace("-", "−"))
    axes.set_xlabel("difference from the reference, in units of its u")
    return Drawing.of(figure, "differences", "Every mark is one result; the band is one standard uncertainty.")


def _studies(comparison: Comparison) -> list[tuple[str, Grid]]:
    """A table for each noise: the worst result of every formulation."""
    noises = dict.fromkeys(one.noise for line in comparison.lines for one in line.study)
    tables = []
    for noise in noises:
        rows: list[list[str | Cell]] = []
        for line in comparison.lines:
            for one in line.study:
                if one.noise == noise:
                    bias = one.bias[np.argmax(np.abs(one.bias / one.u_of_bias))]
                    rows.append([_called(line), numbers.plain(bias, 2), numbers.plain(one.u_of_bias.max(), 2),
                                 numbers.plain(one.spread.min(), 3), numbers.plain(one.spread.max(), 3),
                                 numbers.plain(one.efficiency.min(), 2), str(len(one.errors)), str(one.failures)])
        tables.append((noise, Grid(["formulation: method", "bias / u", "u of bias", "least spread / u",
                                    "largest spread / u", "least efficiency", "trials", "failures"], rows)))
    return tables


def _spread(comparison: Comparison) -> Drawing | None:
    """True spread over the bound, all results together: a mark for each formulation and noise."""
    lines = [line for line in comparison.lines if line.study]
    if not lines:
        return None
    figure, axes = plots.canvas(1.2 + 0.3 * len(lines), fitted=True)
    axes.axvline(1.0, color=plots.FAINT, linewidth=1)
    for number, noise in enumerate(dict.fromkeys(one.noise for line in lines for one in line.study)):
        here = [(place, one) for place, line in enumerate(lines) for one in line.study if one.noise == noise]
        axes.scatter([float(np.sqrt(np.mean(one.spread**2))) for _, one in here], [place for place, _ in here], s=30,
                     marker="osD^v"[number % 5], color=plots.SERIES[number % len(plots.SERIES)], label=noise, alpha=0.8)
    axes.set_yticks(range(len(lines)), [_called(line) for line in lines])
    axes.invert_yaxis()
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.xaxis.set_minor_formatter(lambda value, _: f"{value:g}" if f"{value:.0e}"[0] in "25" else "")
    axes.set_xlabel("true spread over the u of the declared problem (rms over the results)")
    axes.legend(frameon=False, labelcolor=plots.INK, fontsize=8, loc="lower center", bbox_to_anchor=(0.4, 1.0), ncols=2)
    return Drawing.of(figure, "spread", "One is what the stated uncertainties promise to the best estimator.")


def _reach(comparison: Comparison) -> Drawing | None:
    """Share of successful starts against how far they lie."""
    lines = [line for line in comparison.lines if line.starts is not None and len(line.starts.found) >= 10]
    if not lines:
        return None
    figure, axes = plots.canvas(2.8)
    for number, line in enumerate(lines[: len(plots.SERIES)]):
        assert line.starts is not None
        pieces = np.array_split(np.arange(len(line.starts.found)), 10)
        reach = [float(np.exp(np.log(line.starts.reach[piece]).mean())) for piece in pieces]
        share = [100.0 * float(line.starts.found[piece].mean()) for piece in pieces]
        axes.plot(reach, share, marker="o", markersize=4, color=plots.SERIES[number], label=_called(line),
                  alpha=0.85, linestyle=("-", "--", ":", "-.")[number])
    axes.set_xscale("log")
    axes.set_ylim(-4, 104)
    axes.set_xlabel("distance of the start, in half-widths of the region")
    axes.set_ylabel("found / %")
    axes.legend(frameon=False, labelcolor=plots.INK, fontsize=8, loc="lower left")
    return Drawing.of(figure, "reach", "Share of random starts from which the least v′Pv was found, in ten classes.")
