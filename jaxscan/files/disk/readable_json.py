"""JSON for people: nested by two spaces, but a row of numbers on one line."""

import json
from typing import Any

import numpy as np


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
