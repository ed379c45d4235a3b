"""Numbers by which to judge a calibration, from the solve to the report and to JSON.

Fields have the names of the keys in files. None means that a file does not say.
"""

from dataclasses import dataclass

from jaxscan.calibration.verdict.limits import Result, result_of_test


@dataclass(frozen=True)
class ModelTest:
    """Whether one model leaves structure in the residuals, and the harm that this does."""

    name: str
    """"lens", "board", "table", "axis", "sheet", "halves", "regions" or "lines"."""
    statistic: float
    """With the sigmas that the detectors promise."""
    dof: int
    p: float
    """Probability of more by chance, if the promised sigmas are right."""
    p_structure: float
    """The same with the noise that was estimated, so that structure alone counts."""
    effect_mm: float | None = None
    """Its part of `GoodTo.sigma_mm` [mm]; None where there is no structure."""
    effect_px: float | None = None
    """Its part of `GoodTo.sigma_px` [px]."""
    where: str | None = None
    """Where the lens falls short most: "in the corners", "at the edges" or "in the middle"; None where it is alike."""


@dataclass(frozen=True)
class GoodTo:
    """Uses of a calibration: one standard deviation that it causes, with the structure that its models leave.

    The squares of the statistical part and of the tests' effects add up to the square of the whole.
    """

    sigma_mm: float | None = None
    """Distance of the points of one full turn (or of half a metre of travel) at `at_m` from where they should be, after
    the best rigid motion of them all; without a motion the error of the range [mm]. None without a sheet."""
    statistical_mm: float | None = None
    """The part of it that noise causes."""
    at_m: float | None = None
    """Depth z of those points in the camera frame."""
    sigma_px: float | None = None
    """Distance of a ray from where it should be, root mean square over the image after the best rotation [px]."""
    statistical_px: float | None = None
    """The part of it that noise causes."""


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
    """The same of the tests' `p_structure`."""
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
    """Of all corners, rejected ones too."""
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
    """Of the depth z."""
    sigma_range_mm: float
    """Of the distance from the camera's centre."""
    sigma_point_mm: float
    """Distance of the points of one full turn from where they should be, after the best rigid motion of them all."""


@dataclass(frozen=True)
class LengthSigma:
    """Standard deviation that the calibration causes in one length."""

    name: str
    """"along the stripe", "across the sweep" or "half a turn"."""
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
    well; "corners": every corner by itself."""
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
    """All of it."""

    converged: bool | None = None
    """Whether the last solve reached its minimum; where it did not, no other number means anything."""
    corner_rms_px: float | None = None
    """Root mean square corner distance of the corners in the solve, as `cv2.calibrateCamera` counts it."""
    corner_rms_all_px: float | None = None
    """With the rejected ones."""
    stripe_rms_px: float | None = None
    corner_rms_whitened: float | None = None
    """In units of the promised sigmas, per degree of freedom [1]."""
    stripe_rms_whitened: float | None = None
    corner_noise_over_sigma: float | None = None
    """Estimated noise over the promised sigmas [1]."""
    stripe_noise_over_sigma: float | None = None
    stripe_noise_by_contrast: dict[str, float] | None = None
    """The same of the points of each contrast class, of classes with kept points [1]."""
    stripe_correlation: float | None = None
    """Neighbouring stripe points that share one error [1]."""
    angle_sigma: float | None = None
    """Standard deviation of where the table or stage stopped about its records' positions [rad or m]; 0 where the
    boards do not show it, None where none was seen from two positions."""
    views: int | None = None
    records: int | None = None
    """Of the captures."""
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
    """Of the solver, in all its rounds."""
    warnings: tuple[str, ...] = ()
    lengths: Lengths | None = None
    """None where nobody has predicted them (`CalibrationSettings.judge`, a camera alone)."""
    sigma_statistical: dict[str, float] | None = None
    """Standard deviation of each parameter by noise alone; None where there is no structure by which it was widened."""
    verdict: Verdict | None = None
    """None where nobody has judged."""
    seconds: float | None = None
    """Time of the solve [s]."""
    redetected: SecondLook | None = None

    def lasers(self) -> tuple[LaserLengths, ...]:
        """Predicted lengths of each laser; empty where there are none."""
        return () if self.lengths is None else self.lengths.lasers
