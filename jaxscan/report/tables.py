"""A calibration as tables: parameters, tests, views, quality."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxscan.calibration import Calibration, ModelTest, Quality, judge_views
from jaxscan.geometry import Scanner, make_layout
from jaxscan.report.words import TESTS


class Parameter(NamedTuple):
    """One row: an estimate in units for people."""

    name: str
    value: tuple[float, ...]
    sigma: float
    """Standard deviation; 0 if the parameter was held."""
    unit: str
    """Unit of value and sigma; the sigma of a direction is an angle in mrad."""

    def row(self) -> tuple[str, str, str]:
        """Name, value and standard deviation as text, with the significant digits."""
        label = f"{self.name}, {self.unit}" if self.unit else self.name
        if self.unit == "direction":
            # 1 mrad moves the end of a unit vector by 0.001.
            shown, label = _digits(self.value, 1e-3 * self.sigma), self.name
            return label, shown, f"{_significant(self.sigma)} mrad" if self.sigma > 0 else "held"
        return label, _digits(self.value, self.sigma), _significant(self.sigma) if self.sigma > 0 else "held"

    def as_json(self) -> dict[str, Any]:
        """The row as JSON, with the units in the keys; the sigma of a direction is an angle."""
        value = self.value[0] if len(self.value) == 1 else list(self.value)
        if self.unit == "direction":
            return {"name": self.name, "direction": value, "sigma_mrad": self.sigma}
        unit = f"_{self.unit}" if self.unit else ""
        return {"name": self.name, f"value{unit}": value, f"sigma{unit}": self.sigma}


def parameters(calibration: Calibration) -> list[Parameter]:
    """All estimates: camera, lasers, axis, angle model, board."""
    diagonal = np.sqrt(np.maximum(np.diag(calibration.covariance), 0.0))
    # A calibration without covariance has no sigmas.
    sigma = dict(zip(calibration.order, diagonal.tolist(), strict=True))
    camera = calibration.camera
    with jax.enable_x64(True):
        values = np.asarray(camera.parameters()).tolist()
    layout = make_layout(camera, ())
    rows = [
        Parameter(name, (value,), sigma.get(name, 0.0), block.unit)
        for name, value, block in zip(layout.names, values, layout.blocks, strict=True)
    ]
    if calibration.scanner is not None:
        rows += _lasers(calibration.scanner, sigma) + [
            Parameter(*line) for line in calibration.scanner.turntable.described(sigma)
        ]
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


def _board(quality: Quality) -> list[Parameter]:
    rows = []
    for axis, height, sigma in zip("xy", quality.board_warp_m or (), quality.board_warp_sigma_m or (), strict=False):
        if sigma > 0:
            rows.append(Parameter(f"board bow along {axis}", (1e3 * height,), 1e3 * sigma, "mm"))
    if quality.board_pitch is not None and quality.board_pitch_sigma:
        pitch, sigma = 1e6 * quality.board_pitch, 1e6 * quality.board_pitch_sigma
        rows.append(Parameter("board squares, relative error", (pitch,), sigma, "ppm"))
    return rows


_STATISTICS = ("statistic", "degrees of freedom", "p", "p of structure")
OUTCOME_COLUMNS = ("test", *_STATISTICS, "harm", "result", "question")


def outcome_rows(calibration: Calibration) -> list[tuple[str, ...]]:
    """The tests of the verdict, one row each; columns as in `OUTCOME_COLUMNS`."""
    verdict = calibration.quality.verdict
    if verdict is None:
        return []
    return [
        (
            test.name,
            f"{test.statistic:.1f}",
            str(test.dof),
            _probability(test.p),
            _probability(test.p_structure),
            _harm(test),
            verdict.result(test),
            TESTS.get(test.name, ("", ""))[0],
        )
        for test in verdict.tests
    ]


def _harm(test: ModelTest) -> str:
    sizes = (test.effect_mm, "mm"), (test.effect_px, "px")
    return ", ".join(f"{size:.2g} {unit}" for size, unit in sizes if size is not None)


def view_columns(calibration: Calibration) -> tuple[str, ...]:
    """Column titles of the table of views; without stripe columns if no view has stripes."""
    stripes = ("stripe points", "stripe RMS, px") if _striped(calibration) else ()
    return ("record", "corners", "rejected", "RMS of kept corners, px", "of all corners, px", *stripes, "distance, m")


def view_rows(calibration: Calibration) -> list[tuple[str, ...]]:
    """The views, worst first; columns as in `view_columns`."""
    rows, striped = [], _striped(calibration)
    for view in judge_views(calibration.quality, calibration.fit, calibration.observations):
        of = view.quality
        counts = str(of.record), str(of.corners), str(of.corners_rejected)
        corners = _optional(view.kept_rms_px, ".3f"), _optional(of.corner_rms_px, ".3f")
        # Zero points have no RMS.
        stripes = str(of.stripe_points), _optional(of.stripe_rms_px if of.stripe_points else None, ".3f")
        rows.append((*counts, *corners, *(stripes if striped else ()), _optional(of.board_z_m, ".2f")))
    return rows


def _striped(calibration: Calibration) -> bool:
    return any(view.stripe_points for view in calibration.quality.per_view)


def quality_rows(calibration: Calibration) -> list[tuple[str, str]]:
    """The known quality numbers of the whole solve."""
    quality = calibration.quality
    share = quality.prior_share
    values = [
        ("views", quality.views, "d"),
        ("records without a usable board", quality.views_without_board, "d"),
        ("board placements", quality.placements, "d"),
        ("corner RMS, px", quality.corner_rms_px, ".4f"),
        ("corner RMS with rejected ones, px", quality.corner_rms_all_px, ".4f"),
        ("stripe RMS, px", quality.stripe_rms_px, ".4f"),
        ("corner noise over the promised noise", quality.corner_noise_over_sigma, ".3f"),
        ("stripe noise over the promised noise", quality.stripe_noise_over_sigma, ".3f"),
        ("stripe points that share one error", quality.stripe_correlation, ".2f"),
        ("standard deviation of stops about their angles, rad or m", quality.angle_sigma, ".2g"),
        ("share of priors in the cost", share and share.cost, ".2%"),
        ("largest share of priors in any direction", share and share.information, ".2%"),
        ("condition of the normal equations", quality.condition, ".2g"),
        ("steps of the solver", quality.steps, "d"),
        ("seconds", quality.seconds, ".2f"),
    ]
    rows = [(name, f"{value:{form}}".replace("%", " %")) for name, value, form in values if value is not None]
    classes = ", ".join(f"{name} {value:.2f}" for name, value in (quality.stripe_noise_by_contrast or {}).items())
    return rows + [("stripe noise over the promised noise by contrast class", classes)] * bool(classes)


def _digits(values: Sequence[float], sigma: float) -> str:
    return " ".join(f"{value:.{_decimals(sigma) if sigma > 0 else 6}f}" for value in values)


def _significant(sigma: float) -> str:
    return f"{sigma:.{_decimals(sigma)}f}" if sigma >= 1e-9 else f"{sigma:.1e}"


def _decimals(sigma: float) -> int:
    return min(max(1 - math.floor(math.log10(sigma)), 0), 9)


def _optional(value: float | None, form: str) -> str:
    return "–" if value is None else f"{value:{form}}"


def _probability(value: float) -> str:
    if value < 1e-99:
        return "< 1e-99"
    return f"{value:.3f}" if value >= 1e-3 else f"{value:.0e}"


def _tuple(values: object) -> tuple[float, ...]:
    return tuple(float(value) for value in np.asarray(values))
