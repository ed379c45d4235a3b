"""Advice on the next capture, in words, from the views of a calibration and the directions that it does not know."""

from collections.abc import Sequence

import numpy as np

from jaxscan.calibration.settings import CalibrationSettings
from jaxscan.calibration.solve.adjustment import Adjustment
from jaxscan.calibration.verdict.limits import is_named
from jaxscan.calibration.verdict.quality import GoodTo, ModelTest
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
    poses = result.linearised.view_poses[result.view_kept & data.usable]
    tilt = np.degrees(np.arccos(np.clip(np.abs(poses[:, 2, 2]), 0.0, 1.0)))
    if len(tilt) and np.quantile(tilt, 0.9) < coverage.MIN_TILT_DEG:
        lines.append(coverage.ASK_FOR_TILT.format(f"hardly one is tilted by more than {tilt.max():.0f} degrees"))
    lines += _about_stripes(result)
    if isinstance(result.problem.turntable, Turntable):
        lines += _about_turning(result)
    return tuple(lines)


def cure_causes(tests: Sequence[ModelTest], good_to: GoodTo, settings: CalibrationSettings) -> tuple[str, ...]:
    """Advice against the causes that are worth a word, the largest first.

    Args:
        tests: With their effects.
        good_to: The error that they are parts of.
        settings: Of the solve: a block that is held can be freed.
    """
    rig, held = good_to.sigma_mm is not None, lambda block: block not in settings.free
    whole = (good_to.sigma_mm if rig else good_to.sigma_px) or 0.0
    effects = [((test.effect_mm if rig else test.effect_px) or 0.0, test.name) for test in tests]
    lines = {
        "board": "free the board's shape (do not hold `warp` or `shape`)"
        if held("warp") or held("shape")
        else "glue the board to something flat and stiff, and take more poses of it",
        "table": "do not hold `harmonics`" if held("harmonics") else f"capture {_CURES[ANGLE_PARAMETERS]}",
        "axis": "check that no board, camera or laser can move while the table turns, and its bearing for play",
        "sheet": "let the sheet bow (`--free bow`)"
        if held("bow")
        else "look at the laser's line on a flat wall: is it straight?",
        "halves": "take more poses of the board, evenly over image and distances",
        "regions": _CURES[_LENS].replace("boards", "capture boards", 1),
        "lines": "see that neither board nor laser moves between the images of a record, and take again the records "
        "whose line was left out",
    }
    named = [name for effect, name in sorted(effects, reverse=True) if is_named(effect, whole)]
    return tuple(lines[name] for name in named if name in lines)


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
    depth = result.linearised.view_poses[:, 2, 3]
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
