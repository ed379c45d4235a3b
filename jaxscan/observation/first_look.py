"""The first look at captures of a board: corners and stripes in every record."""

import os
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np

from jaxscan.errors import CalibrationError
from jaxscan.geometry import AbstractBoard
from jaxscan.observation.board_map import FoundCorners
from jaxscan.observation.board_stripes import BATCH_RECORDS, LearnedFrames, find_stripes, learn_colours
from jaxscan.observation.missed import MissedRecord, count_reasons, measure_light, missed_records
from jaxscan.observation.observations import BoardViews, Observations, StripeViews
from jaxscan.observation.prediction import PredictedCorners, SolvedRig, predict_stripe
from jaxscan.observation.records import BoardSource, SeenRecord, ToGrey
from jaxscan.observation.stripes_on_board import MOST_POINTS, BoardStripe
from jaxscan.stripes import LaserLine, level_exposures


# Frames of up to so many bytes are kept for the second look; those of larger captures are read again.
_KEPT_BYTES = 2**28
# Records in which another board is looked for where the expected one is in none.
_LOOKED_AT = 6
# Records that show the same other board suffice.
_AGREE = 2
# Number of boards with the line in the laser-off image, and ratio of its points to those of the laser-on images, that
# prove an exchange.
_EXCHANGED, _TIMES = 3, 3
# Rows of the image on which a line should be seen on a board before it is missed.
_LEAST_ROWS = 24

Progress = Callable[[int, int], None]
FindCorners = Callable[[np.ndarray, AbstractBoard], FoundCorners | None]
"""Finds the corners of a board in a grey image, uint8, or float32 of more than 8 bits; None where it is not found."""

RefitCorners = Callable[[np.ndarray, AbstractBoard, PredictedCorners, float, FoundCorners | None], FoundCorners | None]
"""Fits the corners of a board in a grey image at predicted places, within a reach [px]; those of the first look are
kept where the fit fails. None where too few are found."""

DrawPrint = Callable[[AbstractBoard], np.ndarray]
"""The print of a board as a picture, see `BoardPicture.of`."""


class Eyes(NamedTuple):
    """The functions that read images; `vision` has them, by OpenCV."""

    to_grey: ToGrey
    find_corners: FindCorners
    refit_corners: RefitCorners
    draw_print: DrawPrint | None = None
    """Without it stripes on boards are fitted without their print."""
    name_other: Callable[[np.ndarray, AbstractBoard], str | None] = lambda image, board: None
    """Names the board that an image shows in place of the expected one, where it can be told."""


class Look(NamedTuple):
    """All records of some captures, in order, with the board and the stripes that were seen in them."""

    board: AbstractBoard
    records: list[SeenRecord]
    lines: tuple[tuple[LaserLine, ...], ...] | None
    """The lasers of each capture, their colours learned; None where stripes were not looked for."""
    learned: LearnedFrames
    """What their frames have told."""

    def missed(self) -> tuple[MissedRecord, ...]:
        """The records in which the board was not found, with the likely reasons."""
        seen = [(view.record.i, view.corners is not None, view.light) for view in self.records]
        return missed_records(seen)

    def without_a_line(self, rig: SolvedRig) -> tuple[list[int], int]:
        """Numbers of the records that show no line on their boards though the sheet of their laser meets these, and how
        many it meets.

        Args:
            rig: Solved from these records.
        """
        views = [view for view in self.records if view.corners is not None]
        missed, met = list[int](), 0
        for view, pose, used in zip(views, rig.poses, rig.used, strict=True):
            if self.lines is None or not used or not view.record.lasers or not view.record.on:
                continue
            line = self.lines[view.capture][view.laser]
            if line.name not in rig.laser_names:
                continue
            stripe = predict_stripe(rig, pose, rig.laser_names.index(line.name), line.stripe_axis)
            across = rig.camera.width if line.stripe_axis == "rows" else rig.camera.height
            inside = stripe.on_board & (stripe.u >= 0.0) & (stripe.u <= across - 1.0)
            if np.count_nonzero(inside) >= _LEAST_ROWS:
                met += 1
                missed += [] if view.stripes else [view.record.i]
        return missed, met

    def doubts(self, captures: Sequence[BoardSource]) -> tuple[str, ...]:
        """Signs that codes are no levels of a sensor, a sentence each; of each capture those of its first laser that
        has some.
        """
        first: dict[int, tuple[str, ...]] = {}
        for (number, _, _), (_, doubts) in sorted(self.learned.items(), key=lambda item: item[0]):
            if doubts:
                first.setdefault(number, doubts)
        return tuple(f"{captures[number].path}: {doubt}" for number, doubts in first.items() for doubt in doubts)


def look_at_boards(
    captures: Sequence[BoardSource],
    board: AbstractBoard,
    eyes: Eyes,
    *,
    with_stripes: bool = True,
    progress: Progress | None = None,
) -> Look:
    """Find the board in every record, and the stripe on it.

    Args:
        captures: Captures of the same board by the same rig, with one laser lit in a record.
        with_stripes: Look for stripes too; they are not needed for a camera alone.

    Returns:
        Every record; those without the board have no corners.

    Raises:
        CaptureError: If the colour of a laser cannot be learned, or a frame cannot be read.
        CalibrationError: If the board is found in no record, or if laser on and laser off are exchanged.
    """
    lines = tuple(learn_colours(capture) for capture in captures) if with_stripes else None

    def look(number: int, index: int) -> SeenRecord:
        view = SeenRecord.read(captures, number, index, eyes.to_grey)
        if view.grey is None:
            return view
        corners = eyes.find_corners(view.grey, board)
        return view._replace(corners=corners, light=measure_light(view.grey))

    keep = sum(map(_bytes_of, captures)) <= _KEPT_BYTES
    seen = go_through(captures, look, Look(board, [], lines, {}), keep=keep, progress=progress)
    if all(view.corners is None for view in seen.records):
        raise CalibrationError(_not_found(captures, seen, eyes))
    if lines is not None:
        _refuse_exchanged(captures, seen, lines, eyes.to_grey)
    return seen


def _bytes_of(capture: BoardSource) -> int:
    """Bytes of all frames of a capture, decoded."""
    frame = int(np.prod(capture.image_size)) * (3 if capture.pixel_format == "rgb8" else 1)
    return 2 * len(capture.records) * frame * len(level_exposures(capture.bits))


def _refuse_exchanged(
    captures: Sequence[BoardSource], seen: Look, lines: Sequence[tuple[LaserLine, ...]], to_grey: ToGrey
) -> None:
    """Refuse captures whose laser-off images show the laser.

    It is looked for there only where most boards with both images have no line.

    Args:
        seen: All their records, with corners and stripes.
        lines: The lasers of each capture, their colours learned.

    Raises:
        CalibrationError: With the first capture in which laser on and laser off are exchanged.
    """
    for number, capture in enumerate(captures):
        pairs = [
            (index, view)
            for index, view in enumerate(one for one in seen.records if one.capture == number)
            if view.corners is not None and view.record.on and view.record.off
        ]
        dark = [(index, view) for index, view in pairs if not view.stripes]
        if 2 * len(dark) <= len(pairs):
            continue
        views = []
        for index, view in dark[:BATCH_RECORDS]:
            read = SeenRecord.read(captures, number, index, to_grey)
            views.append(read._replace(on=read.off, off=read.on, corners=view.corners))
        found = find_stripes(views, capture, lines[number], seen.board, {})
        some = sum(bool(view.stripes) for view in found)
        if some >= _EXCHANGED and _points(found) > _TIMES * _points([view for _, view in pairs]):
            raise CalibrationError(
                f"{capture.path}: laser on and laser off are exchanged: {some} of {len(found)} boards have the line in "
                f"the laser-off image, and {len(pairs) - len(dark)} of all {len(pairs)} in the laser-on image."
            )


def _points(views: Sequence[SeenRecord]) -> int:
    """Points of the likeliest line of each board."""
    return sum(int(view.stripes[0].valid.sum()) for view in views if view.stripes)


def _not_found(captures: Sequence[BoardSource], seen: Look, eyes: Eyes) -> str:
    """Why no record shows the board."""
    found = (
        f"The board ({seen.board.describe()}) was found in none of {len(seen.records)} records "
        f"({count_reasons(seen.missed())})"
    )
    places = [(number, index) for number, capture in enumerate(captures) for index in range(len(capture.records))]
    some = [places[k] for k in np.unique(np.linspace(0, len(places) - 1, _LOOKED_AT).round().astype(int))]
    views = (SeenRecord.read(captures, number, index, eyes.to_grey) for number, index in some)
    others: list[tuple[str, int]] = []
    names: Counter[str] = Counter()
    for view in views:
        name = None if view.grey is None else eyes.name_other(view.grey, seen.board)
        names.update([] if name is None else [name])
        others = names.most_common(1)
        # Looking for markers of all kinds takes seconds.
        if others and others[0][1] >= _AGREE:
            break
    if others:
        return f"{found}; the images show {others[0][0]}: correct the [board] table of capture.toml."
    return (
        f"{found}: check the [board] table of capture.toml (columns and rows count inner corners for a chessboard, "
        "squares for ChArUco, circles, or tags; circles have a layout too), and that the board is sharp, well lit and "
        "wholly in the image."
    )


def go_through(
    captures: Sequence[BoardSource],
    look: Callable[[int, int], SeenRecord],
    like: Look,
    *,
    rig: SolvedRig | None = None,
    keep: bool = False,
    progress: Progress | None = None,
) -> Look:
    """All records: `look` at each (capture, index) in threads, then the stripes of a batch of one capture together.

    Args:
        look: Reads a record and finds its corners.
        like: The board, the lasers whose stripes are looked for, and what is known of their frames; its records are
            not used.
        rig: As in `find_stripes`.
        keep: Keep the frames for another look; otherwise they are dropped at once.
    """
    total = sum(len(capture.records) for capture in captures)
    views: list[SeenRecord] = []
    batches = [
        [(number, index) for index in range(start, min(start + BATCH_RECORDS, len(capture.records)))]
        for number, capture in enumerate(captures)
        for start in range(0, len(capture.records), BATCH_RECORDS)
    ]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        try:
            # One batch ahead: boards are looked for while the stripes of the batch before are, or their code compiles.
            coming = [pool.submit(look, *one) for one in batches[0]] if batches else []
            for batch, following in zip(batches, [*batches[1:], []], strict=False):
                seen = [one.result() for one in coming]
                coming = [pool.submit(look, *one) for one in following]
                number = batch[0][0]
                if like.lines is not None:
                    seen = find_stripes(seen, captures[number], like.lines[number], like.board, like.learned, rig)
                views += seen if keep else [view._replace(on=None, off=None, grey=None) for view in seen]
                if progress is not None:
                    progress(len(views), total)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return like._replace(records=views)


def to_observations(captures: Sequence[BoardSource], look: Look) -> Observations:
    """The observations of the records in which the board was found."""
    first = captures[0]
    views = [view for view in look.records if view.corners is not None]
    q, sigma, valid = map(np.stack, zip(*(view.corners for view in views if view.corners is not None), strict=True))
    keys = [view.placement or f"alone {index}" for index, view in enumerate(views)]
    number = {key: index for index, key in enumerate(dict.fromkeys(keys))}
    lines = [[(stripe, index, view.laser) for stripe in view.stripes] for index, view in enumerate(views)]
    others = [line for found in lines for line in found[1:]]
    width, height = first.image_size
    # Where poses are given, the angle of a view is the place of its record among those of all captures.
    start = np.cumsum([0, *(0 if one.poses is None else len(one.poses) for one in captures)])
    return Observations(
        board=look.board,
        corners=BoardViews(
            q=q,
            sigma=sigma,
            valid=valid,
            angle=np.array([(view.record.angle or 0.0) + start[view.capture] for view in views]),
            placement=np.array([number[key] for key in keys], np.int32),
            # 64 bits: a journal of another program may count milliseconds.
            record=np.array([view.record.i for view in views], np.int64),
        ),
        stripes=stack_stripes([found[0] for found in lines if found]),
        width=width,
        height=height,
        laser_names=tuple(line.name for line in first.lasers),
        up=first.up,
        carries=first.carries or "scanner",
        poses=None if first.poses is None else np.concatenate([one.poses for one in captures]),
        other_lines=stack_stripes(others) if others else None,
    )


def stack_stripes(stripes: Sequence[tuple[BoardStripe, int, int]], points: int = MOST_POINTS) -> StripeViews:
    """All stripes of a capture, given as (stripe, row of `BoardViews`, laser); empty ones are left out."""
    kept = [(stripe, view, laser) for stripe, view, laser in stripes if stripe.valid.any()]
    q, sigma, valid = np.zeros((0, points, 2)), np.zeros((0, points)), np.zeros((0, points), bool)
    contrast = np.zeros((0, points), np.int8)
    if kept:
        q, sigma, valid, contrast = map(np.stack, zip(*(stripe for stripe, _, _ in kept), strict=True))
    view, laser = (np.array([entry[k] for entry in kept], np.int32) for k in (1, 2))
    return StripeViews(q, sigma, valid, view, laser, contrast)
