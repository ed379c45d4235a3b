"""The verdict in words: warnings, why a calibration cannot be used, and captures that would help."""

from collections.abc import Sequence

import numpy as np

from jaxscan.calibration import result as limits
from jaxscan.calibration.adjust import Adjustment
from jaxscan.calibration.result import GoodTo, ModelTest, Quality
from jaxscan.calibration.settings import CalibrationSettings
from jaxscan.geometry import CAMERAS, AbstractCamera, Turntable, coverage
from jaxscan.geometry.motions import ANGLE_PARAMETERS


# Records that are named in one warning.
_NAMED = 8
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
            f"the lines found on {len(elsewhere)} of {lit} boards lie on no sheet with the others and were left out, "
            f"records {_listed(elsewhere)}: boards or laser moved between pictures, or something else shines"
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
    # The table's own angle errors are meant to be held by the priors.
    held = [direction for direction in quality.unobserved if not set(direction) & set(ANGLE_PARAMETERS)]
    warnings += [f"held by priors rather than by data: {', '.join(names)}" for names in _joined(held)]
    return tuple(warnings)


def warn_of_missing_lines(records: Sequence[int], lit: int) -> tuple[str, ...]:
    """A warning about boards that a sheet meets and on which no line was found."""
    if not records:
        return ()
    return (
        f"no line was found on {len(records)} of {lit} boards that the laser's sheet meets: records {_listed(records)}",
    )


def _joined(directions: Sequence[dict[str, float]]) -> list[list[str]]:
    """The names in the directions, of those together that have one in common: they are one fact."""
    groups: list[list[str]] = []
    for direction in directions:
        own = [group for group in groups if set(group) & set(direction)]
        together = list(dict.fromkeys([name for group in own for name in group] + list(direction)))
        groups = [group for group in groups if group not in own] + [together]
    return groups


def _listed(records: Sequence[int]) -> str:
    """The first few numbers, and how many more there are."""
    more = len(records) - _NAMED
    return ", ".join(map(str, records[:_NAMED])) + (f" and {more} more" if more > 0 else "")


def refusal(
    good_to: GoodTo,
    camera: AbstractCamera,
    settings: CalibrationSettings,
    *,
    has_sheets: bool = True,
    focal: float = 0.0,
) -> str | None:
    """Why a calibration cannot be used, its focal length known to a share of it; None where it can."""
    mm, px, at_m = good_to.sigma_mm, good_to.sigma_px, good_to.at_m
    if mm is None and settings.limit_mm is not None:
        if not has_sheets:
            return f"{settings.limit_mm:g} mm were asked, and without a laser sheet there are no points"
        where = "within reach" if settings.at_m is None else f"in the image at {settings.at_m:g} m"
        return f"{settings.limit_mm:g} mm were asked, and no stripe is {where}"
    if mm is not None and settings.limit_mm is not None and mm > settings.limit_mm:
        return f"{settings.limit_mm:g} mm were asked"
    if px is not None and settings.limit_px is not None and px > settings.limit_px:
        return f"{settings.limit_px:g} px were asked, and its rays are good to {px:.2g} px"
    if focal > limits.UNKNOWN_FOCAL:
        return (
            f"its focal length is known to {100 * focal:.2g} % only, which makes no camera: tilt the board by 20 to "
            "45 degrees in different directions"
        )
    share = f"{100 * limits.USELESS_SHARE:.0f} %"
    if mm is not None and at_m is not None and mm > 1e3 * limits.USELESS_SHARE * at_m:
        return f"points that are off by more than {share} of their distance are of no use"
    if px is not None and px > limits.USELESS_SHARE * 0.5 * (float(camera.fx) + float(camera.fy)):
        return f"rays that are off by more than {share} of the focal length are of no use"
    return None


def advise(result: Adjustment, unobserved: Sequence[dict[str, float]]) -> tuple[str, ...]:
    """Captures that would help, the most needed first; empty where nothing is missing."""
    data = result.data
    lines = [f"capture {cure}" for cure in cures(unobserved)]
    seen = data.corner_q[result.corner_inlier]
    empty = coverage.empty_parts(coverage.count_cells(seen, data.size))
    if empty:
        lines.append(coverage.ASK_FOR_PARTS.format(", ".join(empty)))
    poses = result.linearised.view_poses[result.view_inlier & data.fixes_pose]
    tilt = np.degrees(np.arccos(np.clip(np.abs(poses[:, 2, 2]), 0.0, 1.0)))
    if len(tilt) and np.quantile(tilt, 0.9) < coverage.MIN_TILT_DEG:
        lines.append(coverage.ASK_FOR_TILT.format(f"hardly one is tilted by more than {tilt.max():.0f} degrees"))
    lines += _about_stripes(result)
    if isinstance(result.problem.turntable, Turntable):
        lines += _about_turning(result)
    return tuple(lines)


def cure_causes(tests: Sequence[ModelTest], good_to: GoodTo, settings: CalibrationSettings) -> tuple[str, ...]:
    """Advice against the causes that are worth a word, the largest first."""
    rig, held = good_to.sigma_mm is not None, lambda block: block not in settings.free
    whole = (good_to.sigma_mm if rig else good_to.sigma_px) or 0.0
    effects = [((test.effect_mm if rig else test.effect_px) or 0.0, test) for test in tests]
    lines = {
        "board": "free the board's shape (do not hold `warp` or `shape`)"
        if held("warp") or held("shape")
        else "glue the board to something flat and stiff, and take more poses of it",
        "paper": "glue the board on a flat and stiff plate (glass, aluminium), and take its records again",
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
    worth = [(effect, test) for effect, test in effects if limits.is_named(effect, whole) or test.bend_mm]
    named = [test.name for _, test in sorted(worth, key=lambda part: -part[0])]
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
        lit = (data.stripe_laser == laser) & result.stripe_inlier.any(1)
        depths = depth[data.stripe_view[lit]]
        if len(depths) < coverage.MIN_STRIPES:
            lines.append(coverage.ASK_FOR_STRIPES.format(len(depths)))
        elif depths.min() > 0 and depths.max() < coverage.MIN_DEPTH_RATIO * depths.min():
            between = f"{depths.min():.2f} to {depths.max():.2f} m, and beyond that the sheet is a guess"
            lines.append(coverage.ASK_FOR_DEPTHS.format(between))
    return lines


def _about_turning(result: Adjustment) -> list[str]:
    data = result.data
    used = result.view_inlier & data.fixes_pose
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
