"""Files of settings as trees: the YAML, XML and JSON in which other programs write cameras.

A tree is a dict of trees, a list of trees, or a word. The files may come from anyone, so nothing in them is executed
or looked up.
"""

import re
from collections.abc import Iterator
from typing import Any

import yaml

from jaxscan.errors import CalibrationError
from jaxscan.files.disk import Element, parse_xml


Tree = Any
MAX_NUMBERS = 64
_MAX_LEVELS = 32
_MAX_ENTRIES = 2_000_000
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
    """The tree of the first document of a YAML file; every scalar is a word, and there are no aliases."""
    # The head of OpenCV's files, "%YAML:1.0", is none of YAML.
    text = re.sub(r"\A\ufeff?(?:%[^\n]*\n)*", "", text)
    try:
        events = yaml.parse(text, Loader=yaml.CBaseLoader)
        for event in events:
            if isinstance(event, yaml.NodeEvent):
                return _Builder(events, name).tree(event, 0)
    except yaml.YAMLError as problem:
        mark = getattr(problem, "problem_mark", None)
        line = "" if mark is None else f"line {mark.line + 1}: "
        said = getattr(problem, "problem", None) or str(problem).splitlines()[0]
        raise CalibrationError(f"{name}: {line}not readable as YAML: {said:.100}.") from None
    return {}


class _Builder:
    """Builds a tree of the events of a parser, as long as it is not too deep or too large."""

    def __init__(self, events: Iterator[Any], name: str) -> None:
        self._events, self._name, self._entries = events, name, 0

    def tree(self, event: Any, level: int) -> Tree:
        """The value that begins with an event."""
        self._entries += 1
        if level > _MAX_LEVELS or self._entries > _MAX_ENTRIES:
            raise self._odd(event, f"at most {_MAX_LEVELS} levels and {_MAX_ENTRIES} entries")
        if isinstance(event, yaml.ScalarEvent):
            return event.value
        if isinstance(event, yaml.SequenceStartEvent):
            items = []
            while not isinstance(inner := next(self._events), yaml.SequenceEndEvent):
                items.append(self.tree(inner, level + 1))
            return items
        if not isinstance(event, yaml.MappingStartEvent):
            raise self._odd(event, "no alias")
        table: dict[str, Tree] = {}
        while not isinstance(inner := next(self._events), yaml.MappingEndEvent):
            key = str(self.tree(inner, level + 1))
            if key in table:
                raise self._odd(inner, f"the key {key:.40} only once")
            table[key] = self.tree(next(self._events), level + 1)
        return table

    def _odd(self, event: Any, expected: str) -> CalibrationError:
        return CalibrationError(f"{self._name}: line {event.start_mark.line + 1}: expected {expected}.")


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
    """The numbers of a list, nested or not, of a matrix with `data`, or of a text that commas or blanks part.

    Raises:
        CalibrationError: If there is something else, there are more than 64, or other ones than rows and columns say.
    """
    if isinstance(value, dict):
        if "data" not in value:
            raise CalibrationError(f"{where}: found the keys {', '.join(value)[:60]}, expected numbers in a list.")
        found = numbers(value["data"], where)
        sides = [numbers(value[side], where) for side in ("rows", "cols") if side in value]
        if len(sides) == 2 and all(len(side) == 1 for side in sides) and sides[0][0] * sides[1][0] != len(found):
            raise CalibrationError(
                f"{where}: found {len(found)} numbers, expected {sides[0][0]:g} rows of {sides[1][0]:g}."
            )
        return found
    words = _words(value, where)
    for word in words:
        # 09 is the rest of a number whose comma was meant as its point.
        if not _NUMBER.fullmatch(word) or re.match(r"[-+]?0\d", word):
            raise CalibrationError(
                f"{where}: found {word!r:.40}, expected numbers parted by commas or by blanks, with decimal points."
            )
    return [float(word) for word in words]


def _words(value: Tree, where: str) -> list[str]:
    """The words of all numbers in a value, in their order."""
    found: list[str] = []
    if isinstance(value, list):
        for one in value[: MAX_NUMBERS + 1]:
            # Beside others a text is one number; alone it may be a row of them.
            found += [one.strip()] if isinstance(one, str) and len(value) > 1 else _words(one, where)
    elif isinstance(value, str):
        separator = "," if "," in value else None
        found = [part.strip() for part in value.strip().removesuffix(",").split(separator)]
    elif isinstance(value, bool) or not isinstance(value, int | float):
        raise CalibrationError(f"{where}: found {value!r:.40}, expected numbers in a list.")
    else:
        found = [repr(value)]
    if len(found) > MAX_NUMBERS:
        count = len(value) if isinstance(value, list) else len(found)
        raise CalibrationError(f"{where}: found {count} numbers, expected at most {MAX_NUMBERS}.")
    return found
