"""Configuration: TOML into frozen pydantic models that reject unknown keys."""

import tomllib
from pathlib import Path
from typing import Any

from jaxscan.errors import ConfigError, JaxscanError
from jaxscan.files.disk.opening import MEGABYTE, read_bounded
from jaxscan.files.disk.validation import Model, check


MAX_CONFIG_BYTES = MEGABYTE


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
        JaxscanError: Of type `error`, with the line of the first syntax error.
    """
    try:
        return tomllib.loads(data.decode("utf-8"))
    except UnicodeDecodeError as problem:
        line = data[: problem.start].count(b"\n") + 1
        raise error(f"{name}: line {line}: not UTF-8 text.") from problem
    except (ValueError, RecursionError) as problem:
        raise error(f"{name}: not valid TOML: {problem}.") from problem
