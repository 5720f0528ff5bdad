"""The documentation site: what a person wrote in docs/, and pages made from the modules themselves."""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent)]

from calib.report.provenance import version as _version  # noqa: E402

project = "Calibration framework"
author = "the authors"
html_show_copyright = False
release = version = _version()
extensions = ["myst_parser"]
myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3
exclude_patterns = ["_build", "examples", "pages", "README.md"]
html_theme = "furo"
html_title = project
html_static_path = ["_static"]
html_css_files = ["calib.css"]
html_js_files = [("space.js", {"defer": "defer"})]
pygments_style, pygments_dark_style = "friendly", "monokai"
nitpicky = True


def setup(app) -> None:  # type: ignore[no-untyped-def]
    """Make the pages before Sphinx looks for them."""
    from pages import make

    app.connect("config-inited", lambda app, config: make.all_pages(HERE))
