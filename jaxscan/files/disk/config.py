"""Data that people write: checks of TOML and JSON by models, and errors that name the place."""

import difflib
import json
import re
import tomllib
import typing
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
import pydantic

from jaxscan.errors import ConfigError, JaxscanError
from jaxscan.files.disk.reading import MAX_DEPTH, MEGABYTE, is_deep, read_bounded, too_deep
from jaxscan.geometry import MAX_PIXELS


class FileModel(pydantic.BaseModel):
    """Base of the models of file contents: frozen, finite numbers, unknown keys refused."""

    model_config = pydantic.ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


# TOML and JSON have types: a number in quotes is a mistake, not a number.
Number = Annotated[float, pydantic.Strict()]
Integer = Annotated[int, pydantic.Strict()]


class ImageSize(FileModel):
    """Width and height of an image [px], of at most `MAX_PIXELS` together."""

    width: Annotated[Integer, pydantic.Field(ge=1, le=65535)]
    height: Annotated[Integer, pydantic.Field(ge=1, le=65535)]

    @pydantic.model_validator(mode="after")
    def _bounded(self) -> "ImageSize":
        if self.width * self.height > MAX_PIXELS:
            raise ValueError(f"{self.width} x {self.height} px are more than {MAX_PIXELS // 1_000_000} megapixels")
        return self


Model = TypeVar("Model", bound=pydantic.BaseModel)


def check(model: type[Model], data: Any, *, name: str, error: type[JaxscanError]) -> Model:
    """The data as a model.

    Args:
        model: A pydantic model.
        data: Parsed TOML or JSON.

    Raises:
        JaxscanError: Of type `error`; one line with the key, the value found and the values allowed, for an
            unknown key the closest known one.
    """
    try:
        return model.model_validate(data)
    except pydantic.ValidationError as problem:
        # Unknown keys first: a missing key is usually the same key, misspelt.
        details = sorted(problem.errors(include_url=False), key=lambda e: e["type"] != "extra_forbidden")
        more = f" (and {len(details) - 1} more)" if len(details) > 1 else ""
        raise error(f"{name}: {_explain(model, data, details[0])}{more}.") from None


def _explain(model: type[pydantic.BaseModel], data: Any, detail: Mapping[str, Any]) -> str:
    location, kind, found = detail["loc"], detail["type"], detail["input"]
    path = _key_path(data, location, missing=kind == "missing")
    if kind == "extra_forbidden":
        return f"{path}: unknown key{_suggest(str(location[-1]), _known_keys(model, location[:-1]))}"
    if kind == "missing":
        return f"{path}: missing"
    if kind in ("union_tag_not_found", "union_tag_invalid"):
        context = detail["ctx"]
        where = _join(path, context["discriminator"].strip("'"))
        if kind == "union_tag_not_found":
            return f"{where}: missing"
        return f"{where}: found {_show(context['tag'])}, expected {context['expected_tags'].replace(chr(39), chr(34))}"
    message = detail["msg"].removeprefix("Value error, ").removesuffix(".")
    if kind == "value_error":
        return f"{path}: {message}" if path else message
    message = message.replace("Input should be ", "expected ").replace("a valid tuple", "a list")
    if message.startswith("expected a valid dictionary"):
        message = "expected a table"
    return f"{path or 'the file'}: found {_show(found)}, {message.replace(chr(39), chr(34))}"


def _key_path(data: Any, location: tuple[Any, ...], *, missing: bool) -> str:
    """The keys as in the file; pydantic's location also names branches of unions."""
    path = ""
    for depth, item in enumerate(location):
        absent = missing and depth == len(location) - 1
        if isinstance(data, Mapping) and isinstance(item, str) and (item in data or absent):
            path, data = _join(path, item), data.get(item)
        elif isinstance(data, list | tuple) and isinstance(item, int):
            path, data = f"{path}[{item}]", data[item] if item < len(data) else None
    return path


def _join(path: str, key: str) -> str:
    # A key of an untrusted file may be of any length, and hold line breaks.
    key = key if len(key) <= 60 else key[:57] + "..."
    key = key if key.isprintable() else json.dumps(key)
    return f"{path}.{key}" if path else key


def _show(value: Any) -> str:
    if isinstance(value, Mapping):
        return "a table"
    try:
        text = json.dumps(value, ensure_ascii=False)
    except (TypeError, ValueError):
        text = str(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _suggest(key: str, known: list[str]) -> str:
    if close := difflib.get_close_matches(key, known, n=1, cutoff=0.5):
        return f'; the closest known one is "{close[0]}"'
    return f"; known here: {', '.join(known)}" if known else ""


def _known_keys(model: type[pydantic.BaseModel], location: tuple[Any, ...]) -> list[str]:
    level = [model]
    for item in location:
        inner = [
            part
            for one in level
            for name, field in one.model_fields.items()
            if item in (name, field.alias)
            for part in _models_in(field.annotation)
        ]
        # Where the item is no key, it is an index or the tag that chose a branch of a union.
        level = inner or [one for one in level if _is_tagged(one, item)] or level
    return sorted({field.alias or name for one in level for name, field in one.model_fields.items()})


def _is_tagged(model: type[pydantic.BaseModel], tag: Any) -> bool:
    return model.__name__ == tag or any(
        tag in typing.get_args(field.annotation)
        for field in model.model_fields.values()
        if typing.get_origin(field.annotation) is typing.Literal
    )


def _models_in(annotation: Any) -> Iterator[type[pydantic.BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, pydantic.BaseModel):
        yield annotation
    for part in typing.get_args(annotation):
        yield from _models_in(part)


MAX_CONFIG_BYTES = MEGABYTE
MAX_PARTS = MAX_DEPTH
"""Most parts of a dotted key, such as 3 in `laser.plane.normal`: Python's reader takes the square of their number."""
MAX_TABLES = 30_000
"""Most heads of tables: Python's reader takes 0.1 ms for each. A project may have 10,000 rigs, patterns and groups."""
_HEAD = re.compile(r"^[ \t]*+\[", re.MULTILINE)

# Comments and texts of many lines are passed over; then a key, or another word, with its dotted parts. Nothing is
# tried twice, so the time is in proportion to the length. What follows the first syntax error does not matter.
_PART = r"""(?:"(?:[^"\\\n]++|\\.?)*+(?:"|$)|'[^'\n]*+(?:'|$)|[A-Za-z0-9_-]++)"""
_DOT = r"[ \t]*+\.[ \t]*+"
_KEYS = re.compile(
    r"#[^\n]*+"
    r'|"""(?:[^"\\]++|\\(?:.|\n)?|"(?!""))*+(?:"{3,5}+|\Z)'
    r"|'''(?:[^']++|'(?!''))*+(?:'{3,5}+|\Z)"
    rf"|{_PART}(?:{_DOT}{_PART}){{0,{MAX_PARTS - 1}}}+(?P<more>{_DOT}{_PART})?+",
    re.MULTILINE,
)


def load_toml(path: str | Path, model: type[Model]) -> Model:
    """A configuration file as a model.

    Args:
        path: A TOML file of at most 1 MiB.
        model: A pydantic model; give it `extra="forbid"`, so that a misspelt key is an error.

    Raises:
        ConfigError: One line: the file, the line or the key, the value found and the values allowed; for an
            unknown key the closest known one.
    """
    name, data = str(path), read_bounded(path, MAX_CONFIG_BYTES, error=ConfigError)
    return check(model, parse_toml(data, name=name, error=ConfigError), name=name, error=ConfigError)


def parse_toml(data: bytes, *, name: str, error: type[JaxscanError]) -> dict[str, Any]:
    """The tables of a TOML text.

    Raises:
        JaxscanError: Of type `error`, with the line of the first syntax error; also for keys of more than `MAX_PARTS`
            parts, more than `MAX_TABLES` tables, and tables nested more than `MAX_DEPTH` deep.
    """
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as problem:
        line = data[: problem.start].count(b"\n") + 1
        raise error(f"{name}: line {line}: not UTF-8 text.") from problem
    for found in _KEYS.finditer(text):
        if found["more"]:
            line = text.count("\n", 0, found.start()) + 1
            raise error(f"{name}: line {line}: found a key of more than {MAX_PARTS} dotted parts, expected fewer.")
    # Lines of texts and lists that look like heads are counted too.
    heads = sum(1 for _ in _HEAD.finditer(text))
    if heads > MAX_TABLES:
        raise error(f"{name}: found {heads} tables, expected at most {MAX_TABLES}.")
    try:
        tables = tomllib.loads(text)
    except RecursionError as problem:
        raise error(too_deep(name)) from problem
    except ValueError as problem:
        raise error(f"{name}: not valid TOML: {problem}.") from problem
    if is_deep(tables):
        raise error(too_deep(name))
    return tables


def readable_json(value: Any) -> str:
    """The text of a JSON value; floats are written so that they are read back to the last bit.

    Raises:
        ValueError: If a number is not finite.
        TypeError: If something is neither JSON nor a NumPy number or array.
    """
    return _text(value, "") + "\n"


def _text(value: Any, indent: str) -> str:
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    inner = indent + "  "
    if isinstance(value, dict) and value:
        items = [f"{inner}{json.dumps(str(key))}: {_text(item, inner)}" for key, item in value.items()]
        return "{\n" + ",\n".join(items) + f"\n{indent}}}"
    if isinstance(value, list | tuple) and any(isinstance(item, list | tuple | dict | np.ndarray) for item in value):
        return "[\n" + ",\n".join(inner + _text(item, inner) for item in value) + f"\n{indent}]"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_text(item, inner) for item in value) + "]"
    return json.dumps(value, allow_nan=False)
