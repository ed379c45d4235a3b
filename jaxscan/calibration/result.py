"""The result of a calibration: rig, residuals, and the numbers by which to judge it, to the report and to JSON.

Fields of quality and verdict have the names of the keys in files. None means that a file does not say.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import jax
import numpy as np

from jaxscan.geometry import AbstractCamera, Scanner
from jaxscan.observation import Observations


@dataclass(frozen=True)
class Fit:
    """Every observation after the solve: for residual plots, predictions and tests of the model.

    Arrays have the shapes of the observations; entries that are not valid there are 0 here.
    """

    pose: np.ndarray
    """T_cam_board of every view at its table angle [views, 4, 4]."""
    warp: np.ndarray
    """Height kx, ky of the board's bow [m]."""
    pitch: float
    """Relative error of the board's squares [1]."""
    corner_error: np.ndarray
    """Projected minus observed corners [views, corners, 2], px."""
    corner_sigma: np.ndarray
    """Estimated standard deviation of each coordinate [views, corners], px."""
    corner_leverage: np.ndarray
    """Share of each whitened residual that the fit takes up [views, corners, 2]."""
    corner_inlier: np.ndarray
    """bool [views, corners]."""
    stripe_error: np.ndarray
    """Sampson errors of the stripe points [stripes, points], px."""
    stripe_sigma: np.ndarray
    """Estimated standard deviation [stripes, points], px; correlation along the stripe not included."""
    stripe_leverage: np.ndarray
    stripe_inlier: np.ndarray
    covariance: np.ndarray
    """Covariance of the shared unknowns and of the board: `Calibration.order`, then warp.x, warp.y, pitch, and the
    modes of its shape."""
    bend: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """Coefficients of the board's `bend_functions` [m]; empty for a parabola."""
    offset: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    """Where every corner stands beside the bowed and bent surface [corners, 3], m; empty for a parabola."""


STRUCTURE_P = 0.01
"""Chance of finding structure in good data, all tests together."""
USELESS_SHARE = 0.05
"""A calibration cannot be used where its points are off by more than this share of their distance, or its rays by more
than this share of the focal length, which is the same: a room of 4 m wrong by 20 cm is measured better by pacing it."""
UNKNOWN_FOCAL = 0.03
"""A camera whose focal length is known no better than to this share is not determined by its views."""
_NAMED_SHARE = 0.3
"""A cause is named where its part is at least this share of the whole: a smaller one adds less than 5 % to it."""

PRIOR_COST = 0.01
"""A larger share of the priors in the cost is worth a warning: they should only hold unknowns that the data do not."""
REJECTED = 0.03
"""So is a larger share of rejected corners or stripe points ..."""
ODD_VIEW = 4.0
"""... and a view whose corners, rejected ones included, are this many times as far off as usual."""
FAR_OFF, MANY_REJECTED = 2.0, 0.2
"""A view stands out if its kept corners are this many times as far off as usual, or this share is rejected."""
# Whitened residuals between these are as large as the detector promised.
_QUIET, _NOISY = 0.75, 1.33
# A direction of which the priors know more than this share is theirs rather than the data's.
_PRIOR_SHARE = 0.5

Result = Literal["passes", "noisy", "structure"]
"""The outcome of a test: "structure" in the residuals, or residuals that are only larger than promised ("noisy")."""


def chance(p: Sequence[float]) -> float:
    """Probability that chance alone gives one of several tests a p as small as the smallest (Bonferroni's bound)."""
    return min(1.0, len(p) * min(p)) if p else 1.0


def result_of_test(p: float, p_structure: float, tests: int) -> Result:
    """How one of several tests ended; together they find structure in good data with `STRUCTURE_P`."""
    limit = STRUCTURE_P / tests
    if p_structure <= limit:
        return "structure"
    return "noisy" if p <= limit else "passes"


def noise_kind(ratio: float) -> Literal["quiet", "promised", "noisy"]:
    """How residuals of a whitened RMS compare with the promise of their detector."""
    return "noisy" if ratio > _NOISY else "quiet" if ratio < _QUIET else "promised"


def is_held_by_priors(sigma_over_prior: float) -> bool:
    """Whether a direction is known from priors rather than from the data."""
    return sigma_over_prior**2 > _PRIOR_SHARE


def is_named(part: float, whole: float) -> bool:
    """Whether a cause's part of a standard deviation is worth a word."""
    return part > _NAMED_SHARE * whole


@dataclass(frozen=True)
class ModelTest:
    """Whether one model leaves structure in the residuals, and the harm that this does."""

    name: str
    """"lens", "board", "paper", "table", "axis", "sheet", "halves", "regions" or "lines"."""
    statistic: float
    """The test's statistic with the sigmas that the detectors state."""
    dof: int
    p: float
    """Probability of more by chance, if the stated sigmas are right."""
    p_structure: float
    """The same with the noise that was estimated, so that structure alone counts."""
    effect_mm: float | None = None
    """Its part of `GoodTo.sigma_mm` [mm]; None where there is no structure."""
    effect_px: float | None = None
    """Its part of `GoodTo.sigma_px` [px]."""
    where: str | None = None
    """Where the lens falls short most: "in the corners", "at the edges" or "in the middle"; None where it is alike."""
    bend_mm: float | None = None
    """Root mean square height by which a board of paper differs from placement to placement [mm]."""


@dataclass(frozen=True)
class GoodToPart:
    """What one part of the rig adds to an error."""

    name: str
    """"angles" (of the table), "axis" (or the direction of a stage), "sheet" or "camera"."""
    sigma_mm: float


@dataclass(frozen=True)
class GoodTo:
    """Uses of a calibration: one standard deviation that it causes, with the structure that its models leave.

    The squares of the statistical part and of the tests' effects add up to the square of the whole.
    """

    sigma_mm: float | None = None
    """Error of the length of a wall, 4 m from 2.5 m away or as long for its distance, all around; of an object's points
    a quarter turn apart, or half a metre of travel apart; without a motion the error of the range [mm]. None without a
    sheet."""
    statistical_mm: float | None = None
    """The part of it that noise causes."""
    at_m: float | None = None
    """How far away that wall is, or depth z of the points in the camera frame [m]."""
    sigma_px: float | None = None
    """Distance of a ray from where it should be, root mean square over the image after the best rotation [px]."""
    statistical_px: float | None = None
    """The part of it that noise causes."""
    length_m: float | None = None
    """Length of that wall; None without a motion, and in files of earlier versions, whose error is that of points."""
    parts: tuple[GoodToPart, ...] = ()
    """What each part of the rig adds to `statistical_mm`; their squares add up to its square."""
    edge_deg: float | None = None
    """Angle to the optical axis beyond which rays were not judged [degrees]; None where all of the image was."""


@dataclass(frozen=True)
class Verdict:
    """Whether a calibration can be used, and its error."""

    usable: bool | None = None
    """False of a solve that did not converge, where the harm leaves nothing to be used, and beyond a limit that was
    set; None in files written before verdicts had it."""
    good_to: GoodTo | None = None
    """None of a solve that did not converge."""
    refused: str | None = None
    """Why it cannot be used."""
    p: float | None = None
    """Probability that chance alone gives so small a p in one of the tests."""
    p_structure: float | None = None
    """The same probability for the tests' `p_structure`."""
    tests: tuple[ModelTest, ...] = ()
    advice: tuple[str, ...] = ()
    """Captures and settings that would help, the most needed first."""

    def result(self, test: ModelTest) -> Result:
        """How one of the tests ended."""
        return result_of_test(test.p, test.p_structure, len(self.tests))


@dataclass(frozen=True)
class ViewQuality:
    """One view: a record in which a board was found."""

    record: int
    """The record's own number; those of several captures may be the same."""
    corners: int = 0
    dropped: bool = False
    """Left out as a whole."""
    corners_rejected: int = 0
    corner_rms_px: float | None = None
    """Root mean square distance of all corners, rejected ones too."""
    stripe_points: int = 0
    stripe_rms_px: float | None = None
    stripe_elsewhere: bool = False
    """A line was found on the board, but none on the sheet of its laser."""
    board_z_m: float | None = None
    """Depth of the board's origin in the camera frame [m]."""


@dataclass(frozen=True)
class Direction:
    """One independent direction of the unknowns that priors speak of."""

    sigma_over_prior: float
    """Standard deviation along it over that of its prior [1]."""
    direction: dict[str, float]
    """Its largest components by name, in units of the standard deviations."""


@dataclass(frozen=True)
class PriorShare:
    """How much of the result is the priors' own."""

    cost: float
    """Share of the cost [1]."""
    information: float
    """Largest share of the information in any one direction [1]."""


@dataclass(frozen=True)
class DepthSigma:
    """Standard deviations that the calibration causes at one depth, root mean square over lines."""

    depth_m: float
    lines: int
    """Lines of the image (rows, or columns where the stripe runs along them) on which that depth is seen."""
    sigma_depth_mm: float
    """Error of the depth z."""
    sigma_range_mm: float
    """Error of the distance from the camera's centre."""
    sigma_point_mm: float
    """Distance of the points of one full turn from where they should be, after the best rigid motion of them all."""


@dataclass(frozen=True)
class LengthSigma:
    """Standard deviation that the calibration causes in one length."""

    name: str
    """"wall" (that of `GoodTo`), "along the stripe", "across the sweep" or "half a turn"."""
    depth_m: float
    length_m: float
    sigma_mm: float


@dataclass(frozen=True)
class LaserLengths:
    """Predictions for one laser; empty where nothing is in reach or in the image."""

    name: str
    depths: tuple[DepthSigma, ...] = ()
    lengths: tuple[LengthSigma, ...] = ()


@dataclass(frozen=True)
class Lengths:
    """The covariance in lengths that people measure."""

    lasers: tuple[LaserLengths, ...] = ()


@dataclass(frozen=True)
class BoardMap:
    """The shape of the calibration board as the solve found it; corners in their usual order."""

    free: str
    """"parabola": a bow along x and y alone; "bent": other heights too, which are polynomials; "smooth": the print as
    well."""
    rms_off_flat_m: float
    """Root mean square height over the best plane [m]."""
    held_out_rms_parabola_px: float | None = None
    """Root mean square corner distance of views that had no part in the solve, with a parabola [px]."""
    held_out_rms_px: float | None = None
    """The same with this shape."""
    height_m: tuple[float, ...] = ()
    """Height of every corner over the best plane, into the board [m]."""
    height_sigma_m: tuple[float, ...] = ()
    shift_m: tuple[tuple[float, float], ...] = ()
    """Shift of every corner along x and y in the plane, without motion, turn and scale of the whole [m]."""
    shift_sigma_m: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True)
class Missed:
    """A record in which the board was not found."""

    record: int
    """The record's own number."""
    why: str
    """The likely reason, in words."""


@dataclass(frozen=True)
class SecondLook:
    """Gains of a second look at the images, with the geometry known."""

    kept: bool
    """False where it explained the images worse than the first."""
    views_gained: int | None = None
    corners_gained: int | None = None
    stripe_points_gained: int | None = None
    corner_rms_whitened_before: float | None = None
    stripe_rms_whitened_before: float | None = None
    corner_rms_whitened_after: float | None = None
    stripe_rms_whitened_after: float | None = None


@dataclass(frozen=True)
class Quality:
    """All numbers by which a calibration is judged."""

    converged: bool | None = None
    """Whether the last solve reached its minimum; where it did not, no other number means anything."""
    corner_rms_px: float | None = None
    """Root mean square corner distance of the corners in the solve, as `cv2.calibrateCamera` counts it."""
    corner_rms_all_px: float | None = None
    """The same with the rejected ones."""
    stripe_rms_px: float | None = None
    corner_rms_whitened: float | None = None
    """Root mean square of the corners in units of the stated sigmas, per degree of freedom [1]."""
    stripe_rms_whitened: float | None = None
    corner_noise_over_sigma: float | None = None
    """Estimated noise over the stated sigmas [1]."""
    stripe_noise_over_sigma: float | None = None
    stripe_noise_by_contrast: dict[str, float] | None = None
    """The same for the points of each contrast class that has kept points [1]."""
    stripe_correlation: float | None = None
    """Neighbouring stripe points that share one error [1]."""
    angle_sigma: float | None = None
    """Standard deviation of where the table or stage stopped about its records' positions [rad or m]; 0 where the
    boards do not show it, None where none was seen from two positions."""
    views: int | None = None
    records: int | None = None
    """Number of the captures' records."""
    missed: tuple[Missed, ...] = ()
    """The records in which the board was not found."""
    views_without_board: int | None = None
    views_dropped: tuple[int, ...] = ()
    """Records of the views that were left out as a whole."""
    placements: int | None = None
    corners: int | None = None
    corners_rejected: int | None = None
    stripe_points: int | None = None
    stripe_points_rejected: int | None = None
    per_view: tuple[ViewQuality, ...] = ()
    condition: float | None = None
    """Condition number of the information scaled to a unit diagonal."""
    unobserved: tuple[dict[str, float], ...] = ()
    """Directions that the priors know better than the data, as components by name."""
    spectrum: tuple[Direction, ...] = ()
    """The directions that priors speak of, those of which the data say least first."""
    prior_share: PriorShare | None = None
    prior_residuals: dict[str, float] | None = None
    """Departure of each prior's parameter in units of the prior's standard deviation."""
    board_warp_m: tuple[float, float] | None = None
    board_warp_sigma_m: tuple[float, float] | None = None
    board: BoardMap | None = None
    board_pitch: float | None = None
    board_pitch_sigma: float | None = None
    steps: int | None = None
    """Steps of the solver, in all its rounds."""
    warnings: tuple[str, ...] = ()
    lengths: Lengths | None = None
    """None where they were not predicted (`CalibrationSettings.judge`, a camera alone)."""
    sigma_statistical: dict[str, float] | None = None
    """Standard deviation of each parameter by noise alone; None where there is no structure by which it was widened."""
    verdict: Verdict | None = None
    """None where it was not judged."""
    seconds: float | None = None
    """Time of the solve [s]."""
    redetected: SecondLook | None = None

    def lasers(self) -> tuple[LaserLengths, ...]:
        """Predicted lengths of each laser; empty where there are none."""
        return () if self.lengths is None else self.lengths.lasers


class JudgedView(NamedTuple):
    """One view beside the others."""

    quality: ViewQuality
    row: int | None
    """Row of the observations; None where the fit is not known."""
    kept_rms_px: float | None
    """Root mean square distance of the kept corners; None where that is not known, or none is left."""
    usual_px: float
    """Median of `kept_rms_px` over all views; 0 where nothing is known."""

    @property
    def far_off(self) -> bool:
        """Whether its kept corners stand out."""
        return (self.kept_rms_px or 0.0) > FAR_OFF * self.usual_px > 0

    @property
    def lost_many(self) -> bool:
        """Whether an unusual share of its corners was rejected."""
        return self.quality.corners_rejected > MANY_REJECTED * self.quality.corners

    @property
    def rms_px(self) -> float:
        """Root mean square distance of the kept corners, or of all where nothing is kept [px]."""
        return self.kept_rms_px or self.quality.corner_rms_px or 0.0


def judge_views(quality: Quality, fit: Fit | None, observations: Observations | None) -> list[JudgedView]:
    """All views, those with the largest residuals first."""
    rows: list[tuple[int | None, float | None]] = [(None, None)] * len(quality.per_view)
    if fit is not None and observations is not None:
        count = fit.corner_inlier.sum(1)
        square = np.where(fit.corner_inlier, np.sum(fit.corner_error**2, -1), 0.0).sum(1)
        rms = np.sqrt(square / np.maximum(count, 1)).tolist()
        # Several captures may have records of the same number; all of them stand in the order of the views.
        left = iter(enumerate(np.asarray(observations.corners.record).tolist()))
        for place, view in enumerate(quality.per_view):
            row = next((row for row, record in left if record == view.record), None)
            rows[place] = row, rms[row] if row is not None and count[row] else None
    known = [kept for _, kept in rows if kept]
    usual = float(np.median(known)) if known else 0.0
    views = [JudgedView(view, *row, usual) for view, row in zip(quality.per_view, rows, strict=True)]
    return sorted(views, key=lambda view: -view.rms_px)


@dataclass(frozen=True)
class Calibration:
    """A calibrated rig and everything needed to judge it or to solve it again."""

    camera: AbstractCamera
    scanner: Scanner | None
    """None where only the camera was calibrated; otherwise it carries `covariance` too. It has no sheets where only
    camera and motion were calibrated."""
    order: tuple[str, ...]
    """Names of the minimal coordinates that `covariance` refers to."""
    covariance: np.ndarray
    """Covariance [params, params] in the units px, rad, m; zero for parameters held fixed."""
    quality: Quality = field(default_factory=Quality)
    """Numbers by which to judge the result: whether it converged, residuals, counts, verdict, ..."""
    observations: Observations | None = None
    missing: tuple[str, ...] = ()
    """A sentence for each part that was not solved: why, and the captures that it needs."""
    provenance: dict[str, Any] = field(default_factory=dict)
    """Inputs by digest, settings, versions."""
    fit: Fit | None = None
    """Known after a solve; files hold the observations instead, from which it is found again."""


# A held parameter may change by this much, which is rounding.
_HELD = 1e-6


def largest_departure(stored: Calibration, again: Calibration) -> tuple[float, str]:
    """The parameter that differs most between two solves of the same observations.

    Returns:
        Its difference in standard deviations [1], infinite where a held parameter changed; and its name.
    """
    if stored.order != again.order or type(stored.camera) is not type(again.camera):
        return np.inf, "the set of parameters"
    if stored.scanner is not None and again.scanner is not None:
        change = stored.scanner.departure(again.scanner)
    else:
        with jax.enable_x64(True):
            change = np.asarray(again.camera.parameters()) - np.asarray(stored.camera.parameters())
    sigma = np.sqrt(np.maximum(np.diag(again.covariance), 0.0))
    size = np.where(sigma > 0, np.abs(change) / np.where(sigma > 0, sigma, 1.0), 0.0)
    size = np.where((sigma == 0) & (np.abs(change) > _HELD), np.inf, size)
    worst = int(np.argmax(size))
    return float(size[worst]), again.order[worst]
