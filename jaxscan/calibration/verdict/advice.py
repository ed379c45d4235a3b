"""Advice on the next capture, in words, from the views of a calibration and the directions that it does not know."""

from collections.abc import Sequence

import numpy as np

from jaxscan.calibration.solve.adjust import Adjustment
from jaxscan.geometry import CAMERAS, Turntable, coverage
from jaxscan.geometry.motions import ANGLE_PARAMETERS


_MIN_TURN_DEG = 15.0

_LENS = tuple({name for camera in CAMERAS.values() for block in camera.lens for name in block.parameters})

# Captures that make a weak direction known, by the names of its largest component.
_CURES = {
    ("fx", "fy"): "boards tilted by 20 to 45 degrees at several distances (focal length)",
    ("cx", "cy"): "the board turned in its plane by 90 degrees, and tilted both ways (principal point)",
    _LENS: "boards right into the corners of the image (lens)",
    ("n1", "n2", "d"): "the stripe on boards at clearly different distances (laser sheet)",
    ("b2", "b3"): "the stripe on boards at both ends of the lit field (bow of the sheet)",
    ("axis.d1", "axis.d2", "axis.p1", "axis.p2"): "placements at more and wider table angles (axis)",
    ("warp.x", "warp.y"): "strongly tilted boards close up (bow of the board)",
    ("travel.t1", "travel.t2"): "placements at more and wider positions of the stage (direction of travel)",
    ANGLE_PARAMETERS: "placements all around, at about 0, 90, 180 and 270 degrees of the table (its angle errors)",
}


def advise(result: Adjustment, unobserved: Sequence[dict[str, float]]) -> tuple[str, ...]:
    """Captures that would help, the most needed first; empty where nothing is missing.

    Args:
        result: The finished solve, converged.
        unobserved: Directions that the priors know better than the data, as components by name.
    """
    data = result.data
    lines = [f"capture {cure}" for cure in cures(unobserved)]
    seen = data.corner_q[result.corner_kept]
    empty = coverage.empty_parts(coverage.count_cells(seen, data.size))
    if empty:
        lines.append(coverage.ASK_FOR_PARTS.format(", ".join(empty)))
    poses = np.asarray(result.linearised.view_poses)[result.view_kept & data.usable]
    tilt = np.degrees(np.arccos(np.clip(np.abs(poses[:, 2, 2]), 0.0, 1.0)))
    if len(tilt) and np.quantile(tilt, 0.9) < coverage.MIN_TILT_DEG:
        lines.append(coverage.ASK_FOR_TILT.format(f"hardly one is tilted by more than {tilt.max():.0f} degrees"))
    lines += _about_stripes(result)
    if isinstance(result.problem.turntable, Turntable):
        lines += _about_turning(result)
    return tuple(lines)


def cures(unobserved: Sequence[dict[str, float]]) -> list[str]:
    """Captures by which directions, as components by name, become known."""
    wanted: list[str] = []
    for direction in unobserved:
        largest = max(direction, key=lambda name: abs(direction[name]))
        ending = largest.rsplit(".", 1)[-1] if largest.startswith("laser.") else largest
        wanted += [cure for names, cure in _CURES.items() if ending in names and cure not in wanted]
    return wanted


def _about_stripes(result: Adjustment) -> list[str]:
    data, lines = result.data, []
    depth = np.asarray(result.linearised.view_poses)[:, 2, 3]
    for laser in range(len(result.problem.lasers.distance)):
        lit = (data.stripe_laser == laser) & result.stripe_kept.any(1)
        depths = depth[data.stripe_view[lit]]
        if len(depths) < coverage.MIN_STRIPES:
            lines.append(coverage.ASK_FOR_STRIPES.format(len(depths)))
        elif depths.min() > 0 and depths.max() < coverage.MIN_DEPTH_RATIO * depths.min():
            between = f"{depths.min():.2f} to {depths.max():.2f} m, and beyond that the sheet is a guess"
            lines.append(coverage.ASK_FOR_DEPTHS.format(between))
    return lines


def _about_turning(result: Adjustment) -> list[str]:
    data = result.data
    used = result.view_kept & data.usable
    angles = [data.angle[used & (data.placement == number)] for number in np.unique(data.placement[used])]
    turned = [np.degrees(np.ptp(stops)) for stops in angles if len(stops) > 1]
    lines = []
    if len(turned) < coverage.MIN_PLACEMENTS:
        lines.append(coverage.ASK_FOR_PLACEMENTS.format(len(turned)))
    if turned and max(turned) < _MIN_TURN_DEG:
        lines.append(
            f"turn the table farther while the board stands: the widest turn is {max(turned):.1f} degrees, and the "
            "wider it is, the better is the axis known"
        )
    return lines
