"""A first estimate as the second look needs it, and which of two estimates to keep."""

import numpy as np

from jaxscan.calibration.calibrate import Estimate
from jaxscan.calibration.solve import bend_of, undetermined_shares
from jaxscan.calibration.verdict import SecondLook
from jaxscan.geometry import Scanner
from jaxscan.observation import Observations, SolvedRig


# The second solve may whiten worse by this factor: corners at the rim of the image are harder to explain. What is no
# larger than the detectors promise is explained: a first look may hide an error of its own that the solve takes up.
_NOT_WORSE = 1.05
# Share of the boards with a line that must agree with a sheet, so that stripes are looked for near it only.
_BELIEVED = 0.5


def solved_rig(found: Estimate) -> SolvedRig | None:
    """The rig and its boards, from which new places of corners and stripes are predicted.

    None of a solve that did not converge, or leaves parameters undetermined: it predicts nothing.
    """
    result, observations = found.adjustment, found.observations
    problem = result.problem
    if not result.converged or undetermined_shares(result.linearised, np.asarray(problem.scales)).any():
        return None
    scanner = None
    if found.rig.lasers or found.rig.moves:
        motion = problem.turntable.carrying(observations.carries)
        scanner = Scanner(found.camera, problem.lasers, motion, None, found.rig.lasers, observations.up)
    views, corners = np.shape(observations.corners.valid)
    bend, offset = bend_of(problem)
    squares = np.sum(result.corner_error[result.corner_kept] ** 2, axis=-1)
    return SolvedRig(
        camera=found.camera,
        scanner=scanner,
        board=observations.board,
        shape=np.asarray(problem.shape)[:3],
        bend=bend,
        offset=offset[:corners],
        poses=result.linearised.view_poses[:views],
        used=np.any(result.corner_kept, axis=1)[:views],
        corner_rms_px=float(np.sqrt(squares.mean())) if squares.size else 0.0,
        believed=_believed(observations),
    )


def _believed(observations: Observations) -> tuple[str, ...]:
    """The lasers on whose sheet the lines of most boards lie: a stripe elsewhere has a row without a point."""
    laser, found = np.asarray(observations.stripes.laser), np.any(np.asarray(observations.stripes.valid), axis=1)
    own = {name: found[laser == index] for index, name in enumerate(observations.laser_names)}
    return tuple(name for name, lit in own.items() if lit.sum() > _BELIEVED * len(lit))


def choose(first: Estimate, second: Estimate) -> tuple[Estimate, SecondLook]:
    """The second estimate unless it explains its observations worse, and the gains of the second look."""
    before, after = (_explained(one) for one in (first, second))
    # A look that loses a part of the rig would explain the rest of its observations well.
    whole = set(first.rig.lasers) <= set(second.rig.lasers) and (second.rig.moves or not first.rig.moves)
    names = "corner_rms_whitened", "stripe_rms_whitened"
    explains = all(after[name] <= _NOT_WORSE * max(before[name], 1.0) for name in names)
    kept = whole and second.adjustment.converged and explains
    look = SecondLook(
        kept,
        views_gained=int(after["views"] - before["views"]),
        corners_gained=int(after["corners"] - before["corners"]),
        stripe_points_gained=int(after["stripe_points"] - before["stripe_points"]),
        corner_rms_whitened_before=before["corner_rms_whitened"],
        stripe_rms_whitened_before=before["stripe_rms_whitened"],
        corner_rms_whitened_after=after["corner_rms_whitened"],
        stripe_rms_whitened_after=after["stripe_rms_whitened"],
    )
    return second if kept else first, look


def _explained(found: Estimate) -> dict[str, float]:
    data, (corner_rms, stripe_rms) = found.adjustment.data, found.adjustment.whitened_rms()
    return {
        "corner_rms_whitened": corner_rms,
        "stripe_rms_whitened": stripe_rms,
        "views": int(data.usable.sum()),
        "corners": int(data.corner_valid.sum()),
        "stripe_points": int(data.stripe_valid.sum()),
    }
