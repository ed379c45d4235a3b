"""The camera models, by name; the file of a model has its name, and is loaded when the model is first used."""

import functools
from collections.abc import Iterator, Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Literal


if TYPE_CHECKING:
    from jaxscan.geometry.cameras.camera import AbstractCamera

MODELS: dict[str, tuple[str, ...]] = {
    "pinhole": ("radial", "tangential", "k3", "rational"),
    "fisheye": ("radial",),
    "double_sphere": ("sphere",),
}
"""The models with the names of their blocks of coefficients. To add one: a file of its name with its class, and a line
here, whose names `--lens`, `--free` and `--hold` offer."""

if TYPE_CHECKING:
    CameraModel = str
else:
    CameraModel = Literal[tuple(MODELS)]


class _Models(Mapping[str, "type[AbstractCamera]"]):
    def __getitem__(self, name: str) -> "type[AbstractCamera]":
        if name not in MODELS:
            raise KeyError(name)
        return _load(name)

    def __iter__(self) -> Iterator[str]:
        return iter(MODELS)

    def __len__(self) -> int:
        return len(MODELS)


@functools.cache
def _load(name: str) -> "type[AbstractCamera]":
    file = import_module(f"jaxscan.geometry.cameras.{name}")
    return next(one for one in vars(file).values() if isinstance(one, type) and getattr(one, "model", None) == name)


CAMERAS: Mapping[str, "type[AbstractCamera]"] = _Models()
"""All camera models by name."""
