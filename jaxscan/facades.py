"""Facades: packages whose names are loaded at their first use.

The `__init__.py` of a facade lists its names as imports for type checkers alone, and calls `load_on_use` for everybody
else. So `import jaxscan.calibration` loads no module of it, `from jaxscan.calibration import Calibration` loads the one
that defines it, and a verb pays for what it uses.
"""

import sys


TYPE_CHECKING = False
if TYPE_CHECKING:
    from types import ModuleType
else:
    # Nothing is loaded before signals are heard.
    ModuleType = type(sys)


def load_on_use(package: str, *others: str) -> None:
    """Make a package a facade: a name that its `__init__.py` lists is imported when it is first used.

    Args:
        package: Its `__name__`.
        others: Public names that it defines itself.
    """
    module = sys.modules[package]
    module.__class__ = _Facade
    # Past `_Facade.__setattr__`, which asks for them.
    module.__dict__["_homes"], module.__dict__["_others"] = None, others


class _Facade(ModuleType):
    _homes: dict[str, tuple[str, str]] | None
    """None before the list is read."""
    _others: tuple[str, ...]

    def __getattr__(self, name: str) -> object:
        if name == "__all__":
            return dir(self)
        if name.startswith("__") or name not in self._listed():
            raise AttributeError(f"module {self.__name__!r} has no attribute {name!r}")
        import importlib

        home, there = self._listed()[name]
        # A facade that lists a name of its own means its module of that name.
        own = home == self.__name__
        value = importlib.import_module(f"{home}.{there}") if own else getattr(importlib.import_module(home), there)
        self.__dict__[name] = value
        return value

    def __setattr__(self, name: str, value: object) -> None:
        # Whoever imports `reconstruction/reconstruct.py` puts the module here; the function of that name is meant.
        if not (isinstance(value, ModuleType) and name in self._listed()):
            super().__setattr__(name, value)

    def __dir__(self) -> list[str]:
        return sorted({*self._others, *self._listed()})

    def _listed(self) -> dict[str, tuple[str, str]]:
        """The module of every name, and its name there."""
        if self._homes is None:
            # Split into words: loading a parser takes longer, and a signal may come before anything is loaded.
            with open(str(self.__file__), encoding="utf-8") as file:
                listed = file.read().partition("if TYPE_CHECKING:")[2].partition("else:")[0]
            homes: dict[str, tuple[str, str]] = {}
            for line in listed.split("from ")[1:]:
                home, names = line.split(" import ")
                for name in names.strip("() \n").split(","):
                    there, _, here = name.strip().partition(" as ")
                    homes[here or there] = home, there
            homes.pop("", None)
            self.__dict__["_homes"] = homes
        return self._homes or {}
