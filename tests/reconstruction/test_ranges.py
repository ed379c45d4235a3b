"""Stripes found in parts: together to the last bit what the whole sweep gives."""

import dataclasses
import shutil

import numpy as np
import pytest

import jaxscan
from jaxscan.api.sweeps import cloud_of_ranges, ranges_of, stripes_of_range
from jaxscan.errors import CaptureError
from jaxscan.reconstruction import ReconstructSettings


@pytest.fixture(scope="module")
def sweep(tiny):
    return jaxscan.open_capture(tiny.sweep)


@pytest.fixture(scope="module")
def scanner(tiny):
    return jaxscan.load_scanner(tiny.calibration)


def same(one, other):
    for name, field in vars(one.cloud).items():
        if field is not None:
            np.testing.assert_array_equal(field, getattr(other.cloud, name), err_msg=name)
    assert (one.notes, one.noise) == (other.notes, other.noise)


@pytest.mark.more
@pytest.mark.parametrize("ends", [(60,), (1, 60), (7, 33, 34, 60), (8, 16, 24, 32, 40, 48, 60)], ids=str)
@pytest.mark.parametrize("smooth", ["edge", "off"])
def test_parts_are_together_the_whole(sweep, scanner, ends, smooth):
    settings = ReconstructSettings(smooth=smooth)
    whole = jaxscan.reconstruct_capture(sweep, scanner, settings=settings, cache=False)
    ranges = list(zip((0, *ends[:-1]), ends, strict=True))
    parts = [stripes_of_range(sweep, scanner, one, settings=settings) for one in ranges]
    same(cloud_of_ranges(sweep, scanner, parts[::-1], settings=settings), whole)


@pytest.mark.more
def test_ranges_are_all_records(sweep):
    assert ranges_of(sweep, 1000) == ((0, 60),)
    assert ranges_of(sweep, 20) == ((0, 20), (20, 40), (40, 60))
    assert ranges_of(sweep, 26) == ((0, 30), (30, 60))


def test_other_frames_are_not_needed(tiny, scanner, tmp_path):
    folder = tmp_path / "sweep"
    shutil.copytree(tiny.sweep, folder)
    capture = jaxscan.open_capture(folder)
    expected = stripes_of_range(capture, scanner, (40, 44))
    # The first 32 teach.
    for record in (*capture.records[32:40], *capture.records[44:]):
        for image in (*record.on, *record.off):
            (folder / image.path).unlink()
    found = stripes_of_range(capture, scanner, (40, 44))
    for name, array in expected.items():
        np.testing.assert_array_equal(array, found[name], err_msg=name)


def test_parts_that_do_not_fit_are_refused(sweep, scanner):
    parts = [stripes_of_range(sweep, scanner, one) for one in ((0, 30), (30, 60))]
    for wrong in (parts[:1], parts[1:], [*parts, parts[0]], []):
        with pytest.raises(CaptureError, match="expected 0-60, each once"):
            cloud_of_ranges(sweep, scanner, wrong)
    with pytest.raises(CaptureError, match="another sweep, other settings or another code"):
        cloud_of_ranges(sweep, scanner, parts, settings=ReconstructSettings(min_range_m=0.9))
    with pytest.raises(CaptureError, match="another sweep"):
        cloud_of_ranges(sweep.every(2), scanner, parts)
    with pytest.raises(CaptureError, match="is none"):
        cloud_of_ranges(sweep, scanner, [{}])


def test_a_sweep_that_cannot_be_split_is_refused(sweep, scanner):
    with pytest.raises(CaptureError, match="cannot be found in parts"):
        stripes_of_range(sweep, scanner, (0, 30), settings=ReconstructSettings(check_steps=True))
    alone = dataclasses.replace(sweep, records=tuple(dataclasses.replace(record, off=()) for record in sweep.records))
    with pytest.raises(CaptureError, match="cannot be found in parts"):
        stripes_of_range(alone, scanner, (0, 30))
