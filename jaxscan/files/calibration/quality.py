"""The quality of a calibration as JSON: written key by key, read from files of any origin."""

import dataclasses
import functools
import json
import math
from typing import Any

import numpy as np
import pydantic

from jaxscan.calibration import Quality


# Larger numbers are nonsense, and formatting and arithmetic would fail.
_LARGEST, _LARGEST_INTEGER, _DEEPEST = 1e100, 2**53, 20


def quality_table(quality: Quality) -> dict[str, Any]:
    """The quality as JSON; keys without a value are left out."""
    if quality == Quality():
        return {}
    known = lambda items: {key: value for key, value in items if value is not None}
    return finite(dataclasses.asdict(quality, dict_factory=known))


def read_quality(table: dict[str, Any]) -> Quality:
    """The quality from the table of a file.

    A key whose value has the wrong type counts as missing, and unknown keys are ignored: a calibration
    can be used even if the quality in its file is damaged.
    """
    known = {}
    for key, value in table.items():
        try:
            if key in Quality.__dataclass_fields__ and _is_usable(value):
                # Strict JSON: no number in quotes, no truth value as a number, but a list for a tuple.
                alone = _adapter().validate_json(json.dumps({key: value}), strict=True)
                known[key] = getattr(alone, key)
        except pydantic.ValidationError:
            continue
    return Quality(**known)


_adapter = functools.cache(lambda: pydantic.TypeAdapter(Quality))


def _is_usable(value: Any, depth: int = 0) -> bool:
    """Whether a JSON value is not nested too deeply, and its numbers are not too large."""
    if isinstance(value, dict | list):
        items = value.values() if isinstance(value, dict) else value
        return depth < _DEEPEST and all(_is_usable(item, depth + 1) for item in items)
    return not isinstance(value, int | float) or abs(value) <= (_LARGEST_INTEGER if type(value) is int else _LARGEST)


def finite(value: Any) -> Any:
    """The same value with null for numbers that are not finite, which JSON cannot hold (a prior switched off)."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
