"""The one door through which XML is read: UTF-8 without definitions, of bounded size, depth and number of elements.

Nothing in a file is looked up: entities other than the five of XML itself and document types are refused, and no other
file or address is ever opened.
"""

import re
from typing import Any
from xml.parsers import expat

from jaxscan.errors import JaxscanError
from jaxscan.files.disk.reading import MEGABYTE


MAX_XML_DEPTH = 64
MAX_XML_ELEMENTS = 1 << 18
_CHUNK = 1 << 16
_LONG_TAG = re.compile(rb"<[^<!?][^<]{65536}")
"""A tag whose attributes would take far more memory than their text; long texts stand in CDATA."""
_DECLARATION = re.compile(rb"<!(?!--|\[CDATA\[)")
_QUOTED = re.compile(rb"<!--.*?-->|<!\[CDATA\[.*?\]\]>", re.DOTALL)


class Element:
    """An element of XML, with its own text and its children in their order. Names have their prefixes as written."""

    __slots__ = ("attributes", "children", "parts", "tag")

    def __init__(self, tag: str, attributes: dict[str, str]) -> None:
        self.tag, self.attributes = tag, attributes
        self.children: list[Element] = []
        self.parts: list[str] = []

    @property
    def text(self) -> str:
        """All text directly in it."""
        return "".join(self.parts)

    def find(self, path: str) -> "Element | None":
        """The first element at a path of names below this one; None where there is none."""
        found: Element | None = self
        for tag in path.split("/"):
            found = None if found is None else next((one for one in found.children if one.tag == tag), None)
        return found


def parse_xml(data: bytes, *, name: str, error: type[JaxscanError], limit: int = MEGABYTE) -> Element:
    """The root of an XML document.

    Args:
        data: The whole document, UTF-8, with or without its mark.
        limit: Most bytes.

    Raises:
        JaxscanError: Of type `error`, in one line, if it is longer, not UTF-8, not well-formed, has more than
            `MAX_XML_DEPTH` levels or `MAX_XML_ELEMENTS` elements, or holds definitions.
    """

    def refuse(problem: str) -> JaxscanError:
        return error(f"{name}: {problem}; it is refused.")

    if len(data) > limit:
        raise refuse(f"its XML takes {len(data)} bytes, expected at most {limit}")
    try:
        data.decode()
    except UnicodeDecodeError:
        raise refuse("its XML is not UTF-8") from None
    # Expat finds them too; here nothing of such a document has been parsed.
    if _DECLARATION.search(data) and _DECLARATION.search(_QUOTED.sub(b"", data)):
        raise refuse("its XML holds definitions, which no file here needs")
    if _LONG_TAG.search(data):
        raise refuse("its XML holds a tag or a plain text of more than 64 KiB")
    try:
        return _Builder(refuse).root_of(data)
    except expat.ExpatError as problem:
        raise error(
            f"{name}: its XML is damaged: {expat.ErrorString(problem.code)} in line {problem.lineno}."
        ) from None


class _Builder:
    """Builds the tree of one document from expat's events."""

    def __init__(self, refuse: Any) -> None:
        self._refuse, self._count = refuse, 0
        self._open: list[Element] = []
        self._root: Element | None = None
        # The encoding is stated, so that the document cannot choose another one.
        self._parser = expat.ParserCreate("utf-8")
        self._parser.buffer_text = True
        self._parser.XmlDeclHandler = self._declared
        self._parser.StartElementHandler = self._start
        self._parser.EndElementHandler = self._end
        self._parser.CharacterDataHandler = self._text
        for kind in ("StartDoctypeDecl", "EntityDecl", "UnparsedEntityDecl", "NotationDecl", "ExternalEntityRef"):
            setattr(self._parser, f"{kind}Handler", self._define)

    def root_of(self, data: bytes) -> Element:
        for start in range(0, len(data), _CHUNK):
            self._parser.Parse(data[start : start + _CHUNK], False)
        self._parser.Parse(b"", True)
        if self._root is None:
            raise self._refuse("its XML has no element")
        return self._root

    def _declared(self, version: str, encoding: str | None, standalone: int) -> None:
        if encoding is not None and encoding.lower() not in ("utf-8", "utf8", "us-ascii"):
            raise self._refuse(f"its XML says that it is {encoding:.40}, expected UTF-8")

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        if len(self._open) >= MAX_XML_DEPTH:
            raise self._refuse(f"its XML has more than {MAX_XML_DEPTH} levels")
        self._count += 1
        if self._count > MAX_XML_ELEMENTS:
            raise self._refuse(f"its XML has more than {MAX_XML_ELEMENTS} elements")
        element = Element(tag, attributes)
        if self._open:
            self._open[-1].children.append(element)
        else:
            self._root = element
        self._open.append(element)

    def _end(self, tag: str) -> None:
        self._open.pop()

    def _text(self, text: str) -> None:
        self._open[-1].parts.append(text)

    def _define(self, *_: Any) -> None:
        raise self._refuse("its XML holds definitions, which no file here needs")
