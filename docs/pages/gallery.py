"""The gallery: every script of docs/examples with the picture that it draws, made anew."""

from __future__ import annotations

import ast
import runpy
import shutil
import sys
from pathlib import Path

from pages.words import prose


def write(scripts: Path, made: Path) -> None:
    """Run every script and write the page of all.

    scripts: their folder; made: folder of made pages.
    """
    pictures = made / "pictures"
    pictures.mkdir()
    parts = ["# Examples\n", "Scripts that finish in seconds; each draws one picture. They lie in `docs/examples`, and "
             "`python docs/examples/NAME.py picture.png` runs one.\n"]
    for script in sorted(scripts.glob("[a-z]*.py")):
        text = script.read_text(encoding="utf-8")
        title, _, rest = (ast.get_docstring(ast.parse(text)) or script.stem).partition("\n\n")
        run(script, pictures / f"{script.stem}.png")
        parts += [f"## {title.rstrip('.')}\n", prose(rest), f"![{title}](pictures/{script.stem}.png)\n",
                  f"```python\n{text.split(chr(34) * 3, 2)[2].strip()}\n```\n"]
    (made / "gallery.md").write_text("\n".join(parts), encoding="utf-8")


def run(script: Path, picture: Path) -> None:
    """Run one example as a person would.

    script: its path; picture: where it shall draw.
    """
    before = sys.argv
    sys.argv = [str(script), str(picture)]
    try:
        runpy.run_path(str(script), run_name="__main__")
    finally:
        sys.argv = before
    if not picture.is_file():
        shutil.rmtree(picture, ignore_errors=True)
        raise RuntimeError(f"{script} drew no picture")
