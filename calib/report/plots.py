"""Drawings of a report as inline SVG whose inks follow the page: light, dark and print."""

from __future__ import annotations

import io
import re
import unicodedata
import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Colours that stand for a variable of the page; Matplotlib writes them, the page replaces them.
INK, FAINT, ACCENT, WARNING = "#010101", "#020202", "#030303", "#040404"
SERIES = ("#050501", "#050502", "#050503", "#050504")
_VARIABLES = {
    INK: "var(--ink)", FAINT: "var(--faint)", ACCENT: "var(--accent)", WARNING: "var(--warning)",
    **{colour: f"var(--series-{number})" for number, colour in enumerate(SERIES, start=1)},
    # Figures of problems are drawn in Matplotlib's own colours; they too follow the page.
    "#000000": "var(--ink)", "#ffffff": "var(--paper)", "#1f77b4": "var(--series-1)", "#ff7f0e": "var(--series-2)",
    "#2ca02c": "var(--series-3)", "#9467bd": "var(--series-4)", "#d62728": "var(--warning)",
}
DRAWN = 3000       # points of one drawing; of more, every k-th is drawn and the caption says so
NUMBERED = 16      # results up to which a correlation map shows numbers
RINGS = 12         # readings of one component that are ringed
LONGEST = 44       # letters of a label
TOLD_APART = 30    # names on one axis
LEVELS = 6         # values up to which each has its tick
WIDTH = 7.2        # inches; the page scales the drawing to its column


def svg(figure: Figure, salt: str) -> str:
    """The text of a figure as SVG without the XML heading, coloured by variables of the page.

    figure: a Matplotlib figure; salt: text that keeps its identifiers apart from those of other figures of the page.
    return: the SVG element.
    """
    import matplotlib as mpl

    stream = io.StringIO()
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": salt}), warnings.catch_warnings():
        # The reader's browser has the letters that Matplotlib's own font lacks.
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        figure.savefig(stream, format="svg", transparent=True, metadata={"Date": None})
    text = re.sub(r"^.*?(?=<svg)", "", stream.getvalue(), count=1, flags=re.DOTALL)
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    for colour, variable in _VARIABLES.items():
        text = text.replace(colour, variable)
    # Identifiers such as axes_1 are the same in every figure; on one page they must differ.
    mark = re.sub(r"\W", "_", salt)
    text = re.sub(r'id="([^"]+)"', rf'id="{mark}_\1"', text)
    text = re.sub(r'href="#([^"]+)"', rf'href="#{mark}_\1"', text)
    text = re.sub(r"url\(#([^)]+)\)", rf"url(#{mark}_\1)", text)
    text = re.sub(r'(<svg[^>]*?) width="[^"]*"', r"\1", text, count=1)
    text = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", text, count=1)
    return text.replace("<svg", '<svg role="img"', 1)


def worded(name: str) -> str:
    """A name as a label: what cannot be printed left out, shortened, and never taken for a formula.

    name: anything that a person wrote.
    return: text for Matplotlib.
    """
    plain = "".join(" " if unicodedata.category(letter)[0] == "C" else letter for letter in name)
    short = plain if len(plain) <= LONGEST else plain[: LONGEST - 1] + "…"
    return short.replace("$", r"\$")


def canvas(height: float, fitted: bool = False) -> tuple[Figure, Any]:
    """An empty figure in the style of the page.

    height: inches; fitted: make room for labels of any length (slow); otherwise margins are fixed.
    return: the figure and its axes.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH, height), layout="constrained" if fitted else None)
    axes = figure.subplots()
    if not fitted:
        figure.subplots_adjust(left=0.74 / WIDTH, right=1 - 0.08 / WIDTH, bottom=0.48 / height, top=1 - 0.26 / height)
    style(axes)
    return figure, axes


def style(axes: Any) -> None:
    """Give axes the inks of the page and take away what is not data."""
    axes.patch.set_alpha(0)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(FAINT)
    axes.tick_params(colors=INK, labelcolor=INK, color=FAINT, labelsize=9)
    for label in (axes.xaxis.label, axes.yaxis.label, axes.title):
        label.set_color(INK)
        label.set_fontsize(10)


def residuals(x: np.ndarray, w: np.ndarray, component: Sequence[str], x_label: str) -> Figure:
    """Standardised residuals of one group against row or a covariate, with the 95% band of a single reading.

    x: (N,) numbers or texts; w: (N,) residual divided by its standard deviation; component: (N,) names; x_label: text.
    return: the figure.
    """
    named = x.dtype.kind not in "iuf"
    keys, place = np.unique(x.astype(str), return_inverse=True) if named else ((), x)
    figure, axes = canvas(2.5, fitted=named and len(keys) <= TOLD_APART)
    step = max(1, -(-len(w) // DRAWN))
    names = list(dict.fromkeys(component))
    axes.axhspan(-1.96, 1.96, color=FAINT, alpha=0.25, linewidth=0)
    axes.axhline(0.0, color=FAINT, linewidth=0.8)
    for number, name in enumerate(names):
        chosen = np.flatnonzero(np.asarray(component) == name)[::step]
        colour = SERIES[number % len(SERIES)]
        axes.scatter(place[chosen], w[chosen], s=16, color=colour, linewidths=0, label=worded(name) or None, alpha=0.85)
        far = chosen[np.abs(w[chosen]) > 3.29]
        # Rings point out single readings; where many are far off, the cloud itself says so.
        if len(far) <= RINGS:
            axes.scatter(place[far], w[far], s=60, facecolors="none", edgecolors=WARNING, linewidths=1.4)
    levels = () if named else np.unique(x)
    if 1 < len(levels) <= LEVELS:
        axes.set_xticks(levels)
    if named:
        shown = np.arange(len(keys)) if len(keys) <= TOLD_APART else np.zeros(0, int)
        slanted = {"rotation": 35, "ha": "right", "rotation_mode": "anchor"} if sum(map(len, keys)) > 60 else {}
        axes.set_xticks(shown, [worded(keys[i]) for i in shown], **slanted)
    axes.set_xlabel(worded(x_label))
    axes.set_ylabel("residual / its σ")
    axes.set_ylim(-1.08 * max(3.5, np.max(np.abs(w), initial=0)), 1.08 * max(3.5, np.max(np.abs(w), initial=0)))
    if len(names) > 1:
        axes.legend(frameon=False, labelcolor=INK, fontsize=9, ncols=min(len(names), 4), loc="lower left",
                    bbox_to_anchor=(0, 1), borderaxespad=0)
    return figure


def redundancy(values: np.ndarray, groups: Sequence[str]) -> Figure:
    """Redundancy numbers of all readings, group after group: 0 is checked by nobody, 1 adds nothing.

    values: (N,) between 0 and 1; groups: (N,) names.
    return: the figure.
    """
    figure, axes = canvas(2.1)
    step = max(1, -(-len(values) // DRAWN))
    begin = 0
    for number, name in enumerate(dict.fromkeys(groups)):
        mine = values[np.asarray(groups) == name]
        place = np.arange(begin, begin + len(mine))
        axes.scatter(place[::step], mine[::step], s=12, color=SERIES[number % len(SERIES)], linewidths=0,
                     label=worded(name))
        begin += len(mine)
    axes.axhline(0.1, color=WARNING, linewidth=0.8, linestyle="--")
    axes.set_ylim(-0.04, 1.04)
    axes.set_xlabel("scalar reading, in the order of observations.csv")
    axes.set_ylabel("redundancy")
    if len(set(groups)) > 1:
        axes.legend(frameon=False, labelcolor=INK, fontsize=9, ncols=4, loc="lower left", bbox_to_anchor=(0, 1),
                    borderaxespad=0)
    return figure


def budget(labels: Sequence[str], contributions: Sequence[float], unit: str) -> Figure:
    """The contributions to one standard uncertainty as bars, largest first.

    labels, contributions: of the sources, in `unit`.
    return: the figure.
    """
    figure, axes = canvas(0.75 + 0.27 * len(labels), fitted=True)
    place = np.arange(len(labels))
    axes.barh(place, contributions, color=ACCENT, height=0.62)
    axes.set_yticks(place, [worded(label) for label in labels])
    axes.invert_yaxis()
    axes.set_xlabel(f"contribution to u / {unit}")
    return figure


def correlation(names: Sequence[str], matrix: np.ndarray) -> Figure:
    """Correlation coefficients of the results as a map, with the numbers in it while they can be read.

    names: of the results; matrix: (k, k).
    return: the figure.
    """
    size = len(names)
    numbered = size <= NUMBERED
    figure, axes = canvas(1.2 + (0.32 if numbered else 0.16) * size, fitted=True)
    for i in range(size):
        for j in range(i + 1):
            value = float(matrix[i, j])
            if not np.isfinite(value):
                continue
            colour = SERIES[0] if value >= 0 else SERIES[1]
            axes.add_patch(_square(j, i, colour, abs(value)))
            if numbered:
                number = f"{value:.2f}".replace("-0.00", "0.00").replace("-", "−")
                axes.text(j, i, number, ha="center", va="center", fontsize=8, color=INK)
    axes.set_xlim(-0.5, size - 0.5)
    axes.set_ylim(size - 0.5, -0.5)
    letters = {"fontsize": 9 if numbered else 6}
    axes.set_yticks(range(size), [worded(name) for name in names], **letters)
    axes.set_xticks(range(size), [worded(name) for name in names], rotation=35 if numbered else 90, ha="right",
                    rotation_mode="anchor", **letters)
    for side in ("left", "bottom"):
        axes.spines[side].set_visible(False)
    axes.tick_params(length=0)
    return figure


def _square(x: int, y: int, colour: str, strength: float) -> Any:
    from matplotlib.patches import Rectangle

    return Rectangle((x - 0.48, y - 0.48), 0.96, 0.96, color=colour, alpha=0.12 + 0.6 * strength, linewidth=0)
