"""The pages' templates and what they are filled with: grids of text, drawings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from calib.report import plots

if TYPE_CHECKING:
    from jinja2 import Environment
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Cell:
    """One cell of a table with a style of the page: good, warning, text, prose."""

    text: str
    style: str = ""


@dataclass(frozen=True)
class Grid:
    """A table of the page: header and rows of texts."""

    header: Sequence[str]
    rows: Sequence[Sequence[str | Cell]]

    def without_empty(self) -> Grid:
        """The same table without the columns in which nothing stands."""
        kept = [i for i in range(len(self.header)) if any(row[i] for row in self.rows)]
        return Grid([self.header[i] for i in kept], [[row[i] for i in kept] for row in self.rows])


@dataclass(frozen=True)
class Drawing:
    """A drawing of the page: SVG element and caption."""

    svg: Any
    caption: str

    @staticmethod
    def of(figure: Figure, salt: str, caption: str) -> Drawing:
        """A drawing from a Matplotlib figure.

        figure: the figure; salt: text that no other figure of the page has; caption: below it.
        return: the drawing.
        """
        from markupsafe import Markup

        # Matplotlib escapes every text in its SVG, so the element may enter the page as it is.
        return Drawing(Markup(plots.svg(figure, salt)), caption)


def render(name: str, **content: Any) -> str:
    """A page from its template; every text in the content is escaped.

    name: of the template; content: what it is filled with.
    return: the HTML document.
    """
    return _environment().get_template(name).render(**content)


@cache
def _environment() -> Environment:
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    return Environment(
        loader=FileSystemLoader(Path(__file__).parent / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
