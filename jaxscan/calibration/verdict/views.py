"""The views of a calibration in order of their residuals, and those that stand out."""

from typing import NamedTuple

import numpy as np

from jaxscan.calibration.fit import Fit
from jaxscan.calibration.verdict import limits
from jaxscan.calibration.verdict.quality import Quality, ViewQuality
from jaxscan.observation import Observations


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
