"""Pictures of walls seen straight on, in the colours of the cloud, each pixel as large on the wall as every other."""

from dataclasses import dataclass

import numpy as np

from jaxscan.drawing.contours import joined_quads
from jaxscan.drawing.survey import Survey
from jaxscan.errors import MeasurementError
from jaxscan.measurement.grid import MOST_PIXELS, Quads, rasterise


BEFORE_M, BEHIND_M = 0.2, 0.1
"""Things up to this distance before and behind a wall are in its picture [m]."""


@dataclass(frozen=True)
class Orthophoto:
    """A wall, seen from within the room."""

    side: str
    rgb: np.ndarray
    """[rows, columns, 3], uint8; the first row is at the top, the first column at the wall's last corner."""
    seen: np.ndarray
    """Which pixels show a surface [rows, columns]; the others are white."""
    pixel_m: float


def draw_orthophotos(survey: Survey, rgb: np.ndarray, *, pixel_m: float = 0.005) -> list[Orthophoto]:
    """Draw every wall that was seen.

    Args:
        survey: The room.
        rgb: Colours of the cloud [profiles, lines, 3], uint8.
        pixel_m: Size of a pixel on the wall [m].

    Returns:
        A picture of each wall that was seen, in the order of the outline.

    Raises:
        MeasurementError: If there is no ceiling, up to which walls reach, or the pictures would be too large.
    """
    room = survey.outline
    if room.ceiling is None:
        raise MeasurementError("No ceiling was found, up to which the pictures of the walls would reach.")
    colours = np.asarray(rgb, np.float64).reshape(-1, 3)
    joined = joined_quads(survey.quads, survey.p, survey.eye)
    pictures = []
    for loop, low, high in zip(room.loops, room.corners(), room.corners(room.ceiling), strict=True):
        for i, side in enumerate(loop):
            if not side.seen:
                continue
            # From within, the outline goes from right to left.
            start, end = low[(i + 1) % len(loop)].at, low[i].at
            top = max(high[i].at[2], high[(i + 1) % len(loop)].at[2])
            size = np.array([np.linalg.norm(end - start), top])
            columns, rows = (int(np.ceil(each / pixel_m)) for each in size)
            if columns * rows > MOST_PIXELS:
                raise MeasurementError(
                    f"The picture of {side.name} would have {columns} x {rows} pixels of {1e3 * pixel_m:g} mm, "
                    f"expected at most {MOST_PIXELS:g} in all: choose larger pixels."
                )
            along = (end - start) / np.linalg.norm(end - start)
            depth = survey.p @ side.surface.plane.normal - side.surface.plane.distance
            place = np.stack([(survey.p - start) @ along, top - survey.p[:, 2]], 1) / pixel_m - 0.5
            near = (depth > -BEFORE_M) & (depth < BEHIND_M)
            quads = Quads(joined.corners[near[joined.corners].all(1)])
            raster = rasterise(quads, place, (rows, columns), depth)
            seen = raster.quad >= 0
            picture = np.full((rows, columns, 3), 255, np.uint8)
            if len(quads.corners):
                picture[seen] = np.round(raster.of(quads, colours)[seen]).astype(np.uint8)
            pictures.append(Orthophoto(side.name, picture, seen, pixel_m))
    return pictures
