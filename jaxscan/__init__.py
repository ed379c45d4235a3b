"""A camera, a line laser and a turntable as a precise 3D scanner for rooms.

`__init__.pyi` lists the public names and their modules. A name is loaded at its first use, so `import jaxscan` itself
is fast.
"""

import importlib
import re
from pathlib import Path
from typing import Any


__version__ = "0.1.0"

_HOMES = {
    name: module
    for module, name in re.findall(
        r"^from (\S+) import (\w+) as \2$", Path(__file__).with_suffix(".pyi").read_text(), re.MULTILINE
    )
}
__all__ = sorted(["__version__", *_HOMES])


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'jaxscan' has no attribute {name!r}")
    value = getattr(importlib.import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
