"""The drawings of reports need the colours and the script of a report; both are taken from there."""

from __future__ import annotations

import re
from pathlib import Path

from calib.report import space

TEMPLATES = Path(space.__file__).parent / "templates"
TAKEN = (".space", ".turn", ".live", "figcaption", "svg text", "svg path", "figure .scroll", ".scroll")


def write(static: Path) -> None:
    """Write calib.css and space.js into the folder of static files."""
    static.mkdir(exist_ok=True)
    page = (TEMPLATES / "page.html.j2").read_text(encoding="utf-8")
    light, dark = re.findall(r":root \{(.*?)\}", page, flags=re.DOTALL)[:2]
    light = light.replace("color-scheme: light dark;", "")
    # The theme has drawings of its own: only those in figures are ours.
    rules = [f"figure {line}" if line.startswith("svg ") else line for line in page.splitlines()
             if line.startswith(TAKEN)]
    text = [f"body {{ {light} }}", f'body[data-theme="dark"] {{ {dark} }}',
            f'@media (prefers-color-scheme: dark) {{ body:not([data-theme="light"]) {{ {dark} }} }}',
            "figure { margin: 1rem 0; }", ".gallery img { width: 100%; }", *rules]
    (static / "calib.css").write_text("\n".join(text) + "\n", encoding="utf-8")
    (static / "space.js").write_text(space.script(), encoding="utf-8")
