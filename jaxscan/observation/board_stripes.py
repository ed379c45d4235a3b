"""Stripes on the boards of a batch of records."""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import NamedTuple, cast

import numpy as np

from jaxscan.errors import CaptureError
from jaxscan.geometry import AbstractBoard, across_and_along
from jaxscan.observation.board_lines import Candidates, find_lines
from jaxscan.observation.board_map import BoardMap, FoundCorners, is_on_print
from jaxscan.observation.prediction import SolvedRig, lift_to_board, predict_stripe
from jaxscan.observation.printed import Sight, fit_on_print
from jaxscan.observation.records import BoardSource, SeenRecord
from jaxscan.observation.stripes_on_board import BoardStripe, select_board_stripe
from jaxscan.stripes import (
    ChunkStripes,
    ExtractionSetup,
    FrameFormat,
    FrameStripes,
    LaserLine,
    NoiseModel,
    StripeSettings,
    clear_level,
    decode_table,
    finest_steps,
    join_levels,
    learn_noise,
    level_exposures,
    predict_off,
    prepare_engines,
    with_colour,
)


LearnedFrames = dict[tuple[int, int, bool], tuple[NoiseModel, tuple[str, ...]]]
"""For each capture and laser, and for records with and without a laser-off frame: the noise of a frame, and signs that
its codes are not levels of a sensor, a sentence each."""
BATCH_RECORDS = 8
"""Records per batch: enough for all cores, and small in memory."""
_COLOUR_RECORDS = 8
"""Records from which the colour of a laser is learned where the header has "auto"."""
# Half width of the band around the predicted stripe [px]; it must hold the tails of the profile.
_BAND_PX = 24.0
# Samples to either side of a stripe, and lines, whose print is even: its scatter beyond noise, over its level [1].
_ASIDE, _ALONG, _EVEN = 5, 2, 0.05
# The shift by the board's ink is predicted and corrected afterwards. So sigma must be of noise alone,
# and every line is fitted by itself.
_SETTINGS = StripeSettings(guard_edges=False, learn_width=False)


def learn_colours(capture: BoardSource) -> tuple[LaserLine, ...]:
    """The lasers of a capture of a board; where a colour is "auto" it is learned from a few pairs.

    Raises:
        CaptureError: If a colour cannot be learned.
    """
    return tuple(_learn_colour(capture, laser) for laser in range(len(capture.lasers)))


def find_stripes(
    views: list[SeenRecord],
    capture: BoardSource,
    lines: tuple[LaserLine, ...],
    board: AbstractBoard,
    learned: LearnedFrames,
    rig: SolvedRig | None = None,
) -> list[SeenRecord]:
    """Find the stripes on the boards of one batch of records.

    Args:
        views: At most BATCH_RECORDS records of one capture, with frames and corners.
        lines: Its lasers, their colours learned.
        learned: What is known of its frames; completed by what these tell where nothing is.
        rig: Result of a first solve: stripes are then looked for near their predictions only, where its
            sheet is believed, and the poses of the records decide which points lie on the print.
    """
    views = list(views)
    lit = [i for i, view in enumerate(views) if view.corners is not None and view.on is not None]
    for laser, line in enumerate(lines):
        if rig is not None and line.name not in rig.laser_names:
            continue  # The first solve has no sheet of it, so it predicts nothing.
        for with_off in (True, False):
            group = [i for i in lit if views[i].laser == laser and (views[i].off is not None) == with_off]
            if not group:
                continue
            seen = [views[i] for i in group]
            frames = _Frames.of(seen, capture, line)
            key = seen[0].capture, laser, with_off
            if key not in learned:
                # From whole frames: outside the band there would be no noise.
                learned[key] = frames.learn(line, compressed=capture.compression is not None or not with_off)
            stripes, sights = _extract(seen, frames, line, learned[key][0], rig)
            found = [Candidates.of(stripes, row, line.stripe_axis) for row in range(len(group))]
            with ThreadPoolExecutor(os.cpu_count()) as pool:
                on_boards = list(pool.map(lambda *one: _lines_of(board, rig, *one), seen, found, sights))
            for i, lines_found in zip(group, on_boards, strict=True):
                views[i] = views[i]._replace(stripes=lines_found)
    return views


def with_speckle(
    on: np.ndarray, off: np.ndarray, frames: FrameFormat, line: LaserLine, noise: NoiseModel
) -> NoiseModel:
    """The noise with speckle as stripes on even print show it: edges of the print would widen the scatter."""
    size = int(on.shape[2]), int(on.shape[1])
    setup = ExtractionSetup(size, frames, line, _SETTINGS, all_candidates=True, faint=False)
    (engine,) = prepare_engines(on, off, [setup], noise=noise)
    engine = engine.own_channel()
    dark = np.asarray(engine.setup.plane(off))
    sites, levels = engine.setup.sites, decode_table(frames.response)[0]

    def on_even_print(stripes: FrameStripes) -> np.ndarray:
        u = np.asarray(stripes.u)[:, sites.first_line :: sites.line_step]
        row = np.arange(u.shape[1])
        offset = np.asarray(sites.offsets)[row % len(sites.offsets)]
        sample = np.rint((u - offset) / sites.pitch).astype(int)[..., None, None] + np.arange(-_ASIDE, _ASIDE + 1)
        beside = row[:, None, None] + np.arange(-_ALONG, _ALONG + 1)[:, None]
        frame = np.arange(len(u))[:, None, None, None]
        at = frame, np.clip(beside, 0, dark.shape[1] - 1), np.clip(sample, 0, dark.shape[2] - 1)
        level = levels[dark[at]]
        mean = level.mean((2, 3))
        even = np.zeros(np.shape(stripes.u), bool)
        scatter = noise.variance(mean) + (_EVEN * np.maximum(mean - noise.black_dn, 0.0)) ** 2
        even[:, sites.first_line :: sites.line_step] = level.var((2, 3)) < 1.5 * scatter
        return even

    return replace(noise, speckle=engine.learn(on, off, BATCH_RECORDS, on_even_print).noise.speckle)


def _lines_of(
    board: AbstractBoard, rig: SolvedRig | None, view: SeenRecord, found: Candidates, sight: Sight | None
) -> tuple[BoardStripe, ...]:
    """The lines on one board that may be the stripe, the likeliest first."""
    off, corners = None if view.off is None else view.grey, cast(FoundCorners, view.corners)
    known, q = BoardMap.of(corners, board), found.pixels()
    usable, pixels = found.valid, q.reshape(-1, 2)
    if rig is not None and view.pose is not None:
        xy = lift_to_board(rig, view.pose, pixels).reshape(q.shape)
    else:
        xy = known.to_board(pixels).reshape(q.shape)
        usable = usable & known.is_near(xy)
    usable = usable & is_on_print(xy, board)
    stripes = []
    for number in find_lines(found, xy, usable, known, print_shows=view.off is None):
        at = np.maximum(number, 0).astype(np.intp), np.arange(len(number))
        stripe, ink = found.taken(number), off
        if rig is not None and view.pose is not None and off is not None and sight is not None:
            through = fit_on_print(stripe, is_on_print(xy[at], board), sight, rig, view.pose)
            if through is not None:
                stripe, ink = through, None
        stripes.append(select_board_stripe(stripe, corners, board, off=ink, board_xy=xy[at]))
    return tuple(stripe for stripe in stripes if stripe.valid.any())


def _learn_colour(capture: BoardSource, laser: int) -> LaserLine:
    line = capture.lasers[laser]
    lit = [i for i, record in enumerate(capture.records) if record.lasers == (laser,) and record.on]
    if line.colour != "auto" or not lit:
        return line
    # Pairs are preferred.
    lit = [i for i in lit if capture.records[i].off] or lit
    chosen = np.unique(np.linspace(0, len(lit) - 1, _COLOUR_RECORDS).astype(int))
    on, off = zip(*(capture.frames(lit[i]) for i in chosen), strict=True)
    # Levels of one frame serve like so many frames.
    put = np.concatenate if capture.bits > 8 else np.stack
    try:
        return with_colour(line, put(on), None if off[0] is None else put(off), capture.pixel_format)
    except ValueError as problem:
        raise CaptureError(
            f'{capture.path}: the colour of the laser "{line.name}" is "auto" and cannot be learned: {problem}'
        ) from problem


class _Frames(NamedTuple):
    """Frames of some records, laser on and off. All have a laser-off frame, or none has and it is predicted."""

    on: np.ndarray
    """uint8 [records, rows, columns(, 3)]; of more than 8 bits [records, levels, rows, columns(, 3)]."""
    off: np.ndarray
    kind: FrameFormat
    bits: int
    size: tuple[int, int]
    """Width and height [px]."""

    @staticmethod
    def of(views: list[SeenRecord], capture: BoardSource, line: LaserLine) -> "_Frames":
        on = np.stack([view.on for view in views if view.on is not None])
        dark = [view.off for view in views if view.off is not None]
        if dark:
            off = np.stack(dark)
        elif capture.bits > 8:
            off = np.stack([predict_off(on[:, k], capture.pixel_format, line) for k in range(on.shape[1])], 1)
        else:
            off = predict_off(on, capture.pixel_format, line)
        kind = FrameFormat(capture.pixel_format, capture.response)
        return _Frames(on, off, kind, capture.bits, capture.image_size)

    @property
    def exposures(self) -> tuple[float, ...]:
        """Relative exposures of the levels, 1 for the first."""
        levels = level_exposures(self.bits)
        return tuple(one / levels[0] for one in levels)

    @property
    def clearest(self) -> int | None:
        """The finest level that most of the picture does not clip; None of 8 bits."""
        return clear_level(self.off) if self.bits > 8 else None

    def level(self, number: int | None) -> tuple[np.ndarray, np.ndarray]:
        """One level of all frames, laser on and off."""
        return (self.on, self.off) if number is None else (self.on[:, number], self.off[:, number])

    def learn(self, line: LaserLine, *, compressed: bool) -> tuple[NoiseModel, tuple[str, ...]]:
        """The noise of a frame in steps of 8 bits, and doubts about it."""
        clear = self.clearest
        noise, _, doubts, _ = learn_noise(*self.level(clear), frames=self.kind, line=line, compressed=compressed)
        if not compressed:
            noise = with_speckle(*self.level(clear), self.kind, line, noise)
        return noise if clear is None else noise.in_finer_steps(1.0 / self.exposures[clear]), doubts


def _extract(
    views: list[SeenRecord], seen: _Frames, line: LaserLine, noise: NoiseModel, rig: SolvedRig | None
) -> tuple[ChunkStripes, Sequence[Sight | None]]:
    """Stripes of one laser, and its samples where the print is known."""
    on, deep = seen.on, seen.bits > 8
    if rig is not None and line.name in rig.believed:
        near = np.stack([_band(view, rig, line) for view in views])
        near = near[:, None] if deep else near
        on = np.where(near if on.ndim == near.ndim else near[..., None], on, seen.off)
    setup = ExtractionSetup(
        seen.size, seen.kind, line, _SETTINGS, seen.exposures, 0 if deep else None, all_candidates=True, faint=False
    )
    (engine,) = prepare_engines(on, seen.off, [setup], noise=noise)
    stripes = engine.extract_shared(on, seen.off, BATCH_RECORDS)
    if rig is None or rig.picture is None or views[0].off is None:
        return stripes, [None] * len(views)
    clear = seen.clearest
    clearest = engine if not clear else engine.channels[clear - 1]
    ratios = clearest.lamp_ratios(*(np.asarray(engine.setup.plane(part)) for part in seen.level(clear))).tolist()
    on, off, steps = seen.on, seen.off, 1
    if deep:
        # The print is fitted at once to all that the levels hold, in their finest steps.
        steps = finest_steps(seen.bits)
        on, off = (np.stack([join_levels(one, seen.bits) for one in part]) for part in (on, off))
    planes = [np.asarray(engine.setup.plane(part)) for part in (on, off)]
    return stripes, [
        Sight(lit, dark, ratio, engine.setup.sites, seen.kind, line, noise.in_finer_steps(float(steps)), steps)
        for lit, dark, ratio in zip(*planes, ratios, strict=True)
    ]


def _band(view: SeenRecord, rig: SolvedRig, line: LaserLine) -> np.ndarray:
    """Pixels near the predicted stripe, bool [rows, columns]; all where the pose is unknown."""
    camera = rig.camera
    if view.pose is None:
        return np.ones((camera.height, camera.width), bool)
    stripe = predict_stripe(rig, view.pose, rig.laser_names.index(line.name), line.stripe_axis)
    samples = np.arange(across_and_along(camera.width, camera.height, line.stripe_axis)[0])
    near = stripe.on_board[:, None] & (np.abs(samples - stripe.u[:, None]) <= _BAND_PX)
    return near if line.stripe_axis == "rows" else near.T
