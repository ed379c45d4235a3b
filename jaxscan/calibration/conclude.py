"""A finished solve made a calibration: covariance, fit, quality and verdict."""

from dataclasses import asdict, replace

import numpy as np

from jaxscan.calibration.fit import Fit
from jaxscan.calibration.parameters import board_blocks
from jaxscan.calibration.result import Calibration
from jaxscan.calibration.settings import CalibrationSettings
from jaxscan.calibration.solve import (
    Adjustment,
    Determination,
    bend_of,
    determine,
    not_converged,
    undetermined_shares,
)
from jaxscan.calibration.verdict import (
    Harm,
    Verdict,
    advise,
    chance,
    cure_causes,
    cures,
    describe_quality,
    find_harm,
    focal_share,
    measure_good_to,
    predict_lengths,
    refusal,
    warn,
)
from jaxscan.errors import CalibrationError
from jaxscan.geometry import AbstractCamera, Scanner, make_layout, root_of
from jaxscan.geometry.motions import ANGLE_PARAMETERS
from jaxscan.observation import Observations


# Unknowns with less than this of the largest part in the undetermined directions are not named.
_LEAST_SHARE = 0.1


def conclude(
    result: Adjustment,
    camera: AbstractCamera,
    observations: Observations,
    settings: CalibrationSettings,
    given: Observations | None = None,
) -> Calibration:
    """The calibration that a solve ended with; call in 64 bit.

    Nothing is concluded from a solve that did not converge: no lengths, no tests, no weak directions.

    Args:
        result: The solve.
        camera: Its camera, with its size and without coefficients that nobody asked for.
        observations: As they were solved.
        settings: Of the solve.
        given: The observations before lines were left out; None where none was.

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
    quality, covariance = describe_quality(result, determination, observations, names), noise
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
        motion = motion.carrying(observations.carries)
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
            lengths=None if scanner is None else predict_lengths(scanner),
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
        corner_kept=corner(result.corner_kept),
        stripe_error=stripe(result.stripe_error),
        stripe_sigma=stripe(result.stripe_sigma),
        stripe_leverage=stripe(result.linearised.stripe_leverage),
        stripe_kept=stripe(result.stripe_kept),
        covariance=covariance,
        bend=bend,
        offset=offset[:corners],
    )
