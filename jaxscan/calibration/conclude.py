"""A finished solve made a calibration: covariance, fit, quality and verdict."""

from dataclasses import asdict, replace

import numpy as np

from jaxscan.calibration.adjust import Adjustment, Determination, determine, not_converged, undetermined_shares
from jaxscan.calibration.advice import advise, cure_causes, cures, refusal, warn
from jaxscan.calibration.problem import bend_of
from jaxscan.calibration.propagate import focal_share, measure_good_to, predict_lengths
from jaxscan.calibration.result import (
    Calibration,
    Direction,
    Fit,
    PriorShare,
    Quality,
    Verdict,
    ViewQuality,
    chance,
    is_held_by_priors,
)
from jaxscan.calibration.settings import CalibrationSettings, board_blocks, is_mode
from jaxscan.calibration.structure import Harm, find_harm
from jaxscan.errors import CalibrationError
from jaxscan.geometry import AbstractCamera, Scanner, carrying, make_layout, root_of
from jaxscan.geometry.motions import ANGLE_PARAMETERS
from jaxscan.observation import Observations


# Unknowns with less than this of the largest part in the undetermined directions are not named.
_LEAST_SHARE = 0.1
_FITTED = "even print", "weak edge", "strong edge"
# In the order of the contrast classes.
_CONTRASTS = (*_FITTED, *(f"{name}, not through the print" for name in _FITTED))


def conclude(
    result: Adjustment,
    camera: AbstractCamera,
    observations: Observations,
    settings: CalibrationSettings,
    given: Observations | None = None,
) -> Calibration:
    """The calibration that a solve ended with; call in 64 bit.

    Nothing is concluded from a solve that did not converge: no lengths, no tests, no weak directions.

    Raises:
        CalibrationError: If the observations do not determine the parameters; it names the captures that are missing.
    """
    problem, motion = result.problem, result.problem.turntable
    lasers = observations.laser_names[: len(problem.lasers.distance)]
    board = board_blocks(problem.modes.corner.shape[-1])
    names = make_layout(problem.camera, lasers, motion=motion.blocks, board=board).names
    determination = _determined(result, names)
    layout = make_layout(camera, lasers, motion=motion.blocks, board=board)
    every, count = layout.names, layout.board.start
    kept = np.array([names.index(name) for name in every])
    turned = -1.0 if observations.carries == "object" else 1.0
    sign = np.array([turned if name in ANGLE_PARAMETERS else 1.0 for name in every])
    noise = determination.covariance[np.ix_(kept, kept)] * np.outer(sign, sign)
    quality, covariance = _describe(result, determination, observations, names), noise
    harms: list[Harm] = []
    if not result.converged:
        quality = replace(quality, verdict=Verdict(False, refused=not_converged(settings)), unobserved=(), spectrum=())
    else:
        quality = replace(quality, warnings=warn(quality))
        if settings.judge:
            harms = [
                harm._replace(steps=harm.steps[:, kept] * sign)
                for harm in find_harm(result, settings, given or observations)
            ]
            covariance = noise + sum(harm.steps.T @ harm.steps for harm in harms)
    own = np.ascontiguousarray(covariance[:count, :count])
    scanner = None
    if lasers or motion.blocks:
        motion = carrying(motion, observations.carries)
        scanner = Scanner(camera, problem.lasers, motion, own, lasers, observations.up)
    if harms:
        if any(len(harm.steps) for harm in harms):
            sigma = np.sqrt(np.diag(noise)[:count])
            quality = replace(quality, sigma_statistical=dict(zip(every[:count], sigma.tolist(), strict=True)))
        structure = [(harm.test, harm.steps[:, :count]) for harm in harms]
        good_to, tests = measure_good_to(camera, scanner, root_of(noise[:count, :count]), structure, settings.at_m)
        focal = focal_share(camera, root_of(own))
        refused = refusal(good_to, camera, settings, has_sheets=bool(lasers), focal=focal)
        quality = replace(
            quality,
            lengths=None if scanner is None else predict_lengths(scanner, settings.at_m),
            verdict=Verdict(
                refused is None,
                good_to,
                refused,
                chance([test.p for test in tests]),
                chance([test.p_structure for test in tests]),
                tests,
                (*cure_causes(tests, good_to, settings), *advise(result, quality.unobserved)),
            ),
        )
    return Calibration(
        camera=camera,
        scanner=scanner,
        order=every[:count],
        covariance=own,
        quality=quality,
        observations=observations,
        provenance={"settings": asdict(settings)},
        fit=_fit(result, observations, covariance),
    )


def _determined(result: Adjustment, names: tuple[str, ...]) -> Determination:
    """Raised also where the solve did not converge: undetermined parameters are a cause of that."""
    scales = np.asarray(result.problem.scales)
    shares = undetermined_shares(result.linearised, scales)
    least = _LEAST_SHARE * shares.max()
    found = {name: float(share) for name, share in zip(names, shares, strict=True) if share > least}
    if not found:
        return determine(result.linearised, scales, names)
    wanted = "; ".join(cures([found])) or "boards tilted by 20 to 45 degrees all over the image"
    raise CalibrationError(
        f"The observations say nothing about a combination of {', '.join(found)}: capture {wanted}, or hold "
        "parameters that are not needed (`free`)."
    )


def _fit(result: Adjustment, observations: Observations, covariance: np.ndarray) -> Fit:
    """Every observation after the solve, without padding."""
    views, corners = np.shape(observations.corners.valid)
    stripes, points = np.shape(observations.stripes.valid)
    corner = lambda values: np.ascontiguousarray(values[:views, :corners])
    stripe = lambda values: np.ascontiguousarray(values[:stripes, :points])
    kx, ky, pitch = (float(value) for value in result.problem.shape[:3])
    leverage = result.linearised.corner_leverage.reshape(result.corner_error.shape)
    bend, offset = bend_of(result.problem)
    return Fit(
        pose=result.linearised.view_poses[:views],
        warp=np.array([kx, ky]),
        pitch=pitch,
        corner_error=corner(result.corner_error),
        corner_sigma=corner(result.corner_sigma),
        corner_leverage=corner(leverage),
        corner_inlier=corner(result.corner_inlier),
        stripe_error=stripe(result.stripe_error),
        stripe_sigma=stripe(result.stripe_sigma),
        stripe_leverage=stripe(result.linearised.stripe_leverage),
        stripe_inlier=stripe(result.stripe_inlier),
        covariance=covariance,
        bend=bend,
        offset=offset[:corners],
    )


def _describe(
    result: Adjustment, determination: Determination, observations: Observations, names: tuple[str, ...]
) -> Quality:
    """The quality of a calibration as far as one solve says it; lengths, verdict and time come later."""
    data, prior = result.data, result.linearised.residuals.prior
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
        corner_rms_px=_rms(distance[result.corner_inlier]),
        corner_rms_all_px=_rms(distance[data.corner_valid]),
        stripe_rms_px=_rms(result.stripe_error[result.stripe_inlier]),
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
        placements=len(np.unique(data.placement[data.fixes_pose])),
        corners=corners,
        corners_rejected=corners - int(result.corner_inlier.sum()),
        stripe_points=stripes,
        stripe_points_rejected=stripes - int(result.stripe_inlier.sum()),
        per_view=per_view,
        condition=determination.condition,
        unobserved=tuple(row.direction for row in spectrum if is_held_by_priors(row.sigma_over_prior)),
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


def _per_view(result: Adjustment, observations: Observations, distance: np.ndarray) -> tuple[ViewQuality, ...]:
    data, records = result.data, np.asarray(observations.corners.record)
    # A stripe that agrees with no sheet keeps its row, without a point.
    without = ~np.any(np.asarray(observations.stripes.valid), axis=1)
    elsewhere = set(np.asarray(observations.stripes.view)[without].tolist())
    depth = result.linearised.view_poses[:, 2, 3]
    views = []
    for view in np.flatnonzero(data.fixes_pose):
        seen = data.corner_valid[view]
        points = result.stripe_inlier & (data.stripe_view == view)[:, None]
        views.append(
            ViewQuality(
                record=int(records[view]),
                corners=int(seen.sum()),
                dropped=not bool(result.view_inlier[view]),
                corners_rejected=int((seen & ~result.corner_inlier[view]).sum()),
                corner_rms_px=_rms(distance[view, seen]),
                stripe_points=int(points.sum()),
                stripe_rms_px=_rms(result.stripe_error[points]),
                stripe_elsewhere=int(view) in elsewhere,
                board_z_m=float(depth[view]),
            )
        )
    return tuple(views)


def _prior_cost(result: Adjustment, prior: np.ndarray) -> float:
    """Share of the priors in the cost."""
    corner = np.sum(np.square(result.corner_error / result.corner_sigma[..., None])[result.corner_inlier])
    stripe = np.sum(np.square(result.stripe_error / result.stripe_sigma)[result.stripe_inlier])
    own = float(np.sum(prior**2))
    return own / max(own + float(corner + stripe / result.stripe_correlation), 1e-300)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else 0.0


def _noise_by_contrast(result: Adjustment) -> dict[str, float]:
    """Estimated noise over the given sigma of each contrast class that has kept points [1]."""
    points = np.bincount(result.data.stripe_contrast[result.stripe_inlier], minlength=len(_CONTRASTS))
    return {
        name: float(noise) for name, noise, count in zip(_CONTRASTS, result.stripe_noise, points, strict=True) if count
    }
