"""A calibration in rows of numbers: parameters, tests, views."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxscan.calibration import Calibration
from jaxscan.geometry import Scanner, make_layout
from jaxscan.report.calibration import TESTS, Outcome, number, outcomes, views


class Parameter(NamedTuple):
    """One row: what was estimated, in the units that are read."""

    name: str
    value: tuple[float, ...]
    sigma: float
    """Standard deviation; 0 where it was held."""
    unit: str
    """Of the value; that of sigma too, but for directions, whose sigma is an angle in mrad."""

    def row(self) -> tuple[str, str, str]:
        """Name, value and standard deviation as text, with as many digits as mean something."""
        label = f"{self.name}, {self.unit}" if self.unit else self.name
        if self.unit == "direction":
            # A milliradian is a thousandth of a unit vector.
            shown, label = _digits(self.value, 1e-3 * self.sigma), self.name
            return label, shown, f"{_significant(self.sigma)} mrad" if self.sigma > 0 else "held"
        return label, _digits(self.value, self.sigma), _significant(self.sigma) if self.sigma > 0 else "held"

    def as_json(self) -> dict[str, Any]:
        """For machines: units in the names of the keys; of a direction, sigma is the angle."""
        value = self.value[0] if len(self.value) == 1 else list(self.value)
        if self.unit == "direction":
            return {"name": self.name, "direction": value, "sigma_mrad": self.sigma}
        unit = f"_{self.unit}" if self.unit else ""
        return {"name": self.name, f"value{unit}": value, f"sigma{unit}": self.sigma}


def parameters(calibration: Calibration) -> list[Parameter]:
    """What was estimated: camera, lasers, axis, angle model, board."""
    diagonal = np.sqrt(np.maximum(np.diag(calibration.covariance), 0.0))
    # A calibration of unknown uncertainty has none to show.
    sigma = dict(zip(calibration.order, diagonal.tolist(), strict=True))
    camera = calibration.camera
    with jax.enable_x64(True):
        values = np.asarray(camera.parameters()).tolist()
    layout = make_layout(camera, (), turns=False)
    rows = [
        Parameter(name, (value,), sigma.get(name, 0.0), block.unit)
        for name, value, block in zip(layout.names, values, layout.blocks, strict=True)
    ]
    if calibration.scanner is not None:
        rows += _lasers(calibration.scanner, sigma) + _table(calibration.scanner, sigma)
    return rows + _board(calibration.quality)


def _lasers(scanner: Scanner, sigma: dict[str, float]) -> list[Parameter]:
    rows = []
    for index, name in enumerate(scanner.laser_names):
        sheet, of = scanner.laser(index), lambda part, name=name: sigma.get(f"laser.{name}.{part}", 0.0)
        rows += [
            Parameter(f"laser {name}: normal", _tuple(sheet.normal), 1e3 * math.hypot(of("n1"), of("n2")), "direction"),
            Parameter(f"laser {name}: distance", (1e3 * float(sheet.distance),), 1e3 * of("d"), "mm"),
        ]
        if of("b2") > 0 or of("b3") > 0:
            bow = _tuple(1e3 * np.asarray(sheet.bow))
            rows += [
                Parameter(f"laser {name}: bow b{k + 2}", (bow[k],), 1e3 * of(f"b{k + 2}"), "mrad") for k in range(2)
            ]
    return rows


def _table(scanner: Scanner, sigma: dict[str, float]) -> list[Parameter]:
    table = scanner.turntable
    of = lambda name: sigma.get(name, 0.0)
    tilt, shift = (1e3 * math.hypot(of(f"axis.{part}1"), of(f"axis.{part}2")) for part in "dp")
    rows = [
        Parameter("axis: direction", _tuple(table.direction), tilt, "direction"),
        Parameter("axis: nearest point", _tuple(1e3 * np.asarray(table.point)), shift, "mm"),
        Parameter("gain of the angle", (float(table.gain),), of("gain"), ""),
    ]
    harmonics = zip(("c1", "s1", "c2", "s2"), 1e3 * np.asarray(table.harmonics), strict=True)
    return rows + [
        Parameter(f"angle error {name}", (float(value),), 1e3 * of(name), "mrad")
        for name, value in harmonics
        if of(name) > 0
    ]


def _board(quality: dict[str, Any]) -> list[Parameter]:
    rows = []
    warp, sigma = (_pair(quality.get(key)) for key in ("board_warp_m", "board_warp_sigma_m"))
    for axis, height, uncertain in zip("xy", warp, sigma, strict=False):
        if uncertain > 0:
            rows.append(Parameter(f"board bow along {axis}", (1e3 * height,), 1e3 * uncertain, "mm"))
    pitch, uncertain_pitch = (number(quality, key) for key in ("board_pitch", "board_pitch_sigma"))
    if pitch is not None and uncertain_pitch:
        rows.append(Parameter("board squares, relative error", (1e6 * pitch,), 1e6 * uncertain_pitch, "ppm"))
    return rows


OUTCOME_COLUMNS = (
    "test",
    "statistic",
    "degrees of freedom",
    "p",
    "p of structure",
    "moves a length by",
    "result",
    "question",
)


def outcome_rows(calibration: Calibration) -> list[tuple[str, ...]]:
    """The tests of the verdict, one each, as `OUTCOME_COLUMNS`."""
    return [
        (
            test.name,
            _optional(test.statistic, ".1f"),
            _optional(test.dof, ".0f"),
            _probability(test.p),
            _probability(test.p_structure),
            _moved(test),
            test.result,
            TESTS.get(test.name, ("", ""))[0],
        )
        for test in outcomes(calibration)
    ]


def _moved(test: Outcome) -> str:
    # What passes has nothing to move but by chance.
    if test.result != "fails" or test.effect_mm is None or test.effect_sigma is None:
        return ""
    return f"{test.effect_mm:.2g} mm, {test.effect_sigma:.1f} sigma"


VIEW_COLUMNS = {
    "record": ("record", ".0f"),
    "corners": ("corners", ".0f"),
    "corners_rejected": ("rejected", ".0f"),
    "kept_rms_px": ("RMS of kept corners, px", ".3f"),
    "corner_rms_px": ("of all corners, px", ".3f"),
    "stripe_points": ("stripe points", ".0f"),
    "stripe_rms_px": ("stripe RMS, px", ".3f"),
    "board_z_m": ("distance, m", ".2f"),
}
"""What is shown of a view: its key in `quality["per_view"]`, the title and the form of a number."""


def view_columns(calibration: Calibration) -> dict[str, tuple[str, str]]:
    """Those of `VIEW_COLUMNS` that this calibration has anything to say in."""
    striped = any(number(view, "stripe_points") for view in views(calibration))
    return {key: column for key, column in VIEW_COLUMNS.items() if striped or not key.startswith("stripe")}


def view_rows(calibration: Calibration) -> list[tuple[str, ...]]:
    """The views, worst first, as `view_columns`."""
    columns = view_columns(calibration)

    def cell(view: dict[str, Any], key: str, form: str) -> str:
        # Of no points there is no root mean square.
        empty = key == "stripe_rms_px" and not number(view, "stripe_points")
        return _optional(None if empty else number(view, key), form)

    return [tuple(cell(view, key, form) for key, (_, form) in columns.items()) for view in views(calibration)]


def quality_rows(calibration: Calibration) -> list[tuple[str, str]]:
    """Numbers about the whole solve."""
    quality = calibration.quality
    share = quality.get("prior_share")
    values = [
        ("views", _optional(number(quality, "views"), ".0f")),
        ("records without a usable board", _optional(number(quality, "views_without_board"), ".0f")),
        ("board placements", _optional(number(quality, "placements"), ".0f")),
        ("corner RMS, px", _optional(number(quality, "corner_rms_px"), ".4f")),
        ("corner RMS with rejected ones, px", _optional(number(quality, "corner_rms_all_px"), ".4f")),
        ("stripe RMS, px", _optional(number(quality, "stripe_rms_px"), ".4f")),
        ("corner noise over what was promised", _optional(number(quality, "corner_noise_over_sigma"), ".3f")),
        ("stripe noise over what was promised", _optional(number(quality, "stripe_noise_over_sigma"), ".3f")),
        ("stripe points that share one error", _optional(number(quality, "stripe_correlation"), ".2f")),
        ("share of priors in the cost", _percent(number(share, "cost"))),
        ("largest share of priors in any direction", _percent(number(share, "information"))),
        ("condition of the normal equations", _optional(number(quality, "condition"), ".2g")),
        ("steps of the solver", _optional(number(quality, "steps"), ".0f")),
        ("seconds", _optional(number(quality, "seconds"), ".2f")),
    ]
    return [(name, value) for name, value in values if value != "–"]


def _digits(values: Sequence[float], sigma: float) -> str:
    decimals = 6 if sigma <= 0 else min(max(1 - math.floor(math.log10(sigma)), 0), 9)
    return " ".join(f"{value:.{decimals}f}" for value in values)


def _significant(sigma: float) -> str:
    decimals = min(max(1 - math.floor(math.log10(sigma)), 0), 9)
    return f"{sigma:.{decimals}f}" if sigma >= 1e-9 else f"{sigma:.1e}"


def _optional(value: float | None, form: str) -> str:
    return "–" if value is None else f"{value:{form}}"


def _percent(value: float | None) -> str:
    return "–" if value is None else f"{100 * value:.2f} %"


def _probability(value: float | None) -> str:
    if value is None:
        return "–"
    if value < 1e-99:
        return "< 1e-99"
    return f"{value:.3f}" if value >= 1e-3 else f"{value:.0e}"


def _pair(value: object) -> tuple[float, ...]:
    """Two numbers of a file, or none."""
    usable = isinstance(value, list | tuple) and len(value) == 2 and all(isinstance(item, float) for item in value)
    return tuple(value) if isinstance(value, list | tuple) and usable else ()


def _tuple(values: object) -> tuple[float, ...]:
    return tuple(float(value) for value in np.asarray(values))
