"""What to capture next, in words, from what a calibration has seen and what it lacks."""

from collections.abc import Sequence

import numpy as np

from jaxscan.calibration.solve.adjust import Adjustment
from jaxscan.calibration.solve.prepare import Prepared
from jaxscan.geometry import CAMERAS


# Cells of the image that should all have seen corners.
_COLUMNS, _ROWS = 4, 3
_MIN_IN_CELL = 8
_SIDES = (("upper", "middle", "lower"), ("left", "centre", "right"))
_MIN_TILT_DEG = 20.0
_MIN_DEPTH_RATIO = 1.5
_MIN_PLACEMENTS, _MIN_TURN_DEG = 3, 15.0

_LENS = tuple({name for camera in CAMERAS.values() for block in camera.lens for name in block.parameters})

# Captures that make known the parameter that a weak direction is mostly made of.
_CURES = {
    ("fx", "fy"): "boards tilted by 20 to 45 degrees at several distances (focal length)",
    ("cx", "cy"): "the board turned in its plane by 90 degrees, and tilted both ways (principal point)",
    _LENS: "boards right into the corners of the image (lens)",
    ("n1", "n2", "d"): "the stripe on boards at clearly different distances (laser sheet)",
    ("b2", "b3"): "the stripe on boards at both ends of the lit field (bow of the sheet)",
    ("axis.d1", "axis.d2", "axis.p1", "axis.p2"): "placements at more and wider table angles (axis)",
    ("warp.x", "warp.y"): "strongly tilted boards close up (bow of the board)",
    (
        "gain",
        "c1",
        "s1",
        "c2",
        "s2",
    ): "placements all around, at about 0, 90, 180 and 270 degrees of the table (its angle errors)",
}


def advise(result: Adjustment, data: Prepared, unobserved: Sequence[dict[str, float]]) -> list[str]:
    """Captures that would help, the most needed first; empty where nothing is missing.

    Args:
        result: The finished solve.
        data: What it was solved from.
        unobserved: Directions that the priors know better than the data, as components by name.
    """
    lines = [f"capture {cure}" for cure in cures(unobserved)]
    seen = data.corner_q[result.corner_keep]
    empty = _empty_cells(seen, data.size)
    if empty:
        lines.append(f"bring the board into the {', '.join(empty)} of the image: too few corners lie there")
    poses = np.asarray(result.linearised.view_poses)[result.view_keep & data.usable]
    tilt = np.degrees(np.arccos(np.clip(np.abs(poses[:, 2, 2]), 0.0, 1.0)))
    if len(tilt) and np.quantile(tilt, 0.9) < _MIN_TILT_DEG:
        lines.append(f"tilt the board by 20 to 45 degrees: hardly one is tilted by more than {tilt.max():.0f} degrees")
    if result.problem.turntable is None:
        return lines
    return lines + _about_stripes(result, data) + _about_turning(result, data)


def cures(unobserved: Sequence[dict[str, float]]) -> list[str]:
    """What to capture so that directions, as components by name, become known."""
    wanted: list[str] = []
    for direction in unobserved:
        largest = max(direction, key=lambda name: abs(direction[name]))
        ending = largest.rsplit(".", 1)[-1] if largest.startswith("laser.") else largest
        wanted += [cure for names, cure in _CURES.items() if ending in names and cure not in wanted]
    return wanted


def _empty_cells(q: np.ndarray, size: tuple[int, int]) -> list[str]:
    counts, _, _ = np.histogram2d(
        q[:, 1], q[:, 0], bins=(_ROWS, _COLUMNS), range=((-0.5, size[1] - 0.5), (-0.5, size[0] - 0.5))
    )
    names = []
    for row, column in zip(*np.nonzero(counts < _MIN_IN_CELL), strict=True):
        side = _SIDES[1][0 if column == 0 else 2 if column == _COLUMNS - 1 else 1]
        names.append(f"{_SIDES[0][row]} {side}")
    return list(dict.fromkeys(names))


def _about_stripes(result: Adjustment, data: Prepared) -> list[str]:
    lines = []
    depth = np.asarray(result.linearised.view_poses)[:, 2, 3]
    for laser in range(len(result.problem.lasers.distance)):
        lit = (data.stripe_laser == laser) & result.stripe_keep.any(1)
        depths = depth[data.stripe_view[lit]]
        if len(depths) < 4:
            lines.append(f"capture the stripe on more boards: it was seen on {len(depths)}")
        elif depths.min() > 0 and depths.max() < _MIN_DEPTH_RATIO * depths.min():
            lines.append(
                f"capture the stripe nearer and farther: all boards with a stripe stand at {depths.min():.2f} to "
                f"{depths.max():.2f} m, and beyond that the sheet is a guess"
            )
    return lines


def _about_turning(result: Adjustment, data: Prepared) -> list[str]:
    used = result.view_keep & data.usable
    angles = [data.angle[used & (data.placement == number)] for number in np.unique(data.placement[used])]
    turned = [np.degrees(np.ptp(stops)) for stops in angles if len(stops) > 1]
    lines = []
    if len(turned) < _MIN_PLACEMENTS:
        lines.append(
            f"leave the board standing in {_MIN_PLACEMENTS} or more places while the table turns: there is "
            f"{len(turned)}"
        )
    if turned and max(turned) < _MIN_TURN_DEG:
        lines.append(
            f"turn the table farther while the board stands: the widest turn is {max(turned):.1f} degrees, and the "
            "wider it is, the better is the axis known"
        )
    return lines
