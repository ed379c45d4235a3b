"""Why a board was not found: images of known faults, drawn in NumPy."""

import numpy as np
import pytest

from jaxscan.observation.missed import MissedRecord, count_reasons, measure_light, missed_records


SIZE = (480, 640)


def board(*, left=60, side=50):
    """A chessboard of 10 x 7 squares, `left` px from the left edge, on a grey ground."""
    rows, columns = np.indices(SIZE)
    i, j = (rows - 60) // side, (columns - left) // side
    inside = (i >= 0) & (i < 7) & (j >= 0) & (j < 10)
    return np.where(inside, np.where((i + j) % 2, 200.0, 30.0), 150.0)


def blurred(image, times):
    for _ in range(times):
        for axis in (0, 1):
            image = (np.roll(image, 1, axis) + 2 * image + np.roll(image, -1, axis)) / 4
    return image


def as_image(image, seed=0):
    """With noise of 1 DN."""
    return np.clip(np.rint(image + np.random.default_rng(seed).normal(size=image.shape)), 0, 255).astype(np.uint8)


@pytest.mark.parametrize(
    ("image", "why"),
    [
        (0.2 * blurred(board(), 2), "too dark"),
        (3.0 * blurred(board(), 2), "too bright"),
        (blurred(board(), 200), "blurred"),
        (blurred(board(left=-250), 2), "no whole board of this kind in the picture"),
        (None, "no image to look at"),
    ],
)
def test_the_likely_reason_is_named(image, why):
    good = measure_light(as_image(blurred(board(), 2)))
    light = None if image is None else measure_light(as_image(image))
    seen = [(3, True, good), (4, False, light), (5, True, good)]
    assert missed_records(seen) == (MissedRecord(4, why),)


def test_reasons_are_counted():
    found = [MissedRecord(1, "blurred"), MissedRecord(2, "too dark"), MissedRecord(3, "too dark")]
    assert count_reasons(found) == "2 too dark, 1 blurred"
