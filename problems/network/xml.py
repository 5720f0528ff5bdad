"""XML into elements that know their line; documents that define entities are refused."""

from __future__ import annotations

import xml.parsers.expat
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from calib.errors import InputError


@dataclass
class Element:
    """One element: tag without namespace, attributes, line in the file, children and text."""

    tag: str
    attributes: dict[str, str]
    line: int
    children: list[Element] = field(default_factory=list)
    text: str = ""

    def children_of(self, tag: str) -> Iterator[Element]:
        """The children of one tag."""
        return (child for child in self.children if child.tag == tag)

    def child(self, tag: str) -> Element | None:
        """The first child of one tag, or None."""
        return next(self.children_of(tag), None)


def read_xml(path: Path) -> Element:
    """The root element of a file.

    Raises InputError where the file cannot be read, is not XML, or has a document type with definitions (which could be
    entities that grow without end or read other files).
    """
    parser = xml.parsers.expat.ParserCreate()
    root: list[Element] = []
    open_elements: list[Element] = []

    def begin(tag: str, attributes: dict[str, str]) -> None:
        element = Element(tag.rsplit(":", 1)[-1], attributes, parser.CurrentLineNumber)
        (open_elements[-1].children if open_elements else root).append(element)
        open_elements.append(element)

    def inside(text: str) -> None:
        if open_elements:
            open_elements[-1].text += text

    def refuse(*_: object) -> None:
        raise InputError(f"{path}, line {parser.CurrentLineNumber}: has a document type or defines entities, which is "
                         "refused; take the DOCTYPE out")

    def declared(name: str, system: str | None, public: str | None, has_definitions: int) -> None:
        if has_definitions:      # one that only names a DTD is harmless: that file is never read
            refuse()

    parser.StartElementHandler = begin
    parser.EndElementHandler = lambda tag: open_elements.pop()
    parser.CharacterDataHandler = inside
    parser.StartDoctypeDeclHandler = declared
    parser.EntityDeclHandler = refuse
    parser.buffer_text = True
    try:
        parser.Parse(path.read_bytes(), True)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check the path") from None
    except xml.parsers.expat.ExpatError as error:
        raise InputError(f"{path}: is not XML: {error}; correct that line") from None
    except (ValueError, LookupError) as error:      # of the decoder that the XML declaration names
        raise InputError(f"{path}: cannot be decoded ({error}); save the file as UTF-8") from None
    return root[0]
