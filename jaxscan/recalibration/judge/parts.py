"""Parts of a rig that move on their own: a laser, the axis, the camera, the table."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxscan.geometry import Scanner, Turntable


class Part(NamedTuple):
    """A part of the rig and how far it may have moved."""

    name: str
    names: tuple[str, ...]
    """Its minimal coordinates."""
    tolerance: tuple[float, ...]
    """Standard deviation of a move, for each of them [px, rad, m]."""
    together: tuple[str, ...] = ()
    """Coordinates that change by the same share of their tolerance: a lens that is refocused keeps square pixels."""


# A part that was knocked is within a degree and a few millimetres of its place.
_TILT, _SHIFT = np.radians(1.0), 5e-3
# A sheet turns about its laser, which is within some 0.1 m of the point of the sheet nearest the camera.
_SHEET = 2e-3
_FOCUS, _CENTRE_PX = 0.01, 20.0
_GAIN, _HARMONIC = 3e-3, 3e-3
# Pixels stay as square as that [1].
_SQUARE = 2e-5


def parts_of(scanner: Scanner) -> tuple[Part, ...]:
    """Parts of which at least one coordinate is not held by the stored calibration; lasers first."""
    focal = float(scanner.camera.fx), float(scanner.camera.fy)
    lasers = [
        Part(f"laser {name}", tuple(f"laser.{name}.{key}" for key in ("n1", "n2", "d")), (_TILT, _TILT, _SHEET))
        for name in scanner.laser_names
    ]
    axis = Part("axis", ("axis.d1", "axis.d2", "axis.p1", "axis.p2"), (_TILT, _TILT, _SHIFT, _SHIFT))
    camera = Part(
        "camera",
        ("fx", "fy", "cx", "cy"),
        (_FOCUS * focal[0], _FOCUS * focal[1], _CENTRE_PX, _CENTRE_PX),
        ("fx", "fy"),
    )
    table = Part("table's angles", ("gain", "c1", "s1", "c2", "s2"), (_GAIN, *(_HARMONIC,) * 4))
    parts = [*lasers, axis, camera, table] if isinstance(scanner.turntable, Turntable) else [*lasers, camera]
    return tuple(part for part in parts if loosening([part], scanner).any())


def loosening(
    parts: Sequence[Part], scanner: Scanner, without: Sequence[str] = ()
) -> Float[np.ndarray, "params params"]:
    """Variance that the moves of parts add to the prior.

    Args:
        parts: The parts that moved.
        scanner: The stored one; the coordinates that its covariance holds stay held.
        without: Coordinates that keep their prior.
    """
    names = scanner.parameter_names()
    added = np.zeros((len(names), len(names)))
    held = np.diag(np.asarray(scanner.covariance)) <= 0
    for part in parts:
        at = {name: names.index(name) for name in part.names if name in names}
        free = {name: i for name, i in at.items() if not held[i] and name not in without}
        sigma = dict(zip(part.names, part.tolerance, strict=True))
        for name, i in free.items():
            share = _SQUARE / _FOCUS if name in part.together else 1.0
            added[i, i] += (share * sigma[name]) ** 2
        common = [name for name in part.together if name in free]
        if common:
            column = np.zeros(len(names))
            column[[free[name] for name in common]] = [sigma[name] for name in common]
            added += np.outer(column, column)
    return added


def describe_move(
    part: Part, names: Sequence[str], step: Float[np.ndarray, " params"], covariance: Float[np.ndarray, "params params"]
) -> str:
    """How far a part moved, in degrees, millimetres, pixels or ppm, with standard deviations.

    Args:
        part: Which.
        names: Of all minimal coordinates.
        step: How far the scanner moved in them.
        covariance: Of that step.
    """
    words = []
    for kind, scale in _UNITS.items():
        here = [i for i, name in enumerate(names) if name in part.names and kind_of(name) == kind]
        size = float(np.linalg.norm(step[here]))
        if size > 0.0:
            along = step[here] / size
            sigma = float(np.sqrt(max(along @ covariance[np.ix_(here, here)] @ along, 0.0)))
            words.append(f"{_digits(scale * size, scale * sigma)} {kind}")
    return ", ".join(words)


_UNITS = {"degrees": float(np.degrees(1.0)), "mm": 1e3, "px": 1.0, "ppm": 1e6}


def kind_of(name: str) -> str:
    """The unit in which people are told of a coordinate; empty for a coefficient."""
    whole, _, last = name.rpartition(".")
    if last in ("n1", "n2", "d1", "d2") or name in ("c1", "s1", "c2", "s2"):
        return "degrees"
    if whole and last in ("d", "p1", "p2"):
        return "mm"
    if name == "gain":
        return "ppm"
    return "px" if name in ("fx", "fy", "cx", "cy") else ""


def unit_of(name: str) -> tuple[str, float]:
    """The unit in which people are told of a coordinate's value, and its factor; a ratio is told as it is."""
    kind = kind_of(name)
    return ("", 1.0) if kind in ("", "ppm") else (kind, _UNITS[kind])


def _digits(value: float, sigma: float) -> str:
    """Value and sigma, both to two digits of the sigma."""
    if sigma <= 0.0:
        return f"{value:.3g}"
    places = max(0, 1 - int(np.floor(np.log10(sigma))))
    return f"{value:.{places}f} ± {sigma:.{places}f}"
