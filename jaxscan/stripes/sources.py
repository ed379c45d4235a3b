"""A number that changes with compiled code: numba renews what it keeps on disk where one file changes, not several."""

import zlib
from types import ModuleType

import numpy as np


def fingerprint(*modules: ModuleType) -> int:
    """Of the functions and the constants of some modules, with which compiled code is kept."""
    parts = []
    for module in modules:
        for name, value in sorted(vars(module).items()):
            if hasattr(value, "py_func"):
                code = value.py_func.__code__
                parts.append(f"{name} {code.co_code.hex()} {code.co_consts} {code.co_names} {code.co_varnames}")
            elif isinstance(value, set):
                parts.append(f"{name} {sorted(value)}")
            elif isinstance(value, np.generic | int):
                parts.append(f"{name} {value!r}")
    return zlib.crc32("\n".join(parts).encode())
