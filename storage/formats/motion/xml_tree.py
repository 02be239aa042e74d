"""Parse XML files safely: no document type, no entities, and limited numbers of elements."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element
from xml.parsers import expat

from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.reader import file_size
from kinedex.storage.formats.motion.text_blocks import BLOCK, LONGEST

MOST_ELEMENTS, DEEPEST = 500_000, 100
"""The largest number of elements, and the largest depth of nested elements."""


LONGEST_TEXT = 1 << 20
"""The largest number of characters in an element."""


class _Tree:
    """The handlers of the parser, which build the tree; elements with given names are skipped with their content."""

    def __init__(self, path: Path, parser: expat.XMLParserType, skipped: Collection[str]) -> None:
        self._path, self._parser, self._skipped = path, parser, frozenset(skipped)
        self._open = [Element("")]
        self._count = self._hidden = 0

    @property
    def root(self) -> Element:
        return self._open[0][0]

    def _error(self, message: str) -> SourceError:
        return SourceError(self._path, message, line=self._parser.CurrentLineNumber)

    def doctype(self, *_: Any) -> None:
        raise self._error("has a document type declaration, which is not read: remove it")

    def start(self, name: str, attributes: dict[str, str]) -> None:
        self._count += 1
        if self._count > MOST_ELEMENTS or len(self._open) + self._hidden > DEEPEST:
            raise self._error(f"has more than {MOST_ELEMENTS} elements, or more than {DEEPEST} inside each other")
        if self._hidden or name in self._skipped:
            self._hidden += 1
            return
        element = Element(name, attributes)
        self._open[-1].append(element)
        self._open.append(element)

    def end(self, _: str) -> None:
        if self._hidden:
            self._hidden -= 1
        else:
            self._open.pop()

    def characters(self, text: str) -> None:
        if self._hidden or len(self._open[-1]):
            return
        whole = (self._open[-1].text or "") + text
        if len(whole) > LONGEST_TEXT:
            raise self._error(f"has a text of more than {LONGEST_TEXT >> 20} MB in one element")
        self._open[-1].text = whole


def parse_xml(path: Path, skipped: Collection[str] = ()) -> Element:
    """Read an XML file as a tree.

    Parameters
    ----------
    path : Path
        The file.
    skipped : collection of str, optional
        Names of elements that are skipped with their content.

    Returns
    -------
    Element
        The root; the text of an element is that before its first child.

    Raises
    ------
    SourceError
        The file cannot be read, is not XML, has a document type declaration, or is beyond a limit.
    """
    if file_size(path) > LONGEST:
        raise SourceError(path, f"has more than {LONGEST >> 20} MB, which no model of a body has")
    parser = expat.ParserCreate()
    tree = _Tree(path, parser, skipped)
    parser.buffer_text = True
    parser.StartDoctypeDeclHandler = tree.doctype
    parser.StartElementHandler, parser.EndElementHandler = tree.start, tree.end
    parser.CharacterDataHandler = tree.characters
    try:
        with path.open("rb") as file:
            while data := file.read(BLOCK):
                parser.Parse(data, False)
        parser.Parse(b"", True)
    except expat.ExpatError as fault:
        raise SourceError(path, f"is not XML: {expat.ErrorString(fault.code)}", line=fault.lineno) from None
    except (ValueError, LookupError) as fault:
        raise SourceError(path, f"is in an encoding that is not read: {fault}") from None
    except OSError as fault:
        raise SourceError(path, f"cannot be read: {fault.strerror}") from fault
    return tree.root
