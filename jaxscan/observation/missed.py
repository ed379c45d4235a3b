"""Records in which the board was not found, and the likely reason: cheap statistics of their images."""

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Real


# Brightest level of an image that is too dark [DN]; share of clipped pixels of one that is too bright [1].
_DARK_DN = 60
_CLIPPED_DN, _MANY_CLIPPED = 250, 0.3
# Sharpness of a blurred image, over that of the images in which the board was found [1].
_BLURRED = 0.5
# Share of the board's corners, at least, that look like crossings of squares where a part of it is in the image.
_SOME_SQUARES = 0.25
# A crossing's curvature over the square of the image's contrast; reach of its stencil and of its rivals [px], in an
# image of about this many pixels.
_CROSSING, _STENCIL, _RIVALS, _WIDTH = 0.3, 3, 5, 800
# Less contrast than this is noise.
_LEAST_CONTRAST_DN = 20.0


class Light(NamedTuple):
    """How an image is exposed and focused."""

    brightest: float
    """Level that one of a hundred pixels exceeds [DN]."""
    clipped: float
    """Share of clipped pixels [1]."""
    sharpness: float
    """Steepest steps between neighbours, over the contrast [1]."""
    crossings: int = 0
    """Places that look like crossings of squares; counted where the board was not found."""


class MissedRecord(NamedTuple):
    """A record in which the board was not found."""

    record: int
    why: str


def measure_light(grey: Real[np.ndarray, "rows columns"], *, crossings: bool) -> Light:
    """The light of one image [DN of 8 bits]; with `crossings` its crossings of squares are counted."""
    some = grey[::4]
    low, high = np.percentile(some[:, ::4], (1, 99))
    steps = np.abs(np.diff(some.astype(np.float32), axis=1))
    sharpness = float(np.percentile(steps, 99.5)) / max(float(high - low), 1.0)
    count = count_crossings(grey) if crossings else 0
    return Light(float(high), float(np.mean(some >= _CLIPPED_DN)), sharpness, count)


def count_crossings(grey: Real[np.ndarray, "rows columns"]) -> int:
    """Places where the image is a saddle as steep as black and white squares that meet.

    Source: the determinant of the Hessian, as in corner detectors for chessboards.
    """
    step = max(1, round(max(grey.shape) / _WIDTH))
    rows, columns = (size // step for size in grey.shape)
    if min(rows, columns) < 8 * _RIVALS:
        return 0
    image = grey[: rows * step, : columns * step].reshape(rows, step, columns, step).mean((1, 3))
    for _ in range(4):
        for axis in (0, 1):
            image = (np.roll(image, 1, axis) + 2.0 * image + np.roll(image, -1, axis)) / 4.0
    shifted = lambda down, right: np.roll(image, (down * _STENCIL, right * _STENCIL), (0, 1))
    across = shifted(0, 1) + shifted(0, -1) - 2.0 * image
    along = shifted(1, 0) + shifted(-1, 0) - 2.0 * image
    mixed = (shifted(1, 1) + shifted(-1, -1) - shifted(1, -1) - shifted(-1, 1)) / 2.0
    saddle = mixed**2 - across * along
    highest = saddle
    for axis in (0, 1):
        highest = np.max([np.roll(highest, by, axis) for by in range(-_RIVALS, _RIVALS + 1)], axis=0)
    low, high = np.percentile(image, (2, 98))
    inner = slice(_RIVALS + _STENCIL, -_RIVALS - _STENCIL)
    found = (saddle == highest) & (saddle > _CROSSING * max(high - low, _LEAST_CONTRAST_DN) ** 2)
    return int(np.count_nonzero(found[inner, inner]))


def missed_records(seen: Sequence[tuple[int, bool, Light | None]], corners: int) -> tuple[MissedRecord, ...]:
    """The records without the board, each with the likely reason.

    Args:
        seen: Of every record its number, whether the board was found, and its light; None where it has no image.
    """
    sharp = [light.sharpness for _, found, light in seen if found and light is not None]
    usual = float(np.median(sharp)) if sharp else 0.0
    return tuple(MissedRecord(record, _reason(light, usual, corners)) for record, found, light in seen if not found)


def count_reasons(missed: Sequence[MissedRecord]) -> str:
    """The reasons, the commonest first: "12 too dark, 3 blurred"."""
    counts = Counter(record.why for record in missed).most_common()
    return ", ".join(f"{count} {why}" for why, count in counts)


def _reason(light: Light | None, sharpness: float, corners: int) -> str:
    if light is None:
        return "no image to look at"
    if light.brightest < _DARK_DN:
        return "too dark"
    if light.clipped > _MANY_CLIPPED:
        return "too bright"
    if light.sharpness < _BLURRED * sharpness:
        return "blurred"
    if light.crossings >= _SOME_SQUARES * corners:
        return "a part of the board, or a board of another size"
    return "no board in the picture"
