"""Configuration: TOML into frozen pydantic models that reject unknown keys."""

import re
import tomllib
from pathlib import Path
from typing import Any

from jaxscan.errors import ConfigError, JaxscanError
from jaxscan.files.disk.bounded import MAX_DEPTH, is_deep, too_deep
from jaxscan.files.disk.opening import MEGABYTE, read_bounded
from jaxscan.files.disk.validation import Model, check


MAX_CONFIG_BYTES = MEGABYTE
MAX_PARTS = MAX_DEPTH
"""Most parts of a dotted key, such as 3 in `laser.plane.normal`: Python's reader takes the square of their number."""
MAX_TABLES = 30_000
"""Most heads of tables: Python's reader takes 0.1 ms for each. A project may have 10,000 rigs, patterns and groups."""
_HEAD = re.compile(r"^[ \t]*+\[", re.MULTILINE)

# Comments and texts of many lines are passed over; then a key, or another word, with its dotted parts. Nothing is
# tried twice, so the time is in proportion to the length. Behind the first error of syntax nothing matters.
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

    Returns:
        The validated model.

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
