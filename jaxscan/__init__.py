"""A camera, a line laser and a turntable as a precise 3D scanner for rooms.

`__init__.pyi` lists the public names and their modules. A name is loaded at its first use, and the list too:
`import jaxscan` loads nothing, so that the command line hears a signal from its first milliseconds on.
"""

__version__ = "0.1.0"
_homes: dict[str, str] = {}
"""The module of every public name."""


def __getattr__(name: str) -> object:
    value: object
    if name == "__all__":
        value = sorted(["__version__", *_read_homes()])
    elif name.startswith("__") or name not in _read_homes():
        raise AttributeError(f"module 'jaxscan' has no attribute {name!r}")
    else:
        import importlib

        value = getattr(importlib.import_module(_homes[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(["__version__", *_read_homes()])


def _read_homes() -> dict[str, str]:
    if not _homes:
        import re
        from pathlib import Path

        listed = Path(__file__).with_suffix(".pyi").read_text()
        found = re.findall(r"^from (\S+) import (\w+) as \2$", listed, re.MULTILINE)
        _homes.update((name, module) for module, name in found)
    return _homes
