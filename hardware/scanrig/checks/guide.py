"""Advice for placing the calibration board: what one view shows without a calibration, and what is still missing."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Float, Int, UInt8

from jaxscan.geometry import AbstractBoard, apply_homography, coverage, direct_homography, fixes_plane


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
    depth_m: float


def view_board(
    board: AbstractBoard,
    q: Float[np.ndarray, "corners 2"],
    valid: np.ndarray,
    stripe: Float[np.ndarray, "lines 2"] | None,
    image_size: tuple[int, int],
) -> BoardView | None:
    """A view from corners in the board's order [px], which of them are valid, and the stripe's centres [px].

    None if the corners fix no pose.
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


Detect = Callable[[np.ndarray], "tuple[np.ndarray, np.ndarray] | None"]
"""Finds in a frame the corners [corners, 2] [px], in the board's order, and which are valid; None: no board."""
FindLine = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Finds in a laser-on and a laser-off frame the stripe's centres [n, 2] [px]."""

_GOOD_SHARE = 0.5
"""Part of the views that should be tilted, and part that should be crossed by the laser."""
_GOOD_DEPTH_RATIO = 2.0
_GOOD_ROLL_DEG = 45.0
_DARK_DN, _CLIPPED_DN, _CLIPPED_SHARE = 40, 250, 0.25
_NAMED_CELLS = 3
_SIDES_OF_TILT = 4


@dataclass(frozen=True)
class Look:
    """One pose of the board as seen by the camera."""

    view: BoardView | None
    """None: the pose cannot be used."""
    problem: str = ""
    notes: tuple[str, ...] = ()
    laser: int = 0
    """Which laser it shows, counted from 0."""


@dataclass(frozen=True)
class Coverage:
    """Coverage of the poses so far."""

    views: int
    corners: Int[np.ndarray, "rows columns"]
    """Number of corners in each cell of the image."""
    tilted: int
    """Views tilted by `coverage.MIN_TILT_DEG` or more."""
    tilts_deg: tuple[float, ...]
    tilt_sides: int
    """Number of sides, of four, towards which the board was tilted."""
    depth_m: tuple[float, float] | None
    """Smallest and largest depth, with a guessed focal length."""
    stripe_depth_m: tuple[float, float] | None
    """The same for boards that the laser crosses; this and the next three are for the laser with the fewest."""
    crossed: int
    lit: int
    laser: str
    roll_deg: float
    """Largest rotation of the board in its plane between views."""
    placements: int

    @property
    def empty_cells(self) -> tuple[str, ...]:
        """Names of the parts of the image with too few corners, the emptiest first."""
        return coverage.empty_parts(self.corners)


@dataclass
class Guide:
    """Examines poses, keeps those that were taken, and advises which are missing."""

    board: AbstractBoard
    image_size: tuple[int, int]
    detect: Detect
    find_lines: Mapping[str, FindLine] = field(default_factory=dict)
    """One for each laser, by its name and in their order; empty: without laser."""
    _views: list[BoardView] = field(default_factory=list)
    _lasers: list[int] = field(default_factory=list)
    _placements: set[int] = field(default_factory=set)

    def look(self, on: UInt8[np.ndarray, "..."] | None, off: UInt8[np.ndarray, "..."], laser: int = 0) -> Look:
        """Examine one pose by its laser-on frame, if there is one, and its laser-off frame, without keeping it."""
        found = self.detect(off)
        finders = tuple(self.find_lines.values())
        stripe = finders[laser](on, off) if on is not None and finders else None
        view = None if found is None else view_board(self.board, *found, stripe, self.image_size)
        if view is None:
            return Look(None, _why_not_found(off))
        notes = []
        if finders and not view.crossed:
            notes.append("the laser's line does not cross the board; move the board into it in most of the poses")
        return Look(view, notes=tuple(notes), laser=laser)

    def keep(self, look: Look, placement: int | None = None) -> None:
        """Count a pose that was taken, and the number of its placement, if it belongs to one."""
        if look.view is not None:
            self._views.append(look.view)
            self._lasers.append(look.laser)
            if placement is not None:
                self._placements.add(placement)

    def pose(self, look: Look) -> Pose | None:
        """The pose of the board, with a focal length from all poses so far."""
        if look.view is None:
            return None
        return pose_of(look.view, guess_focal([*self._views, look.view], self.image_size))

    def coverage(self) -> Coverage:
        """Coverage of the poses so far."""
        focal = guess_focal(self._views, self.image_size)
        shown = list(zip(self._views, self._lasers, strict=True))
        posed = [(view, laser, pose) for view, laser in shown if (pose := pose_of(view, focal)) is not None]
        lasers = range(max(1, len(self.find_lines)))
        fewest = min(lasers, key=lambda one: sum(view.crossed for view, laser in shown if laser == one))
        theirs = [view for view, laser in shown if laser == fewest]
        on_boards = [pose.depth_m for view, laser, pose in posed if view.crossed and laser == fewest]
        poses = [pose for _, _, pose in posed]
        tilted = [pose for pose in poses if pose.tilt_deg >= coverage.MIN_TILT_DEG]
        return Coverage(
            views=len(self._views),
            corners=self._cells(),
            tilted=len(tilted),
            tilts_deg=tuple(pose.tilt_deg for pose in poses),
            tilt_sides=len({round(pose.towards_deg / 90.0) % 4 for pose in tilted}),
            depth_m=_range([pose.depth_m for pose in poses]),
            stripe_depth_m=_range(on_boards),
            crossed=sum(view.crossed for view in theirs),
            lit=len(theirs),
            laser=list(self.find_lines)[fewest] if len(self.find_lines) > 1 else "",
            roll_deg=_turned([pose.roll_deg for pose in poses]),
            placements=len(self._placements),
        )

    def advice(self, kind: Literal["free", "placement"] = "free", most: int = 2) -> list[str]:
        """The most helpful poses, a sentence each, the most needed first; empty if nothing is missing."""
        seen = self.coverage()
        if kind == "placement":
            return _about_placing(seen, laser=bool(self.find_lines))[:most]
        if seen.views == 0:
            line = ", with the laser's line across it" if self.find_lines else ""
            return [f"hold the board still, wholly in the picture{line}"]
        needs = _needs(seen, laser=bool(self.find_lines))
        needs.sort(key=lambda need: -need[0])
        return [sentence for _, sentence in needs[:most]]

    def _cells(self) -> np.ndarray:
        q = np.concatenate([view.q for view in self._views]) if self._views else np.zeros((0, 2))
        return coverage.count_cells(q, self.image_size)


def _needs(seen: Coverage, *, laser: bool) -> list[tuple[float, str]]:
    """What is missing: its urgency, from 0 to 1, and a sentence."""
    needs: list[tuple[float, str]] = []
    if empty := seen.empty_cells:
        missing = float(np.mean(seen.corners < coverage.MIN_IN_CELL))
        needs.append((0.4 + 0.5 * missing, coverage.ASK_FOR_PARTS.format(", ".join(empty[:_NAMED_CELLS]))))
    share = seen.tilted / seen.views
    if share < _GOOD_SHARE:
        most = max(seen.tilts_deg, default=0.0)
        why = f"hardly one is tilted by more than {most:.0f} degrees" if most < coverage.MIN_TILT_DEG else "too few are"
        needs.append((0.9 - share, coverage.ASK_FOR_TILT.format(why)))
    elif seen.tilt_sides < _SIDES_OF_TILT:
        needs.append((0.35, "tilt the board both ways, to the left and right and up and down"))
    elif seen.roll_deg < _GOOD_ROLL_DEG:
        needs.append((0.2, "turn the board in its plane by 90 degrees in a few poses"))
    if seen.depth_m is not None and seen.views > 1 and seen.depth_m[1] < _GOOD_DEPTH_RATIO * seen.depth_m[0]:
        near, far = seen.depth_m
        needs.append((0.6, f"hold the board nearer and farther: all stand at about {near:.2f} to {far:.2f} m"))
    if not laser:
        return needs
    if seen.crossed < max(min(coverage.MIN_STRIPES, seen.lit), _GOOD_SHARE * seen.lit):
        which = f" with the laser {seen.laser}" if seen.laser else ""
        needs.append((0.95, coverage.ASK_FOR_STRIPES.format(f"{seen.crossed} of {seen.lit}{which}")))
    elif seen.stripe_depth_m is not None and seen.crossed >= coverage.MIN_STRIPES:
        near, far = seen.stripe_depth_m
        if far < coverage.MIN_DEPTH_RATIO * near:
            needs.append((0.7, coverage.ASK_FOR_DEPTHS.format(f"about {near:.2f} to {far:.2f} m")))
    return needs


def _about_placing(seen: Coverage, *, laser: bool) -> list[str]:
    line = " and the laser's line across it" if laser else ""
    sentences = [f"stand the board where it will not move while the table turns, in the middle of the picture{line}"]
    if seen.placements:
        sentences = [f"stand it elsewhere than before, nearer or farther, tilted, {sentences[0].split(', ', 1)[1]}"]
    if seen.placements < coverage.MIN_PLACEMENTS:
        sentences.append(coverage.ASK_FOR_PLACEMENTS.format(seen.placements))
    return sentences


def _why_not_found(off: np.ndarray) -> str:
    """The likely reason why no board is found."""
    few = off[::4, ::4]
    if np.percentile(few, 99) < _DARK_DN:
        return "no board found: the picture is dark; switch a light on, or expose longer"
    if np.mean(few >= _CLIPPED_DN) > _CLIPPED_SHARE:
        return "no board found: the picture is too bright; take a light away, or expose shorter"
    return (
        "no board found: it must be in the picture, sharp, lit evenly and tilted by less than 60 degrees; nothing, "
        "no hand either, may cover its squares"
    )


def _range(values: Sequence[float]) -> tuple[float, float] | None:
    return (min(values), max(values)) if values else None


def _turned(rolls_deg: Sequence[float]) -> float:
    """Largest difference of two rolls modulo 180 degrees [deg]."""
    if not rolls_deg:
        return 0.0
    rolls = np.array(rolls_deg)
    apart = np.abs((rolls[:, None] - rolls[None, :] + 90.0) % 180.0 - 90.0)
    return float(apart.max())
