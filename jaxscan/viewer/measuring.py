"""What was picked and measured, with the uncertainties that `jaxscan measure` gives."""

import csv
import io
import json
import shlex
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

import numpy as np

from jaxscan.errors import MeasurementError
from jaxscan.geometry import Scanner
from jaxscan.measurement import (
    PlaneMeasurement,
    length_words,
    measure_angle,
    measure_distance,
    measure_height,
    measure_plane,
    measure_room,
)
from jaxscan.viewer.shown import ShownCloud


Kind = Literal["point", "distance", "height", "angle", "area", "flatness", "room", "box"]
DISTANCE_RADIUS_M = 0.02
PLANE_RADIUS_M = 0.2
"""Both radii are those of `jaxscan measure`."""
_DECIMALS = 4
"""Decimals of picked coordinates [m]: what is listed is what was measured."""
_LEAST = 4
_FORMULA = ("=", "+", "-", "@")
_OPTIONS = ("calibration", "unit", "up")
_PLACES = ("x1_m", "y1_m", "z1_m", "x2_m", "y2_m", "z2_m")
_COLUMNS = ("kind", "what", "cloud", *_PLACES, "value_m", "sigma_m", "words", "value", "sigma", "unit")
_MOST_PLACES = 100


class Measured(NamedTuple):
    """One measurement."""

    kind: Kind
    what: str
    """Name of the value: "distance", "RMS", "length", "width", "height", "angle", "area" or "volume"; "" where there is
    none."""
    cloud: str
    at: np.ndarray
    """The picked places, or the ends of a length of the room [k, 3], m, in the cloud's frame."""
    value: float | None
    """Value in `unit`; None for a point."""
    sigma: float | None
    """Standard deviation in `unit`; None where it is unknown."""
    words: tuple[str, ...]
    plane: PlaneMeasurement | None = None
    turned: bool = False
    """Whether the axes are not those of the cloud's file."""
    options: Mapping[str, str] = MappingProxyType({})
    """Words of `jaxscan measure` that measure the same."""
    unit: Literal["m", "deg", "m2", "m3"] = "m"

    @property
    def value_m(self) -> float | None:
        """The value of a length [m]."""
        return self.value if self.unit == "m" else None

    @property
    def sigma_m(self) -> float | None:
        """Its standard deviation [m]."""
        return self.sigma if self.unit == "m" else None

    def command(self) -> str:
        """The command that measures the same; "" if there is none."""
        if self.turned and self.kind != "room":
            return ""
        file = shlex.quote(self.cloud)
        calibration, unit, up = (f" {self.options[name]}" if name in self.options else "" for name in _OPTIONS)
        places = [" ".join(f"{x:.{_DECIMALS}f}" for x in place) for place in self.at]
        match self.kind:
            case "distance":
                return f"jaxscan measure distance {file} --a {places[0]} --b {places[1]}{calibration}{unit}"
            case "flatness":
                return f"jaxscan measure plane {file} --at {places[0]}{unit}"
            case "room":
                return f"jaxscan measure room {file}{calibration}{unit}{up}"
            case _:
                return ""


def rounded(place: np.ndarray) -> np.ndarray:
    """A picked place as it is listed."""
    return np.round(np.asarray(place, np.float64), _DECIMALS)


def measure_point(shown: ShownCloud, index: int) -> Measured:
    """A point by its number in the order in which they are shown, and its uncertainty along the ray."""
    cell = np.unravel_index(int(shown.cells[index]), shown.cloud.valid.shape)
    place = np.asarray(shown.cloud.xyz[cell], np.float64)
    sigma = float(np.hypot(shown.cloud.sigma_random[cell], shown.cloud.sigma_systematic[cell]))
    said = " ".join(f"{x:.{_DECIMALS}f}" for x in place) + " m"
    words = f"{said}, sigma {1e3 * sigma:.2f} mm along the ray" if sigma else f"{said}, sigma unknown"
    return Measured("point", "", shown.name, rounded(place)[None], None, sigma or None, (words,))


_PAIRS = {
    "distance": (measure_distance, DISTANCE_RADIUS_M),
    "height": (measure_height, DISTANCE_RADIUS_M),
    "angle": (measure_angle, PLANE_RADIUS_M),
}


def measure_pair(kind: Kind, shown: ShownCloud, a: np.ndarray, b: np.ndarray, scanner: Scanner | None) -> Measured:
    """A distance of two places, how much higher the second one is, or the angle between the walls around them.

    Raises:
        MeasurementError: If it cannot be measured there.
    """
    measure, radius_m = _PAIRS[kind]
    at = np.stack([rounded(a), rounded(b)])
    found: Any = measure(shown.around(at, radius_m, _LEAST), at[0], at[1], radius_m=radius_m, scanner=scanner)
    if kind == "angle":
        return _measured(shown, kind, kind, at, (found.value_deg, found.sigma_deg), found.words(), unit="deg")
    return _measured(shown, kind, kind, at, (found.value_m, found.sigma_m), found.words())


def _measured(
    shown: ShownCloud,
    kind: Kind,
    what: str,
    at: np.ndarray,
    numbers: tuple[float, float | None],
    words: str | tuple[str, ...],
    **more: Any,
) -> Measured:
    """A measurement with its value and sigma, if the points determine it."""
    words = (words,) if isinstance(words, str) else words
    if any("nan" in line or "inf" in line for line in words):
        raise MeasurementError("the points do not determine it; pick other places.")
    return Measured(kind, what, shown.name, at, *numbers, words, turned=shown.turned, options=shown.words, **more)


def measure_area(shown: ShownCloud, places: list[np.ndarray]) -> Measured:
    """The area of an outline that was clicked, in the plane nearest to its corners.

    Its sigma is unknown, since the accuracy of the clicks is.

    Raises:
        MeasurementError: If there are too few corners, or too many.
    """
    if not 3 <= len(places) <= _MOST_PLACES:
        raise MeasurementError(f"found {len(places)} corners, expected 3 to {_MOST_PLACES}.")
    at = np.stack([rounded(place) for place in places])
    apart = at - at.mean(0)
    normal = np.linalg.svd(apart)[2][2]
    off = np.abs(apart @ normal).max()
    area = 0.5 * abs(np.cross(apart, np.roll(apart, -1, 0)).sum(0) @ normal)
    around = np.linalg.norm(apart - np.roll(apart, -1, 0), axis=1).sum()
    words = f"{area:.4f} m², {around:.3f} m around, its corners up to {1e3 * off:.1f} mm off their plane"
    return _measured(shown, "area", "area", at, (float(area), None), words, unit="m2")


def measure_box(shown: ShownCloud, centre: np.ndarray, size_m: np.ndarray, points: int) -> Measured:
    """The volume of the section's box, with its middle [3] in the cloud's frame and its edges [3], m."""
    edges = " × ".join(f"{edge:.3f}" for edge in size_m)
    volume = float(np.prod(size_m))
    words = f"{volume:.4f} m³, {edges} m, {points:,} points in it"
    return _measured(shown, "box", "volume", rounded(centre)[None], (volume, None), words, unit="m3")


def measure_flatness(shown: ShownCloud, place: np.ndarray) -> Measured:
    """How flat a place is; as `jaxscan measure plane`.

    Raises:
        MeasurementError: If there is no plane.
    """
    at = rounded(place)[None]
    found = measure_plane(shown.around(at, PLANE_RADIUS_M, _LEAST), at[0], radius_m=PLANE_RADIUS_M)
    return _measured(shown, "flatness", "RMS", at, (found.rms_m, None), found.words(), plane=found)


def measure_sides(shown: ShownCloud, scanner: Scanner | None) -> tuple[Measured, ...]:
    """Length, width and height of the room; as `jaxscan measure room`. The last says why others are left out.

    Raises:
        MeasurementError: If it has no walls.
    """
    box = measure_room(shown.cloud, scanner=scanner)
    measured = [
        _measured(
            shown,
            "room",
            name,
            # From wall to wall through the room's centre, which is midway between the two.
            rounded(box.centre_m + np.outer([-0.5, 0.5], side.value_m * side.direction)),
            (side.value_m, side.sigma_m),
            f"{name} {length_words(side.value_m, side.sigma_m)}",
        )
        for name, side in box.sides.items()
    ]
    remarks = (f"a dimension is left out: {remark}." for remark in box.remarks)
    measured[-1] = measured[-1]._replace(words=(*measured[-1].words, *remarks))
    return tuple(measured)


def as_csv(measured: list[Measured]) -> bytes:
    """The list as a table, UTF-8."""
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(_COLUMNS)
    for one in measured:
        # An outline's further corners are in the JSON.
        places = [f"{x:.{_DECIMALS}f}" for x in one.at[:2].reshape(-1)] + [""] * (6 - one.at[:2].size)
        # A table program would take such a name for a formula.
        name = f"'{one.cloud}" if one.cloud.startswith(_FORMULA) else one.cloud
        lengths, values = (
            ["" if number is None else f"{number:.6f}" for number in pair]
            for pair in ((one.value_m, one.sigma_m), (one.value, one.sigma))
        )
        unit = "" if one.value is None else one.unit
        writer.writerow([one.kind, one.what, name, *places, *lengths, "; ".join(one.words), *values, unit])
    return text.getvalue().encode()


def as_json(measured: list[Measured]) -> bytes:
    """The list as JSON, UTF-8."""
    rows: list[dict[str, Any]] = [
        {
            "kind": one.kind,
            "what": one.what,
            "cloud": one.cloud,
            "at_m": one.at.tolist(),
            "value_m": one.value_m,
            "sigma_m": one.sigma_m,
            "value": one.value,
            "sigma": one.sigma,
            "unit": None if one.value is None else one.unit,
            "words": list(one.words),
            "command": one.command(),
        }
        for one in measured
    ]
    return json.dumps({"format": "jaxscan-measurements/1", "measured": rows}, indent=2, allow_nan=False).encode()
