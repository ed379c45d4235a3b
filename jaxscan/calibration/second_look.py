"""A first calibration as the second look needs it, and which of two calibrations to keep."""

import numpy as np

from jaxscan.calibration.result import Calibration
from jaxscan.calibration.verdict import SecondLook
from jaxscan.observation import Observations, SolvedRig


# The second solve may whiten worse by this factor: corners at the rim of the image are harder to explain. What is no
# larger than the detectors promise is explained: a first look may hide an error of its own that the solve takes up.
_NOT_WORSE = 1.05
# Share of the boards with a line that must agree with a sheet, so that stripes are looked for near it only.
_BELIEVED = 0.5


def solved_rig(calibration: Calibration) -> SolvedRig:
    """The rig and its boards, from which new places of corners and stripes are predicted.

    Raises:
        ValueError: If the calibration holds no views.
    """
    fit, observations = calibration.fit, calibration.observations
    if fit is None or observations is None:
        raise ValueError("The calibration holds no views.")
    return SolvedRig(
        camera=calibration.camera,
        scanner=calibration.scanner,
        board=observations.board,
        shape=np.array([*fit.warp, fit.pitch]),
        bend=fit.bend,
        offset=fit.offset,
        poses=fit.pose,
        used=np.any(fit.corner_kept, axis=1),
        corner_rms_px=calibration.quality.corner_rms_px or 0.0,
        believed=_believed(observations),
    )


def _believed(observations: Observations) -> tuple[str, ...]:
    """The lasers on whose sheet the lines of most boards lie: a stripe elsewhere has a row without a point."""
    laser, found = np.asarray(observations.stripes.laser), np.any(np.asarray(observations.stripes.valid), axis=1)
    own = {name: found[laser == index] for index, name in enumerate(observations.laser_names)}
    return tuple(name for name, lit in own.items() if lit.sum() > _BELIEVED * len(lit))


def choose(first: Calibration, second: Calibration) -> tuple[Calibration, SecondLook]:
    """The second calibration unless it explains its observations worse, and the gains of the second look."""
    names = ("corner_rms_whitened", "stripe_rms_whitened", "views", "corners", "stripe_points")
    before, after = ({name: vars(calibration.quality)[name] for name in names} for calibration in (first, second))
    # A look that loses a part of the rig would explain the rest of its observations well.
    whole = set(first.order) <= set(second.order)
    kept = (
        whole
        and bool(second.quality.converged)
        and all(after[name] <= _NOT_WORSE * max(before[name], 1.0) for name in names[:2])
    )
    look = SecondLook(
        kept,
        **{f"{name}_gained": after[name] - before[name] for name in names[2:]},
        **{f"{name}_before": before[name] for name in names[:2]},
        **{f"{name}_after": after[name] for name in names[:2]},
    )
    return second if kept else first, look
