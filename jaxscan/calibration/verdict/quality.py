"""Numbers by which to judge a calibration."""

from typing import Any

import numpy as np

from jaxscan.calibration.parameters import ANGLE_PARAMETERS
from jaxscan.calibration.solve.adjust import Adjustment
from jaxscan.calibration.solve.covariance import Determination
from jaxscan.calibration.solve.prepare import Prepared
from jaxscan.observation import Observations


# More than this is worth a word in the report: the priors should only hold what nothing else does.
_PRIOR_COST_WARNING = 0.01
_REJECTED_WARNING = 0.03
# A view whose corners, rejected ones included, are this many times as far off as usual is named.
_ODD_VIEW = 4.0


def describe_quality(
    result: Adjustment,
    determination: Determination,
    observations: Observations,
    data: Prepared,
    names: tuple[str, ...],
) -> dict[str, Any]:
    """The `quality` of a calibration; see `calibrate_observations`."""
    distance = np.linalg.norm(result.corner_error, axis=-1)
    corners, stripes = int(data.corner_valid.sum()), int(data.stripe_valid.sum())
    kept, kept_stripes = int(result.corner_keep.sum()), int(result.stripe_keep.sum())
    dropped = np.asarray(observations.corners.record)[np.flatnonzero(data.usable & ~result.view_keep)]
    prior = np.asarray(result.linearised.prior_residual)
    corner_cost = np.sum(np.square(result.corner_error / result.corner_sigma[..., None])[result.corner_keep])
    stripe_cost = np.sum(np.square(result.stripe_error / result.stripe_sigma)[result.stripe_keep])
    cost = float(np.sum(prior**2) + corner_cost + stripe_cost / result.stripe_correlation)
    prior_cost = float(np.sum(prior**2)) / max(cost, 1e-300)
    sigma = np.sqrt(np.diag(determination.covariance))
    quality: dict[str, Any] = {
        "corner_rms_px": _rms(distance[result.corner_keep]),
        "corner_rms_all_px": _rms(distance[data.corner_valid]),
        "stripe_rms_px": _rms(result.stripe_error[result.stripe_keep]),
        "corner_rms_whitened": result.corner_rms,
        "stripe_rms_whitened": result.stripe_rms,
        "corner_noise_over_sigma": result.corner_noise,
        "stripe_noise_over_sigma": result.stripe_noise,
        "stripe_correlation": result.stripe_correlation,
        "views": int(data.usable.sum()),
        "views_without_board": int(len(np.asarray(observations.corners.angle)) - data.usable.sum()),
        "views_dropped": [int(record) for record in dropped],
        "placements": len(np.unique(data.placement[data.usable])),
        "corners": corners,
        "corners_rejected": corners - kept,
        "stripe_points": stripes,
        "stripe_points_rejected": stripes - kept_stripes,
        "per_view": _per_view(result, observations, data, distance),
        "condition": determination.condition,
        "unobserved": determination.unobserved,
        "spectrum": determination.spectrum,
        "prior_share": {"cost": prior_cost, "information": determination.prior_share},
        "prior_residuals": _prior_residuals(prior, names),
        "board_warp_m": [float(value) for value in result.problem.shape[:2]],
        "board_warp_sigma_m": [float(value) for value in sigma[-3:-1]],
        "board_pitch": float(result.problem.shape[2]),
        "board_pitch_sigma": float(sigma[-1]),
        "steps": result.steps,
    }
    quality["warnings"] = _warnings(quality)
    return quality


def _per_view(
    result: Adjustment, observations: Observations, data: Prepared, distance: np.ndarray
) -> list[dict[str, float | int]]:
    records = np.asarray(observations.corners.record)
    depth = np.asarray(result.linearised.view_poses)[:, 2, 3]
    views = []
    for view in np.flatnonzero(data.usable):
        seen = data.corner_valid[view]
        rows = data.stripe_view == view
        points = result.stripe_keep & rows[:, None]
        views.append(
            {
                "record": int(records[view]),
                "corners": int(seen.sum()),
                "dropped": not bool(result.view_keep[view]),
                "corners_rejected": int((seen & ~result.corner_keep[view]).sum()),
                "corner_rms_px": _rms(distance[view, seen]),
                "stripe_points": int(points.sum()),
                "stripe_rms_px": _rms(result.stripe_error[points]),
                "board_z_m": float(depth[view]),
            }
        )
    return views


def _prior_residuals(prior: np.ndarray, names: tuple[str, ...]) -> dict[str, float]:
    """Departure of each prior's parameter in units of the prior's standard deviation."""
    return {
        "fx/fy" if name == "fx" else name: float(value) for name, value in zip(names, prior, strict=True) if value != 0
    }


def _warnings(quality: dict[str, Any]) -> list[str]:
    warnings = []
    if quality["prior_share"]["cost"] > _PRIOR_COST_WARNING:
        warnings.append(f"priors carry {100 * quality['prior_share']['cost']:.1f} % of the cost")
    for group in ("corners", "stripe_points"):
        if quality[f"{group}_rejected"] > _REJECTED_WARNING * max(quality[group], 1):
            share = 100 * quality[f"{group}_rejected"] / quality[group]
            warnings.append(f"{share:.1f} % of the {group.replace('_', ' ')} were rejected")
    # Records of several captures may have the same number, so views are gone through one by one.
    others = float(np.median([view["corner_rms_px"] for view in quality["per_view"]])) if quality["per_view"] else 0.0
    for view in quality["per_view"]:
        record, value = view["record"], view["corner_rms_px"]
        if view["dropped"]:
            warnings.append(
                f"record {record} was left out: its corners are {value:.2f} px off and disagree with all other views"
            )
        elif value > _ODD_VIEW * others:
            warnings.append(f"record {record}: its corners are {value:.2f} px off, those of other views {others:.2f}")
    for direction in quality["unobserved"]:
        # The table's own angle errors are meant to be held by what is known of tables.
        if not set(direction) & set(ANGLE_PARAMETERS):
            warnings.append(f"held by priors rather than by data: {', '.join(direction)}")
    return warnings


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else 0.0
