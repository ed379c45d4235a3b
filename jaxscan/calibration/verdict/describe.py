"""Residuals, counts and priors of a finished solve as the numbers by which it is judged, and views that stand out."""

from typing import NamedTuple

import numpy as np

from jaxscan.calibration.fit import Fit
from jaxscan.calibration.parameters import is_mode
from jaxscan.calibration.solve.adjustment import Adjustment
from jaxscan.calibration.solve.covariance import Determination
from jaxscan.calibration.verdict import limits
from jaxscan.calibration.verdict.quality import Direction, PriorShare, Quality, ViewQuality
from jaxscan.geometry.motions import ANGLE_PARAMETERS
from jaxscan.observation import Observations


# Records that are named in one warning.
_NAMED = 8
_FITTED = "even print", "weak edge", "strong edge"
# In the order of the contrast classes.
_CONTRASTS = (*_FITTED, *(f"{name}, not through the print" for name in _FITTED))


def describe_quality(
    result: Adjustment, determination: Determination, observations: Observations, names: tuple[str, ...]
) -> Quality:
    """The quality of a calibration as far as one solve says it; lengths, verdict and time come later.

    Args:
        result: The finished solve.
        determination: How well the shared unknowns are known.
        observations: As they were given.
        names: Of the shared unknowns.
    """
    data, prior = result.data, result.linearised.prior_residual
    # Modes of the board are held by their priors on purpose; that is no doubt of the rig's numbers.
    rig = np.array([not is_mode(name) for name in names])
    corner_rms, stripe_rms = result.whitened_rms()
    corners, stripes = int(data.corner_valid.sum()), int(data.stripe_valid.sum())
    distance = np.linalg.norm(result.corner_error, axis=-1)
    sigma = np.sqrt(np.diag(determination.covariance)).tolist()
    warp_x, warp_y, pitch = (float(value) for value in result.problem.shape[:3])
    warp_sigma_x, warp_sigma_y, pitch_sigma = (sigma[names.index(name)] for name in ("warp.x", "warp.y", "pitch"))
    spectrum = tuple(Direction(*row) for row in determination.spectrum)
    per_view = _per_view(result, observations, distance)
    return Quality(
        converged=result.converged,
        corner_rms_px=_rms(distance[result.corner_kept]),
        corner_rms_all_px=_rms(distance[data.corner_valid]),
        stripe_rms_px=_rms(result.stripe_error[result.stripe_kept]),
        corner_rms_whitened=corner_rms,
        stripe_rms_whitened=stripe_rms,
        corner_noise_over_sigma=result.corner_noise,
        stripe_noise_over_sigma=result.stripe_noise_rms,
        stripe_noise_by_contrast=_noise_by_contrast(result),
        stripe_correlation=result.stripe_correlation,
        angle_sigma=result.angle_sigma,
        views=len(per_view),
        views_without_board=len(np.asarray(observations.corners.angle)) - len(per_view),
        views_dropped=tuple(view.record for view in per_view if view.dropped),
        placements=len(np.unique(data.placement[data.usable])),
        corners=corners,
        corners_rejected=corners - int(result.corner_kept.sum()),
        stripe_points=stripes,
        stripe_points_rejected=stripes - int(result.stripe_kept.sum()),
        per_view=per_view,
        condition=determination.condition,
        unobserved=tuple(row.direction for row in spectrum if limits.is_held_by_priors(row.sigma_over_prior)),
        spectrum=spectrum,
        prior_share=PriorShare(_prior_cost(result, prior[rig]), determination.prior_share),
        prior_residuals={
            "fx/fy" if name == "fx" else name: float(value)
            for name, value in zip(names, prior, strict=True)
            if value != 0 and not is_mode(name)
        },
        board_warp_m=(warp_x, warp_y),
        board_warp_sigma_m=(warp_sigma_x, warp_sigma_y),
        board_pitch=pitch,
        board_pitch_sigma=pitch_sigma,
        steps=result.steps,
    )


def warn(quality: Quality) -> tuple[str, ...]:
    """Warnings about the numbers of a solve that converged."""
    warnings = []
    if quality.prior_share is not None and quality.prior_share.cost > limits.PRIOR_COST:
        warnings.append(f"priors carry {100 * quality.prior_share.cost:.1f} % of the cost")
    for name, count, rejected in (
        ("corners", quality.corners or 0, quality.corners_rejected or 0),
        ("stripe points", quality.stripe_points or 0, quality.stripe_points_rejected or 0),
    ):
        if rejected > limits.REJECTED * max(count, 1):
            warnings.append(f"{100 * rejected / count:.1f} % of the {name} were rejected")
    elsewhere = [view.record for view in quality.per_view if view.stripe_elsewhere]
    if elsewhere:
        lit = sum(view.stripe_points > 0 or view.stripe_elsewhere for view in quality.per_view)
        warnings.append(
            f"the line found on {len(elsewhere)} of {lit} boards is not the laser's and was left out: records "
            f"{_listed(elsewhere)}"
        )
    # Records of several captures may have the same number, so views are gone through one by one.
    sizes = [view.corner_rms_px or 0.0 for view in quality.per_view]
    usual = float(np.median(sizes)) if sizes else 0.0
    for view, size in zip(quality.per_view, sizes, strict=True):
        if view.dropped:
            warnings.append(
                f"record {view.record} was left out: its corners are {size:.2f} px off and disagree with all other "
                "views"
            )
        elif size > limits.ODD_VIEW * usual:
            warnings.append(
                f"record {view.record}: its corners are {size:.2f} px off, those of other views {usual:.2f}"
            )
    for direction in quality.unobserved:
        # The table's own angle errors are meant to be held by the priors.
        if not set(direction) & set(ANGLE_PARAMETERS):
            warnings.append(f"held by priors rather than by data: {', '.join(direction)}")
    return tuple(warnings)


class JudgedView(NamedTuple):
    """One view beside the others."""

    quality: ViewQuality
    row: int | None
    """Of the observations; None where the fit is not known."""
    kept_rms_px: float | None
    """Of the corners that were not rejected; None where that is not known, or none is left."""
    usual_px: float
    """Median of `kept_rms_px` over all views; 0 where nothing is known."""

    @property
    def far_off(self) -> bool:
        """Whether its kept corners stand out."""
        return (self.kept_rms_px or 0.0) > limits.FAR_OFF * self.usual_px > 0

    @property
    def lost_many(self) -> bool:
        """Whether an unusual share of its corners was rejected."""
        return self.quality.corners_rejected > limits.MANY_REJECTED * self.quality.corners

    @property
    def rms_px(self) -> float:
        """Of the kept corners, or of all where nothing is kept [px]."""
        return self.kept_rms_px or self.quality.corner_rms_px or 0.0


def judge_views(quality: Quality, fit: Fit | None, observations: Observations | None) -> list[JudgedView]:
    """All views, those with the largest residuals first."""
    rows: list[tuple[int | None, float | None]] = [(None, None)] * len(quality.per_view)
    if fit is not None and observations is not None:
        count = fit.corner_kept.sum(1)
        square = np.where(fit.corner_kept, np.sum(fit.corner_error**2, -1), 0.0).sum(1)
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


def _per_view(result: Adjustment, observations: Observations, distance: np.ndarray) -> tuple[ViewQuality, ...]:
    data, records = result.data, np.asarray(observations.corners.record)
    # A stripe that agrees with no sheet keeps its row, without a point.
    without = ~np.any(np.asarray(observations.stripes.valid), axis=1)
    elsewhere = set(np.asarray(observations.stripes.view)[without].tolist())
    depth = result.linearised.view_poses[:, 2, 3]
    views = []
    for view in np.flatnonzero(data.usable):
        seen = data.corner_valid[view]
        points = result.stripe_kept & (data.stripe_view == view)[:, None]
        views.append(
            ViewQuality(
                record=int(records[view]),
                corners=int(seen.sum()),
                dropped=not bool(result.view_kept[view]),
                corners_rejected=int((seen & ~result.corner_kept[view]).sum()),
                corner_rms_px=_rms(distance[view, seen]),
                stripe_points=int(points.sum()),
                stripe_rms_px=_rms(result.stripe_error[points]),
                stripe_elsewhere=int(view) in elsewhere,
                board_z_m=float(depth[view]),
            )
        )
    return tuple(views)


def _listed(records: list[int]) -> str:
    """The first few numbers, and how many more there are."""
    more = len(records) - _NAMED
    return ", ".join(map(str, records[:_NAMED])) + (f" and {more} more" if more > 0 else "")


def _prior_cost(result: Adjustment, prior: np.ndarray) -> float:
    """Share of the priors in the cost."""
    corner = np.sum(np.square(result.corner_error / result.corner_sigma[..., None])[result.corner_kept])
    stripe = np.sum(np.square(result.stripe_error / result.stripe_sigma)[result.stripe_kept])
    own = float(np.sum(prior**2))
    return own / max(own + float(corner + stripe / result.stripe_correlation), 1e-300)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else 0.0


def _noise_by_contrast(result: Adjustment) -> dict[str, float]:
    """Estimated noise over the given sigma of each contrast class that has kept points [1]."""
    points = np.bincount(result.data.stripe_contrast[result.stripe_kept], minlength=len(_CONTRASTS))
    return {
        name: float(noise) for name, noise, count in zip(_CONTRASTS, result.stripe_noise, points, strict=True) if count
    }
