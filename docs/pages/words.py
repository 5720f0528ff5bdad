"""From docstrings to Markdown: the house's docstrings are plain sentences, and nothing in them is markup."""

from __future__ import annotations

import inspect
import re

SPECIAL = re.compile(r"([\\`*_{}\[\]<>#|$~^])")
STARTS = ("return:", "returns:", "raises", "source:", "Returns ", "Raises ", "Source:", "Sources:")


def escaped(text: str) -> str:
    """Text in which Markdown sees no markup."""
    return SPECIAL.sub(r"\\\1", text)


def prose(text: str) -> str:
    """A docstring as Markdown: paragraphs, and what is indented stands as it is (formulas, tables)."""
    lines = inspect.cleandoc(text).splitlines()
    found: list[str] = []
    block: list[str] = []
    for line in [*lines, ""]:
        if line.startswith("    "):
            block.append(line[4:])
            continue
        if block and not line.strip():
            block.append("")
            continue
        if block:
            found += ["", "```text", *"\n".join(block).strip().splitlines(), "```", ""]
            block = []
        if line.startswith(STARTS):
            found.append("")
        found.append(_line(line))
    if block:
        found += ["", "```text", *"\n".join(block).strip().splitlines(), "```"]
    return "\n".join(found).strip() + "\n"


def _line(line: str) -> str:
    """One line of prose: names in backquotes become code, the rest is escaped."""
    pieces = re.split(r"(`[^`]+`)", line)
    text = "".join(piece if piece.startswith("`") and piece.endswith("`") and len(piece) > 2 else escaped(piece)
                   for piece in pieces)
    # A line that begins like a list or a heading is none.
    return re.sub(r"^(\s*)([-+]|\d+[.)])(\s)", r"\1\\\2\3", text)


def documented(text: str) -> str:
    """The docstring of a function or class: its sentence, then the rest as a list of what is said of each argument."""
    paragraphs = inspect.cleandoc(text).split("\n\n")
    first, rest = paragraphs[0], "\n\n".join(paragraphs[1:])
    return prose(first) + ("\n" + prose(rest) if rest.strip() else "")


def table(header: list[str], rows: list[list[str]]) -> str:
    """A Markdown table; the cells are escaped."""
    lines = ["| " + " | ".join(header) + " |", "|" + " --- |" * len(header)]
    lines += ["| " + " | ".join(escaped(" ".join(str(cell).split())) for cell in row) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def raw(html: str) -> str:
    """HTML as it is."""
    return f"````{{raw}} html\n{html}\n````\n"
