"""Tutorials: the code runs as it is printed and prints what the page says."""

import contextlib
import io
import re
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "docs" / "tutorials"
PAGES = sorted(page for page in FOLDER.glob("*.md") if "```python" in page.read_text(encoding="utf-8"))
FENCE = re.compile(r"^```(python|text)\n(.*?)^```$", re.DOTALL | re.MULTILINE)


def run(page: Path) -> list[tuple[str, str]]:
    """Each printed output of a page with what the code before it really prints."""
    names: dict[str, object] = {"__name__": page.stem}
    pairs, heard = [], ""
    for kind, text in FENCE.findall(page.read_text(encoding="utf-8")):
        if kind == "python":
            with contextlib.redirect_stdout(io.StringIO()) as out:
                exec(compile(text, f"{page.name}", "exec"), names)
            heard += out.getvalue()
        else:
            pairs.append((text, heard))
            heard = ""
    return pairs


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.stem)
def test_a_tutorial_prints_what_its_page_says(page):
    pairs = run(page)
    assert pairs
    for printed, heard in pairs:
        assert heard == printed
