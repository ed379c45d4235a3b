"""What a verb can be given, read from its function and docstring."""

import inspect
import re
import types
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints

import tyro


_LONGEST_CHOICES = 32
"""Choices longer than this are told in the text, not in the place of the value."""


class Entry(NamedTuple):
    """An argument or option of a verb."""

    names: tuple[str, ...]
    """As pages show them, short ones first; none for an argument."""
    value: str
    """Stands for the value; "" for a switch."""
    text: str
    choices: tuple[str, ...] = ()
    required: bool = False
    kind: type = str
    """Of one value."""
    many: int | None = 1
    """How many values there are; None for any number of them."""
    unshown: tuple[str, ...] = ()
    """Names that are understood too: those that switch off what is off."""


def entries_of(function: Callable[..., Any]) -> list[Entry]:
    """All arguments and options of a verb, as its function lists them."""
    hints = get_type_hints(function, include_extras=True)
    told = _told(function)
    parameters = inspect.signature(function).parameters.values()
    return [_entry(one, hints[one.name], told) for one in parameters]


def paragraphs(function: Callable[..., Any]) -> list[str]:
    """The docstring without its list of arguments, one string a paragraph."""
    text = re.split(r"^(?:Args|Raises|Returns):$", inspect.getdoc(function) or "", flags=re.MULTILINE)[0]
    return [" ".join(part.split()) for part in text.split("\n\n") if part.strip()]


def _told(function: Callable[..., Any]) -> dict[str, str]:
    """What the docstring says about each argument."""
    found = re.search(r"^Args:\n((?:    .*\n?|\n)*)", inspect.getdoc(function) or "", flags=re.MULTILINE)
    parts = re.split(r"^    (\w+): ", found[1], flags=re.MULTILINE)[1:] if found else []
    return {name: " ".join(text.split()) for name, text in zip(parts[::2], parts[1::2], strict=True)}


def _entry(parameter: inspect.Parameter, hint: Any, told: Mapping[str, str]) -> Entry:
    kind, marks = _without_marks(hint)
    settings: Any = next((mark for mark in marks if hasattr(mark, "metavar")), tyro.conf.arg())
    name: str = settings.name or parameter.name
    positional = parameter.kind is parameter.POSITIONAL_ONLY or tyro.conf.Positional in marks
    kind = _without_none(kind)
    one, count = _each(kind)
    choices = tuple(map(str, get_args(one))) if get_origin(one) is Literal else ()
    text: str = settings.help or told.get(parameter.name, "")
    default = parameter.default
    required = default is parameter.empty
    if one is bool:
        option = "--" + name.replace("_", "-")
        against = () if tyro.conf.FlagCreatePairsOff in marks else ("--no-" + option.removeprefix("--"),)
        if default is True:
            return Entry((option, *against), "", f"{text} Default: on.", many=0)
        return Entry((option,), "", text, many=0, unshown=against)
    value = settings.metavar or " ".join([_value(name, one, choices, upper=positional)] * (count or 1))
    if count is None:
        value += " ..."
    if choices and "|" not in value:
        text = f"{text} One of {', '.join(choices)}."
    if default not in (None, parameter.empty, ()):
        shown = " ".join(map(str, default)) if isinstance(default, tuple) else str(default)
        text = f"{text} Default: {'this folder' if default == Path() else shown}."
    names = () if positional else (*(settings.aliases or ()), "--" + name.replace("_", "-"))
    kind = one if isinstance(one, type) else str
    return Entry(names, value, text, choices, required, kind, count)


def _without_marks(hint: Any) -> tuple[Any, tuple[Any, ...]]:
    return (get_args(hint)[0], get_args(hint)[1:]) if get_origin(hint) is Annotated else (hint, ())


def _without_none(kind: Any) -> Any:
    if get_origin(kind) not in (Union, types.UnionType):
        return kind
    (left,) = [one for one in get_args(kind) if one is not type(None)]
    return _without_marks(left)[0]


def _each(kind: Any) -> tuple[Any, int | None]:
    """The type of one value, and how many there are; None for any number of them."""
    if get_origin(kind) not in (tuple, list):
        return kind, 1
    inside = get_args(kind)
    if get_origin(kind) is list or inside[-1] is Ellipsis:
        return _without_marks(inside[0])[0], None
    return inside[0], len(inside)


def _value(name: str, one: Any, choices: tuple[str, ...], *, upper: bool) -> str:
    """A plain word that stands for a value."""
    if choices:
        listed = "|".join(choices)
        return listed if len(listed) <= _LONGEST_CHOICES else "NAME"
    if upper:
        return name.upper().replace("_", "-")
    if one in (int, float):
        return "ANGLE" if name.endswith("_deg") else "NUMBER"
    return "PATH" if one is Path else "TEXT"
