"""Frames of board records to the stripes that lie on their boards."""

import functools
from typing import TYPE_CHECKING, NamedTuple, cast

import numpy as np

from jaxscan.calibration import BoardStripe, Calibration, select_board_stripes
from jaxscan.calibration.predict import lift_to_board, predict_stripe
from jaxscan.errors import CaptureError
from jaxscan.files.capture import Capture, Record
from jaxscan.geometry import AbstractBoard
from jaxscan.stripes import LaserLine, NoiseModel, Stripes, StripeSettings, extract_stripes
from jaxscan.stripes.frames.learn_colour import with_colour
from jaxscan.stripes.frames.noise import estimate_noise


if TYPE_CHECKING:
    from jaxscan.vision.boards import FoundCorners


BATCH_RECORDS = 8
"""Board records looked at together: enough for all cores, little against any memory."""
_COLOUR_RECORDS = 8
"""Records from which the colour of a laser is learned where the header leaves it open."""
# How far from where the stripe should be it is looked for [px]: its tails must be in.
_BAND_PX = 24.0
_SETTINGS = StripeSettings(guard_edges=False, learn_width=False)
"""What the ink of a board does to a stripe is corrected: sigmas are those of noise alone, and no
line knows of the others."""


class View(NamedTuple):
    """One record on its way to an observation."""

    capture: int
    record: Record
    pixel_format: str
    on: np.ndarray | None
    off: np.ndarray | None
    corners: "FoundCorners | None" = None
    stripe: BoardStripe | None = None
    pose: np.ndarray | None = None
    """T_cam_board [4, 4], where it is known beforehand."""
    noise: NoiseModel | None = None
    """Of its frames, once the stripes were looked for."""

    @staticmethod
    def of(capture: Capture, number: int, index: int) -> "View":
        """Record `index` of capture `number`, its frames read."""
        on, off = capture.frames(index)
        return View(number, capture.records[index], capture.pixel_format, on, off)

    @property
    def laser(self) -> int:
        """The one laser that is lit in the laser-on image."""
        (laser,) = self.record.lasers
        return laser

    def picture(self) -> np.ndarray | None:
        """The record in grey, without the laser where there is such a frame."""
        from jaxscan.vision.grey import to_grey

        image = self.on if self.off is None else self.off
        return None if image is None else to_grey(image, self.pixel_format)


def check_single_lasers(capture: Capture) -> None:
    """See that no stripe of a calibration could be that of another laser.

    Raises:
        CaptureError: With the first record that shows several lasers at once.
    """
    for record in capture.records:
        if len(record.lasers) > 1:
            names = ", ".join(capture.lines[laser].name for laser in record.lasers)
            raise CaptureError(
                f"{capture.path}: record {record.i}: several lasers are lit at once ({names}), but a calibration needs "
                'one per record; capture a record for each, and name it there: "lasers": ["..."].'
            )


@functools.lru_cache(maxsize=16)
def lines_with_colours(capture: Capture) -> tuple[LaserLine, ...]:
    """The lasers of a capture of a board, with colours from a few of its pairs where they are "auto".

    Raises:
        CaptureError: If a colour cannot be learned.
    """
    return tuple(_with_colour(capture, laser) for laser in range(len(capture.lines)))


def _with_colour(capture: Capture, laser: int) -> LaserLine:
    line = capture.lines[laser]
    lit = [i for i, record in enumerate(capture.records) if record.lasers == (laser,) and record.on]
    if line.colour != "auto" or not lit:
        return line
    # Pairs, where there are any.
    lit = [i for i in lit if capture.records[i].off] or lit
    chosen = np.unique(np.linspace(0, len(lit) - 1, _COLOUR_RECORDS).astype(int))
    on, off = zip(*(capture.frames(lit[i]) for i in chosen), strict=True)
    try:
        return with_colour(line, np.stack(on), None if off[0] is None else np.stack(off), capture.pixel_format)
    except ValueError as problem:
        raise CaptureError(
            f'{capture.path}: the colour of the laser "{line.name}" is "auto" and cannot be learned: {problem}'
        ) from problem


def with_stripes(views: list[View], capture: Capture, calibration: Calibration | None = None) -> list[View]:
    """The views of one batch with the stripes that lie on their boards.

    Args:
        views: At most BATCH_RECORDS, with frames and corners.
        capture: Where they are from.
        calibration: Of a first solve: stripes are then looked for only where they should be, and
            the poses of the views say what is print.
    """
    views = list(views)
    lit = [i for i, view in enumerate(views) if view.corners is not None and view.on is not None]
    for laser, line in enumerate(lines_with_colours(capture)):
        for with_off in (True, False):
            group = [i for i in lit if views[i].laser == laser and (views[i].off is not None) == with_off]
            if not group:
                continue
            # Padded to the batch's size, so that the extraction compiles once.
            padded = [views[group[min(k, len(group) - 1)]] for k in range(BATCH_RECORDS)]
            on = np.stack([cast(np.ndarray, view.on) for view in padded])
            off = np.stack([cast(np.ndarray, view.off) for view in padded]) if with_off else None
            # From whole frames: those of which only a band is left have no noise elsewhere.
            noise = views[group[0]].noise
            if noise is None:
                noise = estimate_noise(on, off, pixel_format=capture.pixel_format, response=capture.response, line=line)
            if calibration is not None and off is not None:
                on = np.stack([_band(view, calibration, laser, line) for view in padded])
            stripes = extract_stripes(
                on,
                off,
                pixel_format=capture.pixel_format,
                response=capture.response,
                line=line,
                settings=_SETTINGS,
                noise=noise,
            )
            for row, i in enumerate(group):
                stripe = _board_stripe(stripes, row, views[i], capture, calibration)
                views[i] = views[i]._replace(stripe=stripe, noise=noise)
    return views


def _band(view: View, calibration: Calibration, laser: int, line: LaserLine) -> np.ndarray:
    """The laser-on frame, its light gone but in a band round the place where the stripe should be on the board."""
    on, off = cast(np.ndarray, view.on), cast(np.ndarray, view.off)
    if view.pose is None:
        return on
    rows, columns = on.shape[:2]
    lines, samples = (rows, columns) if line.stripe_axis == "rows" else (columns, rows)
    stripe = predict_stripe(calibration, view.pose, laser, lines, line.stripe_axis)
    near = stripe.on_board[:, None] & (np.abs(np.arange(samples) - stripe.u[:, None]) <= _BAND_PX)
    near = near if line.stripe_axis == "rows" else near.T
    return np.where(near if on.ndim == 2 else near[..., None], on, off)


def _board_stripe(
    stripes: Stripes, row: int, view: View, capture: Capture, calibration: Calibration | None
) -> BoardStripe:
    from jaxscan.vision.grey import to_grey

    corners, line = cast("FoundCorners", view.corners), capture.lines[view.laser]
    fields = (stripes.u, stripes.sigma, stripes.valid, stripes.width)
    u, sigma, valid, width = (np.asarray(field)[row] for field in fields)
    board_xy = None
    if calibration is not None and view.pose is not None:
        lines = np.arange(len(u), dtype=np.float64)
        centre = np.where(valid, u, 0.0).astype(np.float64)
        q = np.column_stack([centre, lines] if line.stripe_axis == "rows" else [lines, centre])
        board_xy = lift_to_board(calibration, view.pose, q)
    return select_board_stripes(
        u,
        sigma,
        valid,
        corners=corners.q,
        corners_valid=corners.valid,
        board=cast(AbstractBoard, capture.board),
        off=None if view.off is None else to_grey(view.off, capture.pixel_format),
        width=np.where(valid, width, 1.0),
        stripe_axis=line.stripe_axis,
        board_xy=board_xy,
    )
