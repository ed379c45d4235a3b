"""Sweeps with and without a laser are told apart, and chance has no part in what is accepted."""

from dataclasses import replace

import numpy as np
import pytest

from jaxscan.errors import CaptureError
from jaxscan.reconstruction import ReconstructSettings, Sweep, extract
from jaxscan.reconstruction.decoys import DecoyWatch, clearness, judge
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


@pytest.mark.more
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


LIT = slice(100, 200)


@pytest.mark.more
@pytest.mark.parametrize(
    ("pixel_format", "seed", "yaw_deg", "false"),
    [pytest.param("rgb8", 10, 230.0, 0.01), pytest.param("mono8", 8, 50.0, 0.005, marks=pytest.mark.slow)],
)
def test_lines_that_no_laser_lights_do_not_refuse_the_others(pixel_format, seed, yaw_deg, false):
    """As of an object on a table, which is all of the picture that the laser reaches."""
    world = room(pixel_format, 150.0, seed=seed, yaw_deg=yaw_deg)
    on = world.dark.copy()
    on[:, LIT] = world.on[:, LIT]
    sweep = Sweep(on, None, world.angles, pixel_format=pixel_format)
    found = extract(sweep, world.scanner, settings=SETTINGS)
    valid = np.asarray(found.stripes.valid)
    good = world.lit(np.asarray(found.stripes.u), valid)
    good[:, : LIT.start] = good[:, LIT.stop :] = False
    assert np.count_nonzero(good) > 0.45 * STEPS * (LIT.stop - LIT.start)
    # More than are promised: bright print in the dark lines, which a mono camera takes for stripes, is commoner than
    # dark print, which gives decoys.
    assert np.count_nonzero(valid & ~good) <= false * np.count_nonzero(valid)
    assert any("one dark picture as --off" in note for note in found.notes)


@pytest.mark.more
@pytest.mark.parametrize(
    ("pixel_format", "peak_dn", "seed", "yaw_deg", "rows"),
    [
        pytest.param("rgb8", 150.0, 10, 230.0, 15),
        pytest.param("rgb8", 200.0, 12, 100.0, 15, marks=pytest.mark.slow),
        pytest.param("mono8", 400.0, 9, 140.0, 15, marks=pytest.mark.slow),
        pytest.param("rgb8", 150.0, 10, 230.0, 6, marks=pytest.mark.slow),
    ],
)
def test_a_line_on_few_rows_is_kept(pixel_format, peak_dn, seed, yaw_deg, rows):
    """As of a small thing in a large dark picture: nine lines in ten are chance, as often clearer turned round."""
    world = room(pixel_format, peak_dn, seed=seed, yaw_deg=yaw_deg)
    lit, on = slice(150 - rows // 2, 150 + rows - rows // 2), world.dark.copy()
    on[:, lit] = world.on[:, lit]
    sweep = Sweep(on, None, world.angles, pixel_format=pixel_format)
    found = extract(sweep, world.scanner, settings=SETTINGS)
    valid = np.asarray(found.stripes.valid)
    good = world.lit(np.asarray(found.stripes.u), valid)
    good[:, : lit.start] = good[:, lit.stop :] = False
    assert np.count_nonzero(good) > 0.2 * STEPS * rows
    assert np.count_nonzero(valid & ~good) <= 0.12 * np.count_nonzero(valid)
    assert sum("doubtful" in note and "one dark picture as --off" in note for note in found.notes) == 1


@pytest.mark.more
@pytest.mark.slow
def test_bright_print_before_a_mono_camera_is_no_laser():
    """A fifth of what it shows is clearer than dark print is, and in a quarter of the profiles by half."""
    world = room("mono8", 150.0, seed=3, yaw_deg=0.0)
    with pytest.raises(CaptureError, match="not told from chance"):
        extract(Sweep(world.dark, None, world.angles), world.scanner, settings=SETTINGS)


def _clear(rng, count, scale):
    """Stripes of so much light, as clear as they are bright."""
    values = np.zeros(4000, np.float32)
    values[:count] = scale * rng.uniform(0.5, 1.5, count)
    return rng.permutation(values).reshape(8, 500)


def _judged(stripes, decoys, per_profile):
    both = (np.stack([values, values**2], -1) for values in (stripes, decoys))
    return judge(*both, per_profile=per_profile)


def _bright_lines(batch):
    """Every line has a stripe as wide as it is bright."""
    light = np.asarray(batch.on, np.float32).mean(2)
    types = {"saturated": np.uint8, "valid": np.bool_}
    stripes = FrameStripes(*(np.zeros(light.shape, types.get(name, np.float32)) for name in FrameStripes._fields))
    return ChunkStripes(stripes._replace(width=light, amplitude=light, sigma=stripes.sigma + 1, valid=light > 0), None)


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
    assert 5 < found.least ** (1 / (1 + found.measure)) < 20 and found.note is not None


@pytest.mark.parametrize("decoys", [1, 3])
def test_a_small_object_keeps_its_stripes_beside_a_clear_decoy(decoys):
    """A moving reflection may be clearer than every stripe; of 320 stripes it says nothing."""
    rng = np.random.default_rng(2)
    chance = _judged(_clear(rng, 320, 20.0), _clear(rng, decoys, 100.0), per_profile=40.0)
    assert chance.least == 0.0 and chance.note is None


def test_a_line_beside_a_few_clearer_decoys_is_kept_and_said():
    rng = np.random.default_rng(2)
    chance = _judged(_clear(rng, 320, 20.0), _clear(rng, 12, 100.0), per_profile=40.0)
    assert chance.least == 0.0 and chance.note is not None and "as clear as these" in chance.note


def test_a_stripe_that_goes_on_is_clearer():
    """One line with a gap, one that jumps, and one row by itself, of the same fits."""
    lines = 40
    u = np.tile(0.5 * np.arange(lines), (3, 1)).astype(np.float32)
    u[1, ::2] += 30
    valid = np.ones(u.shape, bool)
    valid[0, 20], valid[2] = False, np.arange(lines) == 20
    one = np.ones(u.shape, np.float32)
    clear = clearness({"valid": valid, "u": u, "width": one, "sigma": 0.1 * one, "amplitude": 25 * one})
    np.testing.assert_allclose(clear[0, 10], [10.0, 50.0], rtol=1e-5)
    # A line that has no stripe is no end.
    np.testing.assert_allclose(clear[0, 18], [10.0, 50.0], rtol=1e-5)
    for row in (1, 2):
        np.testing.assert_allclose(clear[row, 20], np.array([10.0, 50.0]) / 121, rtol=1e-5)
    assert not clear[~valid].any()


@pytest.mark.parametrize(("lit", "others"), [(2000, 600), (900, 2500)])
def test_decoys_raise_the_threshold(lit, others):
    rng = np.random.default_rng(1)
    true, chance, decoys = _clear(rng, lit, 60.0), _clear(rng, others, 4.0), _clear(rng, others, 4.0)
    found = _judged(np.maximum(true, chance), decoys, per_profile=300.0)
    # Chance reaches 6; that many are left that no more than one in 400 is of chance.
    assert 5.0 < found.least ** (1 / (1 + found.measure)) <= 6.1
    assert found.note is not None and "doubtful" in found.note


@pytest.mark.parametrize(("stripes", "decoys"), [(600, 600), (300, 600), (60, 50), (0, 40)])
def test_no_more_stripes_than_decoys_are_refused(stripes, decoys):
    rng = np.random.default_rng(2)
    with pytest.raises(CaptureError, match="not told from chance"):
        _judged(_clear(rng, stripes, 4.0), _clear(rng, decoys, 4.0), per_profile=stripes / 8)


def test_hardly_any_stripe_is_said():
    rng = np.random.default_rng(3)
    few = _judged(_clear(rng, 3, 4.0), _clear(rng, 0, 4.0), per_profile=0.4)
    assert few.note is not None and "hardly any record" in few.note
    # The looked-at records may be just those that show nothing.
    assert _judged(_clear(rng, 3, 4.0), _clear(rng, 0, 4.0), per_profile=40.0).note is None


def _with_a_line(rng, profiles, clear):
    """Chance on 500 rows of 16 profiles, as often turned round; and a line on ten rows of some profiles."""
    stripes, decoys = (rng.uniform(1.0, 4.0, (16, 500)).astype(np.float32) for _ in range(2))
    stripes[:profiles, 100:110] = clear
    return stripes, decoys


def test_a_line_on_few_rows_of_most_profiles_is_found():
    stripes, decoys = _with_a_line(np.random.default_rng(7), 8, 20.0)
    found = _judged(stripes, decoys, per_profile=250.0)
    assert np.count_nonzero((stripes if found.measure == 0 else stripes**2) >= found.least) == 80
    assert found.note is not None and "narrower range limits" in found.note


@pytest.mark.parametrize(("profiles", "clear"), [(4, 20.0), (16, 4.5)])
def test_a_line_that_chance_may_show_is_refused(profiles, clear):
    """In a few profiles alone, or hardly clearer than chance."""
    with pytest.raises(CaptureError, match="not told from chance"):
        _judged(*_with_a_line(np.random.default_rng(7), profiles, clear), per_profile=250.0)


def test_amplitude_parts_what_clearness_does_not():
    """Where speckle is strong a stripe of 60 DN is hardly clearer than one of 9 DN."""
    rng, shape = np.random.default_rng(6), (8, 500)
    stripes, dim = (rng.uniform(3.0, 9.0, shape) for _ in range(2))
    lit = rng.uniform(size=shape) < 0.5
    stripes = np.where(lit, 1.5, 1.0) * stripes
    stripes = np.stack([stripes, np.where(lit, 60.0, 9.0) * stripes], -1).astype(np.float32)
    decoys = np.stack([dim, 9.0 * dim], -1).astype(np.float32)
    found = judge(stripes, decoys, per_profile=500.0)
    assert found.measure == 1
    kept = stripes[..., 1] >= found.least
    assert np.count_nonzero(kept & lit) > 0.95 * np.count_nonzero(lit)
    assert np.count_nonzero(kept & ~lit) <= 0.01 * np.count_nonzero(kept)
