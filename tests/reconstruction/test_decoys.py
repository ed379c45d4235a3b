"""Sweeps with and without a laser are told apart, and chance has no part in what is accepted."""

from dataclasses import replace

import numpy as np
import pytest

from jaxscan.errors import CaptureError
from jaxscan.reconstruction import ReconstructSettings, Sweep, extract
from jaxscan.reconstruction.decoys import DecoyWatch, judge
from jaxscan.reconstruction.sweep import Batch
from jaxscan.stripes import ChunkStripes, FrameStripes

from .rooms import HEIGHT, STEPS, moving_light, room


SETTINGS = ReconstructSettings(min_range_m=0.5, max_range_m=5.0)
# Seeds were written down before the first run. Pixel format, peak of the stripe, laser-off images, seed, yaw.
ROOMS = [
    ("mono8", 150.0, True, 3, 50.0),
    ("rgb8", 150.0, False, 10, 230.0),
    ("mono8", 40.0, True, 4, 140.0),
    ("rgb8", 150.0, True, 5, 230.0),
    ("rgb8", 400.0, True, 6, 320.0),
    ("bayer_rggb8", 150.0, True, 7, 10.0),
    ("mono8", 150.0, False, 8, 50.0),
    ("mono8", 400.0, False, 9, 140.0),
    ("rgb8", 400.0, False, 11, 320.0),
    ("rgb8", 200.0, False, 12, 100.0),
]
FAST = 2


@pytest.mark.parametrize(
    ("pixel_format", "peak_dn", "has_off", "seed", "yaw_deg"),
    [pytest.param(*one, marks=[] if k < FAST else pytest.mark.slow) for k, one in enumerate(ROOMS)],
)
def test_with_a_stripe_and_without(pixel_format, peak_dn, has_off, seed, yaw_deg):
    world = room(pixel_format, peak_dn, seed=seed, yaw_deg=yaw_deg)
    sweep = Sweep(world.on, world.off if has_off else None, world.angles, pixel_format=pixel_format)
    stripes = extract(sweep, world.scanner, settings=SETTINGS).stripes
    valid = np.asarray(stripes.valid)
    good = world.lit(np.asarray(stripes.u), valid)
    # A Bayer mosaic has red on every other line.
    lines = STEPS * HEIGHT / (2 if pixel_format.startswith("bayer") else 1)
    assert np.count_nonzero(good) > (0.9 if has_off else 0.6) * lines
    assert np.count_nonzero(valid & ~good) <= 0.005 * np.count_nonzero(valid)

    try:
        found = extract(replace(sweep, on=moving_light(world.dark, seed)), world.scanner, settings=SETTINGS)
    except CaptureError as refusal:
        assert "not told from chance" in str(refusal)
    else:
        # Too few to be counted: said, and none or hardly any is given.
        left = np.count_nonzero(np.asarray(found.stripes.valid))
        assert left == 0 or any("hardly any record shows a stripe" in note for note in found.notes)
        assert left < 2 * STEPS


def _clear(rng, count, scale):
    values = np.zeros(4000, np.float32)
    values[:count] = scale * rng.uniform(0.5, 1.5, count)
    return rng.permutation(values).reshape(8, 500)


def _bright_lines(batch):
    """Every line has a stripe as wide as it is bright."""
    light = np.asarray(batch.on, np.float32).mean(2)
    types = {"saturated": np.uint8, "valid": np.bool_}
    stripes = FrameStripes(*(np.zeros(light.shape, types.get(name, np.float32)) for name in FrameStripes._fields))
    return ChunkStripes(stripes._replace(width=light, sigma=stripes.sigma + 1, valid=light > 0), None)


def test_decoys_are_the_same_in_batches_of_any_size():
    rng, records, lines = np.random.default_rng(5), 40, 100
    on, off = rng.integers(1, 20, (2, records, lines, 4)).astype(np.uint8)
    on[:, lines // 10 :] += 100
    watches = [DecoyWatch(records, predicted=False) for _ in range(2)]
    for start in range(0, records, 8):
        batch = Batch(np.arange(start, start + 8), 0, on[start : start + 8], off[start : start + 8])
        for watch in watches:
            watch.look(batch, _bright_lines(batch))
    compared = [watch.compared(_bright_lines, size) for watch, size in zip(watches, (3, 32), strict=True)]
    found, other = (judge(*both, per_profile=float(lines)) for both in compared)
    assert found == other
    # A tenth of the lines is chance, and no clearer than 19 / 1.
    assert 5 < found.least < 20 and found.note is not None


def test_few_decoys_change_nothing():
    rng = np.random.default_rng(0)
    chance = judge(_clear(rng, 3000, 20.0), _clear(rng, 5, 3.0), per_profile=375.0)
    assert chance.least == 0.0 and chance.note is None


@pytest.mark.parametrize("decoys", [1, 3])
def test_a_small_object_keeps_its_stripes_beside_a_clear_decoy(decoys):
    """A moving reflection may be clearer than every stripe; of 320 stripes it says nothing."""
    rng = np.random.default_rng(2)
    chance = judge(_clear(rng, 320, 20.0), _clear(rng, decoys, 100.0), per_profile=40.0)
    assert chance.least == 0.0 and chance.note is None


def test_decoys_raise_the_threshold():
    rng = np.random.default_rng(1)
    true, chance, decoys = _clear(rng, 2000, 60.0), _clear(rng, 600, 4.0), _clear(rng, 600, 4.0)
    found = judge(np.maximum(true, chance), decoys, per_profile=300.0)
    # Chance reaches 6; that many are left that no more than one in 400 is of chance.
    assert 5.0 < found.least <= 6.1
    assert found.note is not None and "doubtful" in found.note


@pytest.mark.parametrize(("stripes", "decoys"), [(600, 600), (300, 600), (60, 50), (0, 40)])
def test_no_more_stripes_than_decoys_are_refused(stripes, decoys):
    rng = np.random.default_rng(2)
    with pytest.raises(CaptureError, match="not told from chance"):
        judge(_clear(rng, stripes, 4.0), _clear(rng, decoys, 4.0), per_profile=stripes / 8)


def test_hardly_any_stripe_is_said():
    rng = np.random.default_rng(3)
    few = judge(_clear(rng, 3, 4.0), _clear(rng, 0, 4.0), per_profile=0.4)
    assert few.note is not None and "hardly any record" in few.note
    # The looked-at records may be just those that show nothing.
    assert judge(_clear(rng, 3, 4.0), _clear(rng, 0, 4.0), per_profile=40.0).note is None
