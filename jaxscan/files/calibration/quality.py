"""The quality of a calibration as JSON: written key by key, read from files of any origin."""

import dataclasses
import math
import types
import typing
from typing import Any

import numpy as np

from jaxscan.calibration import Quality


# Beyond these nothing can be meant, and formatting and arithmetic would fail.
_LARGEST, _LARGEST_INTEGER = 1e100, 2**53


def quality_table(quality: Quality) -> dict[str, Any]:
    """The quality as JSON; keys that nothing is known of are left out."""
    if quality == Quality():
        return {}
    known = lambda items: {key: value for key, value in items if value is not None}
    return finite(dataclasses.asdict(quality, dict_factory=known))


def read_quality(table: dict[str, Any]) -> Quality:
    """The quality that a file tells.

    A key whose value is not of its kind counts as missing, and unknown keys are ignored: a calibration
    can be used whatever its file says of its quality.
    """
    kinds, known = typing.get_type_hints(Quality), {}
    for key in kinds.keys() & table.keys():
        try:
            known[key] = _read(kinds[key], table[key])
        except _NotOfItsKind:
            continue
    return Quality(**known)


def finite(value: Any) -> Any:
    """The same with null for a number that is not finite, which JSON cannot hold (a prior switched off)."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


class _NotOfItsKind(Exception):
    """A value that its key cannot have."""


def _read(kind: Any, value: Any) -> Any:
    """A JSON value as an annotated type: dataclasses, tuples, tables of numbers, numbers, text, truth values."""
    origin, parts = typing.get_origin(kind), typing.get_args(kind)
    if origin is types.UnionType:
        return None if value is None else _read(parts[0], value)
    if isinstance(kind, type) and dataclasses.is_dataclass(kind) and isinstance(value, dict):
        kinds = typing.get_type_hints(kind)
        given = {key: _read(kinds[key], value[key]) for key in kinds.keys() & value.keys()}
        if all(field.name in given or field.default is not dataclasses.MISSING for field in dataclasses.fields(kind)):
            return kind(**given)
    elif origin is tuple and isinstance(value, list):
        if parts[-1] is ...:
            return tuple(_read(parts[0], item) for item in value)
        if len(parts) == len(value):
            return tuple(_read(part, item) for part, item in zip(parts, value, strict=True))
    elif origin is dict and isinstance(value, dict):
        return {key: _read(parts[1], item) for key, item in value.items()}
    elif kind in (bool, str) and isinstance(value, kind):
        return value
    elif kind is int and type(value) is int and abs(value) <= _LARGEST_INTEGER:
        return value
    elif kind is float and type(value) in (int, float) and abs(value) <= _LARGEST:
        return float(value)
    raise _NotOfItsKind
