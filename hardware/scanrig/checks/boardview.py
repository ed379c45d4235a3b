"""One view of the calibration board without a calibration: its place, distance and tilt, and the stripe on it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from jaxscan.geometry import AbstractBoard, apply_homography, direct_homography, fixes_plane


_STRIPE_LINES = 20
"""Fewest lines on the board with which the laser counts as crossing it."""
_CENTRED = 0.25
"""Largest offset of the stripe from the board's middle that counts as the middle, in board widths."""
_TELLING = 0.05
"""Least root of the summed squares of the perspective in all views for which a focal length is computed."""
_FOCAL = (0.3, 6.0)
"""Plausible focal lengths, in image widths."""


@dataclass(frozen=True)
class BoardView:
    """The board in one frame."""

    q: Float[np.ndarray, "n 2"]
    """Corners that were found [px]."""
    homography: Float[np.ndarray, "3 3"]
    """Board [m] to image [px], relative to the image's centre; see `direct_homography`."""
    stripe_lines: int
    """Lines of the image on which the laser crosses the board."""
    stripe_offset: float
    """Offset of the stripe from the board's middle along the image's rows, in board widths; positive to the right."""

    @property
    def crossed(self) -> bool:
        """Whether the laser's line crosses the board."""
        return self.stripe_lines >= _STRIPE_LINES

    @property
    def where(self) -> str:
        """Where the stripe crosses the board, in words."""
        if not self.crossed:
            return "beside the board"
        if abs(self.stripe_offset) < _CENTRED:
            return "across the middle of the board"
        return f"across the {'right' if self.stripe_offset > 0 else 'left'} of the board"


@dataclass(frozen=True)
class Pose:
    """The pose of the board, with a guessed focal length."""

    tilt_deg: float
    """Between the board's normal and the camera's axis."""
    towards_deg: float
    """Direction of the tilt in the image; meaningless for small tilts."""
    roll_deg: float
    """Rotation in its plane."""
    depth_m: float
    """Distance along the camera's axis."""


def view_board(
    board: AbstractBoard,
    q: Float[np.ndarray, "corners 2"],
    valid: np.ndarray,
    stripe: Float[np.ndarray, "lines 2"] | None,
    image_size: tuple[int, int],
) -> BoardView | None:
    """A view from corners and stripe points; None if the corners fix no pose.

    Args:
        board: The board.
        q: Its corners in the image, in the board's order [px].
        valid: Which corners were found, bool [corners].
        stripe: Stripe centres in the image [px], or None.
        image_size: Width and height [px].
    """
    points = board.corners()[valid, :2]
    seen = q[valid] - _centre(image_size)
    if not (fixes_plane(points) and fixes_plane(seen)):
        return None
    homography = direct_homography(points, seen)
    lines, offset = _crossing(board, homography, stripe, image_size)
    return BoardView(q[valid], homography, lines, offset)


def pose_of(view: BoardView, focal_px: float) -> Pose | None:
    """The pose of the board; None if no camera of this focal length can see it so."""
    first, second, third = (view.homography / np.array([[focal_px], [focal_px], [1.0]])).T
    scale = 0.5 * (np.linalg.norm(first) + np.linalg.norm(second))
    if third[2] < 0:
        first, second, third = -first, -second, -third
    normal = np.cross(first, second)
    length = np.linalg.norm(normal)
    if not (np.isfinite(length) and length > 0 and scale > 0 and third[2] > 0):
        return None
    normal /= length
    return Pose(
        tilt_deg=float(np.degrees(np.arccos(np.clip(abs(normal[2]), 0.0, 1.0)))),
        towards_deg=float(np.degrees(np.arctan2(normal[1], normal[0]))),
        roll_deg=float(np.degrees(np.arctan2(first[1], first[0]))),
        depth_m=float(third[2] / scale),
    )


def guess_focal(views: Sequence[BoardView], image_size: tuple[int, int]) -> float:
    """A focal length [px] from the perspective of tilted views; the image's width if there are none.

    With square pixels and the principal point in the middle, the columns of a homography satisfy
    h1 . W h2 = 0 and h1 . W h1 = h2 . W h2 with W = diag(1/f^2, 1/f^2, 1): linear in 1/f^2.
    """
    width = float(max(image_size))
    if not views:
        return width
    h = np.stack([view.homography for view in views]) / np.array([[width], [width], [1.0]])
    h = h / np.linalg.norm(h[:, :2, :2], axis=(1, 2))[:, None, None]
    a, b = h[:, :, 0], h[:, :, 1]
    factor = np.concatenate([(a * b)[:, :2].sum(1), (a * a - b * b)[:, :2].sum(1)])
    rest = np.concatenate([a[:, 2] * b[:, 2], a[:, 2] ** 2 - b[:, 2] ** 2])
    if np.sum(rest**2) < _TELLING**2:
        return width
    # Least squares in f^2, since the noise is in the perspective, which is small.
    square = -float(np.sum(factor * rest) / np.sum(rest**2))
    return width * float(np.sqrt(square)) if _FOCAL[0] ** 2 < square < _FOCAL[1] ** 2 else width


def _centre(image_size: tuple[int, int]) -> np.ndarray:
    return 0.5 * (np.array(image_size, float) - 1.0)


def _crossing(
    board: AbstractBoard, homography: np.ndarray, stripe: np.ndarray | None, image_size: tuple[int, int]
) -> tuple[int, float]:
    """Number of image lines on which the stripe lies on the board, and its offset."""
    if stripe is None or len(stripe) == 0:
        return 0, 0.0
    outline = board.outline()
    low, high = outline.min(0), outline.max(0)
    seen = stripe - _centre(image_size)
    on_board = apply_homography(np.linalg.inv(homography), seen)
    inside = ((on_board > low) & (on_board < high)).all(1)
    if not inside.any():
        return 0, 0.0
    corners = apply_homography(homography, outline)
    offset = (seen[inside, 0].mean() - corners[:, 0].mean()) / max(float(np.ptp(corners[:, 0])), 1.0)
    return int(inside.sum()), float(offset)
