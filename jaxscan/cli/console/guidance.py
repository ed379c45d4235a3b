"""Where to hold the board next, as numbers from which a page draws pictures."""

from typing import TYPE_CHECKING, Any

import numpy as np


if TYPE_CHECKING:
    from scanrig.checks.guide import Coverage, Guide, Look


_TILT_DEG = 30.0
"""Tilt that is asked for."""
_SIDES_DEG = (0.0, 90.0, 180.0, 270.0)


def guidance(guide: "Guide", look: "Look | None", kind: str) -> dict[str, Any]:
    """What a page needs to draw the board as it is held, what is covered, and where to hold it next.

    Args:
        guide: With the poses so far.
        look: The present pose; None if nobody looked yet.
        kind: "free" or "placement".
    """
    from jaxscan.geometry.coverage import MIN_IN_CELL, MIN_TILT_DEG

    seen = guide.coverage()
    told: dict[str, Any] = {
        "advice": guide.advice("placement" if kind == "placement" else "free"),
        "covered": (seen.corners >= MIN_IN_CELL).tolist(),
        "corners": seen.corners.tolist(),
        "views": seen.views,
        "tilted": seen.tilted,
        "tilt_sides": seen.tilt_sides,
        "min_tilt_deg": MIN_TILT_DEG,
        "depth_m": seen.depth_m,
        "crossed": seen.crossed,
        "lit": seen.lit,
        "placements": seen.placements,
        "next": _next(guide, seen),
        "found": [],
        "problem": "",
        "pose": None,
    }
    if look is not None:
        told["problem"] = look.problem
        told["notes"] = list(look.notes)
        if look.view is not None:
            told["found"] = look.view.q.round(1).tolist()
            pose = guide.pose(look)
            told["pose"] = None if pose is None else {name: round(value, 3) for name, value in vars(pose).items()}
    return told


def _next(guide: "Guide", seen: "Coverage") -> dict[str, Any]:
    """A place in the image, 0 ... 1 in both directions, and a tilt: the emptiest cell, and a side not shown yet."""
    rows, columns = seen.corners.shape
    row, column = np.unravel_index(int(np.argmin(seen.corners)), seen.corners.shape)
    covered = bool(seen.corners.min() > 0) if seen.views else False
    at = [0.5, 0.5] if covered or not seen.views else [(column + 0.5) / columns, (row + 0.5) / rows]
    side = _SIDES_DEG[seen.views % len(_SIDES_DEG)]
    return {"at": at, "tilt_deg": _TILT_DEG if seen.views else 0.0, "towards_deg": side}
