"""Several images for one frame: averaged where they repeat an exposure, a bracket where they do not."""

import json
import re
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxscan.errors import CaptureError
from jaxscan.files.capture import MAX_IMAGES, ImageRef, open_capture
from jaxscan.files.capture.images import average
from jaxscan.files.capture.journal import parse_images
from jaxscan.files.recording import create_capture, resume_capture

from .conftest import BOARD, FRAMES, LASER, header


def shots(start, *exposures):
    return [(FRAMES[start + k], exposure) for k, exposure in enumerate(exposures)]


def listed(*exposures, file="on/000000.png"):
    return [{"file": file, "exposure_s": exposure} for exposure in exposures]


@given(st.lists(st.integers(0, 255), min_size=2, max_size=MAX_IMAGES))
def test_the_mean_is_rounded_to_the_nearest_and_halves_to_even(levels):
    target = np.empty((2, 3), np.uint8)
    images = [ImageRef(str(level), exposure_s=0.1) for level in levels]
    average(images, target, lambda one, out: np.full((2, 3), int(one.path), np.uint8))
    # Python's own rounding of exact fractions.
    assert (target == round(Fraction(sum(levels), len(levels)))).all()


@pytest.mark.parametrize("storage", ["zstd", "png", "npy"])
def test_repetitions_are_averaged(tmp_path, storage):
    with create_capture(tmp_path / "room", header(), storage=storage) as capture:
        for k in range(5):
            capture.append(angle_deg=0.1 * k, on=shots(8 * k, *[0.01] * 4), off=shots(8 * k + 4, *[0.01] * 4))
    read = open_capture(tmp_path / "room")
    assert read.exposures == (0.01,)
    expected = np.rint(FRAMES[:40].reshape(5, 2, 4, 4, 6).mean(2))
    chunks = list(read.chunks(3))
    assert chunks[0].on.shape == (3, 4, 6)
    assert np.array_equal(np.concatenate([chunk.on for chunk in chunks]), expected[:, 0])
    assert np.array_equal(np.concatenate([chunk.off for chunk in chunks]), expected[:, 1])
    assert np.array_equal(read.frames(4)[1], expected[4, 1])


@pytest.mark.parametrize("storage", ["zstd", "png", "npy"])
def test_brackets_come_with_their_exposures_ascending(tmp_path, storage):
    with create_capture(tmp_path / "room", header(), storage=storage) as capture:
        for k in range(6):
            capture.append(
                angle_deg=0.1 * k, on=shots(6 * k, 0.02, 0.005, 0.08), off=shots(6 * k + 3, 0.005, 0.02, 0.08)
            )
    read = open_capture(tmp_path / "room")
    assert read.exposures == (0.005, 0.02, 0.08)
    on = FRAMES[:36].reshape(6, 6, 4, 6)[:, [1, 0, 2]]
    off = FRAMES[:36].reshape(6, 6, 4, 6)[:, 3:]
    (chunk,) = read.chunks(6)
    assert chunk.on.shape == (6, 3, 4, 6) and np.array_equal(chunk.on, on) and np.array_equal(chunk.off, off)
    # Only frames that already lie in the order in which they are given need no copy.
    assert chunk.on.flags.writeable and chunk.off.flags.writeable == (storage != "npy")
    assert np.array_equal(np.concatenate([part.off for part in read.chunks(4)]), off)
    assert np.array_equal(read.frames(2)[0], on[2])


def test_all_records_need_the_same_exposures(folder):
    folder.record(0, on=listed(0.1, 0.2), off=listed(0.2, 0.1))
    folder.record(1, on=listed(0.1, 0.2), off=listed(0.1, 0.2, 0.2))
    assert open_capture(folder.path).exposures == (0.1, 0.2)
    folder.record(2, on=listed(0.1, 0.3), off=listed(0.1, 0.3))
    folder.refused("record 2: on: found 100, 300 ms", "began with 100, 200 ms")
    folder.record(2, on=listed(0.1, 0.2), off=listed(0.1))
    folder.refused("record 2: off: found 100 ms")
    folder.record(2, on=listed(0.1, 0.2))
    folder.refused("record 2: off: found one image without exposure")


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ([], "found a list of 0 images, expected 1 to 16"),
        (listed(*[0.1] * 17), "found a list of 17 images, expected 1 to 16"),
        ([listed(0.1)], "in a list, expected"),
        (listed(0), "exposure_s: found 0, expected a number of seconds above 0"),
        (listed("1"), "exposure_s: found '1'"),
        (listed(True), "exposure_s: found True"),
        (listed(float("nan")), "exposure_s: found nan"),
        (listed(10**400), "exposure_s: found 1000"),
        (listed(0.1, file=None), "found None, expected a path"),
        (listed(0.1, file="../on.png"), '".."'),
        ({"file": "on/000000.png", "exposure_s": 0.1}, "expected a path, null, or a list"),
    ],
)
def test_lists_that_are_refused(value, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        parse_images(value)


def test_a_calibration_averages_and_refuses_brackets(folder):
    folder.header(kind="calibration", rest=LASER + BOARD)
    folder.record(0, on=listed(0.1, 0.1, file="on/missing.png"))
    folder.refused("record 0: on/missing.png: no such file")
    first, _ = folder.record(0)
    second, _ = folder.record(1)
    both = [{"file": f"on/{k:06d}.png", "exposure_s": 0.1, "gain": 3} for k in range(2)]
    folder.record(2, on=both, off=None)
    folder.record(3, on=listed(0.1), off=listed(0.2))
    capture = open_capture(folder.path)
    assert np.array_equal(capture.frames(2)[0], np.rint((first.astype(float) + second) / 2))
    assert np.array_equal(capture.frames(0)[0], first)
    with pytest.raises(CaptureError, match="record 3: found a bracket of 2 exposures; a calibration reads"):
        capture.frames(3)


def test_the_writer_refuses_what_no_reader_takes(tmp_path):
    with create_capture(tmp_path / "room", header()) as capture:
        capture.append(angle_deg=0.0, on=shots(0, 0.1, 0.2), off=shots(2, 0.2, 0.1))
        for keys, message in (
            ({"on": []}, "list of 0 images"),
            ({"on": shots(0, *[0.1] * 17)}, "list of 17 images"),
            ({"on": shots(0, 0.1, -0.2)}, "exposures"),
            ({"on": shots(0, 0.1, float("nan"))}, "exposures"),
            ({"on": [(FRAMES[0].T, 0.1), (FRAMES[0], 0.2)]}, r"on: found uint8 with shape \(6, 4\)"),
            ({"on": FRAMES[0]}, "all frames of a sweep need the same"),
            ({"on": shots(0, 0.1, 0.2), "off": FRAMES[0]}, "all frames of a sweep need the same"),
            ({"on": shots(0, 0.1, 0.3)}, "all frames of a sweep need the same"),
        ):
            with pytest.raises(CaptureError, match=message):
                capture.append(angle_deg=1.0, **keys)
    with resume_capture(tmp_path / "room") as capture:
        with pytest.raises(CaptureError, match="all frames of a sweep need the same"):
            capture.append(angle_deg=1.0, on=FRAMES[0])
        capture.append(angle_deg=1.0, on=shots(0, 0.1, 0.2), off=shots(2, 0.2, 0.1))
    lines = [json.loads(line) for line in (tmp_path / "room/frames.jsonl").read_text().splitlines()]
    assert lines[-1]["on"] == [
        {"file": "on/000001_0.zst", "exposure_s": 0.1},
        {"file": "on/000001_1.zst", "exposure_s": 0.2},
    ]
    assert len(open_capture(tmp_path / "room")) == 2


def test_a_failed_first_record_decides_nothing(tmp_path):
    with create_capture(tmp_path / "room", header()) as capture:
        with pytest.raises(CaptureError, match="only JSON values"):
            capture.append(angle_deg=0.0, on=shots(0, 0.1), note=object())
        capture.append(angle_deg=0.0, on=FRAMES[0])
    assert open_capture(tmp_path / "room").exposures == (1.0,)
