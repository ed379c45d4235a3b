"""Files of settings as trees: the YAML, XML and JSON in which other programs write cameras.

A tree is a dict of trees, a list of trees, or a word. The files may come from anyone, so nothing in them is executed
or looked up; a list in brackets stays one word until somebody asks for its `numbers`, whatever its length.
"""

import re
from collections.abc import Iterator
from typing import Any

from jaxscan.errors import CalibrationError
from jaxscan.files.disk import Element, parse_xml


Tree = Any
MAX_NUMBERS = 64
"""Most numbers of one list."""
_MAX_LEVELS = 32
_MAX_ENTRIES = 100_000
_KEY = re.compile(r"""("[^"\n]*"|'[^'\n]*'|[^\s\[\]{}#,&*!|>'"%@`-][^:\[\]{}#,"']{0,99}?)\s*:(?=\s|$|[^:/\\])(.*)""")
_TAG = re.compile(r"!\S*\s*")
_NUMBER = re.compile(r"[-+]?(?:\.\d+|\d+\.?\d*)(?:[eE][-+]?\d+)?")
_LONG_TEXT = re.compile(rb">[^<]{65536,}<")


def tree_of_xml(data: bytes, name: str, limit: int) -> Tree:
    """The tree of an XML file of OpenCV's FileStorage."""
    # Image points are longer than any XML may be here; a camera is not.
    root = parse_xml(_LONG_TEXT.sub(b"><", data), name=name, error=CalibrationError, limit=limit)
    if root.tag != "opencv_storage":
        raise CalibrationError(
            f"{name}: found <{root.tag:.40}>, expected <opencv_storage>, the XML of OpenCV; export the camera for "
            "OpenCV."
        )
    return _of_element(root)


def _of_element(element: Element) -> Tree:
    if not element.children:
        return element.text.strip()
    if all(child.tag == "_" for child in element.children):
        return [_of_element(child) for child in element.children]
    return {child.tag: _of_element(child) for child in element.children}


def tree_of_yaml(text: str, name: str) -> Tree:
    """The tree of a YAML file: blocks of keys and of dashes, and lists and tables in brackets."""
    return _Yaml(list(_logical_lines(text, name)), name).tree()


def _logical_lines(text: str, name: str) -> Iterator[tuple[int, int, str]]:
    """Number, indentation and text of each line that says something; brackets are closed on the line they open on."""
    waiting: list[str] = []
    opened = start = indent = 0
    for number, line in enumerate(text.removeprefix("\ufeff").splitlines(), 1):
        said = line.strip()
        if not said or said[0] == "#" or (not waiting and (line[0] == "%" or said in ("---", "..."))):
            continue
        if "#" in said and '"' not in said and "'" not in said:
            said = re.split(r"\s#", said, maxsplit=1)[0].rstrip()
        if not waiting:
            start, indent = number, len(line) - len(line.lstrip())
        waiting.append(said)
        if '"' not in said and "'" not in said:
            opened += said.count("[") + said.count("{") - said.count("]") - said.count("}")
        if opened <= 0:
            yield start, indent, " ".join(waiting)
            waiting, opened = [], 0
    if waiting:
        raise CalibrationError(f"{name}: line {start}: found {waiting[0]!r:.40}, expected its brackets closed.")


class _Yaml:
    def __init__(self, lines: list[tuple[int, int, str]], name: str) -> None:
        self._lines, self._name, self._at, self._entries = lines, name, 0, 0

    def tree(self) -> Tree:
        if not self._lines:
            return {}
        found = self._block(self._lines[0][1], 0)
        if self._at < len(self._lines):
            raise self._odd("a line that is indented like those before it")
        return found

    def _block(self, indent: int, level: int) -> Tree:
        """The value that begins at the present line, with this indentation."""
        if level > _MAX_LEVELS:
            raise CalibrationError(f"{self._name}: nested too deeply, expected at most {_MAX_LEVELS} levels.")
        text = self._lines[self._at][2]
        if text == "-" or text.startswith("- "):
            return self._items(indent, level)
        if _KEY.fullmatch(text):
            return self._table(indent, level)
        self._at += 1
        return self._value(text, indent, level)

    def _items(self, indent: int, level: int) -> list[Tree]:
        items: list[Tree] = []
        while self._at < len(self._lines) and self._lines[self._at][1] == indent:
            number, _, text = self._lines[self._at]
            if text != "-" and not text.startswith("- "):
                break
            self._count()
            rest = text[1:].lstrip()
            if rest:
                inner = indent + len(text) - len(rest)
                self._lines[self._at] = (number, inner, rest)
                items.append(self._block(inner, level + 1))
            else:
                self._at += 1
                items.append(self._below(indent, level, dashes=False))
        return items

    def _table(self, indent: int, level: int) -> dict[str, Tree]:
        table: dict[str, Tree] = {}
        while self._at < len(self._lines) and self._lines[self._at][1] == indent:
            found = _KEY.fullmatch(self._lines[self._at][2])
            if not found:
                raise self._odd('"key: value"')
            self._count()
            key, rest = found[1].strip("\"'").strip(), found[2].strip()
            if key in table:
                raise self._odd(f"the key {key:.40} only once")
            rest = _TAG.sub("", rest, count=1) if rest.startswith("!!opencv-") else rest
            self._at += 1
            table[key] = self._value(rest, indent, level) if rest else self._below(indent, level, dashes=True)
        return table

    def _below(self, indent: int, level: int, *, dashes: bool) -> Tree:
        """The block under a key or dash; dashes may stand right under a key."""
        if self._at == len(self._lines):
            return ""
        _, inner, text = self._lines[self._at]
        if inner > indent or (dashes and inner == indent and (text == "-" or text.startswith("- "))):
            return self._block(inner, level + 1)
        return ""

    def _value(self, text: str, indent: int, level: int) -> Tree:
        """A word, with the lines on which it goes on; a table in braces as a table."""
        if text[0] == "{":
            return self._braces(text, level)
        said = [text]
        while self._at < len(self._lines) and self._lines[self._at][1] > indent:
            said.append(self._lines[self._at][2])
            self._at += 1
        return " ".join(said).strip()

    def _braces(self, text: str, level: int) -> dict[str, Tree]:
        if level > _MAX_LEVELS or not text.endswith("}"):
            raise CalibrationError(f"{self._name}: found {text!r:.40}, expected a table in braces.")
        table: dict[str, Tree] = {}
        for part in _parts(text[1:-1]):
            self._count()
            key, colon, rest = part.partition(":")
            if not colon:
                raise CalibrationError(f'{self._name}: found {part!r:.40} in braces, expected "key: value".')
            rest = rest.strip()
            table[key.strip().strip("\"'")] = self._braces(rest, level + 1) if rest.startswith("{") else rest
        return table

    def _count(self) -> None:
        self._entries += 1
        if self._entries > _MAX_ENTRIES:
            raise CalibrationError(f"{self._name}: has more than {_MAX_ENTRIES} entries, expected a camera.")

    def _odd(self, expected: str) -> CalibrationError:
        number, _, text = self._lines[self._at if self._at < len(self._lines) else -1]
        return CalibrationError(f"{self._name}: line {number}: found {text!r:.40}, expected {expected}.")


def _parts(text: str) -> Iterator[str]:
    """The parts between commas that are in no inner bracket."""
    level, start = 0, 0
    for found in re.finditer(r"[\[\]{},]", text):
        sign = found[0]
        level += (sign in "[{") - (sign in "]}")
        if sign == "," and level == 0:
            yield text[start : found.start()].strip()
            start = found.end()
    if rest := text[start:].strip():
        yield rest


def leaves(tree: Tree, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Tree]]:
    """All values below tables, each with the keys that lead to it; a matrix with `data` is one value.

    Points within keys, as in `Camera.fx`, count as tables.
    """
    if isinstance(tree, dict) and "data" not in tree:
        for key, value in tree.items():
            yield from leaves(value, (*path, *str(key).split(".")))
    elif isinstance(tree, list) and any(isinstance(one, dict) for one in tree):
        for number, value in enumerate(tree):
            yield from leaves(value, (*path, str(number)))
    else:
        yield path, tree


def numbers(value: Tree, where: str) -> list[float]:
    """The numbers of a list, nested or not, of a matrix with `data`, or of one word.

    They are parted by commas or blanks.
    """
    if isinstance(value, dict):
        found = numbers(value["data"], where) if "data" in value else None
        if found is None:
            raise CalibrationError(f"{where}: found the keys {', '.join(value)[:60]}, expected numbers in a list.")
        sides = [numbers(value[side], where) for side in ("rows", "cols") if side in value]
        if len(sides) == 2 and all(len(side) == 1 for side in sides) and sides[0][0] * sides[1][0] != len(found):
            raise CalibrationError(
                f"{where}: found {len(found)} numbers, expected {sides[0][0]:g} rows of {sides[1][0]:g}."
            )
        return found
    words: list[str] = []
    _collect(value, words, where)
    for word in words:
        # 09 is the rest of a number whose comma was meant as its point.
        if not _NUMBER.fullmatch(word) or re.match(r"[-+]?0\d", word):
            raise CalibrationError(
                f"{where}: found {word!r:.40}, expected numbers parted by commas or by blanks, with decimal points."
            )
    return [float(word) for word in words]


def _collect(value: Tree, words: list[str], where: str) -> None:
    """The words of all numbers in a value, in their order."""
    if isinstance(value, list):
        if len(value) > MAX_NUMBERS:
            raise CalibrationError(f"{where}: found {len(value)} numbers, expected at most {MAX_NUMBERS}.")
        for one in value:
            _collect(one, words, where)
    elif isinstance(value, str):
        body = value.strip()
        body = body[1:-1] if body[:1] in "\"'" and body[-1:] == body[:1] and len(body) > 1 else body
        separator = "," if "," in body else None
        if body.count(",") > MAX_NUMBERS or len(body) > 64 * MAX_NUMBERS:
            count = body.count(",") + 1 if separator else len(body.split())
            raise CalibrationError(f"{where}: found {count} numbers, expected at most {MAX_NUMBERS}.")
        bare = _without_brackets(body, where)
        parts = [part.strip() for part in bare.split(separator)]
        if separator and not parts[-1]:
            parts.pop()
        words.extend(parts)
    elif isinstance(value, bool) or value is None or not isinstance(value, int | float):
        raise CalibrationError(f"{where}: found {value!r:.40}, expected numbers in a list.")
    else:
        words.append(repr(value))
    if len(words) > MAX_NUMBERS:
        raise CalibrationError(f"{where}: found {len(words)} numbers, expected at most {MAX_NUMBERS}.")


def _without_brackets(text: str, where: str) -> str:
    level = 0
    for sign in re.findall(r"[\[\]]", text):
        level += 1 if sign == "[" else -1
        if level < 0:
            break
    if level != 0:
        raise CalibrationError(f"{where}: found {text!r:.40}, expected as many [ as ].")
    return re.sub(r"[\[\]]", " ", text)
