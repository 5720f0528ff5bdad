"""Make all generated pages under docs/made; the folder is emptied first."""

from __future__ import annotations

import shutil
from pathlib import Path

from pages import gallery, problems, published, reference, style


def all_pages(docs: Path) -> None:
    """Write every generated page.

    docs: the folder of the documentation.
    """
    made = docs / "made"
    shutil.rmtree(made, ignore_errors=True)
    made.mkdir()
    style.write(docs / "_static")
    problems.write(made / "problems")
    reference.write(made / "reference")
    published.write(made / "published.md")
    gallery.write(docs / "examples", made)
