"""Sweeps with and without a laser are told apart, and chance has no part in what is accepted."""

from dataclasses import replace

import numpy as np
import pytest

from jaxscan.errors import CaptureError
from jaxscan.reconstruction import ReconstructSettings, Sweep, extract
from jaxscan.reconstruction.false_stripes import Decoys, DecoyWatch, Spacing, clearness, judge, judge_sweep
from jaxscan.reconstruction.plan import plan_sweep
from jaxscan.reconstruction.sweep import Batch
from jaxscan.stripes import ChunkStripes, FrameStripes

from .conftest import HEIGHT as LINES
from .conftest import WIDTH as SAMPLES
from .conftest import small_scanner
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


# A record of a line on every line of the image, which goes on as a laser's does: 0.3 px a line, 0.4 px a profile.
def _line(profiles, lines):
    return (40.0 + 0.3 * np.arange(lines) + 0.4 * np.arange(profiles)[:, None]).astype(np.float32)


def _fields(u, valid=None, amplitude=25.0):
    valid = np.ones(u.shape, bool) if valid is None else valid
    return {"u": u, "valid": valid, "amplitude": np.full(u.shape, amplitude, np.float32)}


def test_a_stripe_that_goes_on_is_clearer():
    """All around go on; then every other line is 30 px away, then every other profile, then one stripe is alone."""
    profiles, lines = 9, 31
    u, sequence = _line(profiles, lines), [np.arange(9)]
    whole = clearness(_fields(u), sequence, Spacing())
    np.testing.assert_allclose(whole, np.broadcast_to([1.0, 25.0, 25.0], whole.shape), rtol=1e-6)
    jumps = u + 30.0 * (np.arange(lines) % 2)
    # Of 54 around 24 are left, and of 10 in the profile 4.
    around = 0.5 * (1.0 + 24 / 54)
    np.testing.assert_allclose(
        clearness(_fields(jumps), sequence, Spacing())[4, 15], [around, 25 * around**2, 25 * 0.4**2], rtol=1e-6
    )
    moves = u + 30.0 * (np.arange(profiles) % 2)[:, None]
    # What comes back in every other profile does not go on.
    around = 0.5 * 10 / 54
    np.testing.assert_allclose(
        clearness(_fields(moves), sequence, Spacing())[4, 15], [around, 25 * around**2, 25.0], rtol=1e-6
    )
    alone = np.zeros(u.shape, bool)
    alone[4, 15] = True
    found = clearness(_fields(u, alone), sequence, Spacing())
    np.testing.assert_allclose(found[4, 15], [0.01, 0.0025, 0.0025], rtol=1e-5)
    assert not found[~alone].any()


def test_lines_of_a_mosaic_and_profiles_of_two_lasers_are_neighbours():
    """A Bayer mosaic has a colour on every other line; the profiles between are those of the other laser."""
    u = np.repeat(_line(9, 31), 2, 0)
    u[1::2] += 20.0
    valid = np.zeros(u.shape, bool)
    valid[:, 1::2] = True
    found = clearness(_fields(u, valid), [np.arange(0, 18, 2), np.arange(1, 18, 2)], Spacing())
    np.testing.assert_allclose(found[valid], np.broadcast_to([1.0, 25.0, 25.0], found[valid].shape), rtol=1e-6)
    assert not found[~valid].any()


def test_long_sweeps_are_looked_at_in_pieces():
    """Neighbours beyond a piece count as those in it, so a shifted sweep is as clear."""
    rng = np.random.default_rng(3)
    u = _line(600, 12) + rng.uniform(-2.0, 2.0, (600, 12)).astype(np.float32)
    whole = clearness(_fields(u), [np.arange(600)], Spacing())
    later = clearness(_fields(u[100:]), [np.arange(500)], Spacing())
    np.testing.assert_array_equal(whole[102:], later[2:])


def _plan(records, *, step_deg=1.0):
    frames = np.zeros((records, LINES, SAMPLES), np.uint8)
    return plan_sweep(Sweep(frames, frames, np.radians(step_deg) * np.arange(records)), small_scanner(), SETTINGS)


@pytest.mark.parametrize(("step_deg", "every"), [(10.0, 1), (0.5, 7), (0.0, 1)])
def test_profiles_are_compared_where_the_room_has_moved_on(step_deg, every):
    """The focal length is 102 px, so that half a degree is 0.9 px."""
    assert Spacing.of(_plan(60, step_deg=step_deg)).every == every


def test_false_stripes_are_the_same_in_batches_of_any_size():
    rng, records = np.random.default_rng(5), 40
    on, off = rng.integers(1, 20, (2, records, LINES, 4)).astype(np.uint8)

    def brightest(batch):
        """Every line has a stripe where it is brightest."""
        light = np.asarray(batch.on, np.float32)
        types = {"saturated": np.uint8, "valid": np.bool_}
        stripes = FrameStripes(*(np.zeros(light.shape[:2], types.get(k, np.float32)) for k in FrameStripes._fields))
        u, amplitude = light.argmax(2).astype(np.float32), light.max(2)
        return ChunkStripes(stripes._replace(u=u, amplitude=amplitude, valid=amplitude > 10), None)

    found = []
    for size in (3, 8, 40):
        watch, parts = DecoyWatch(_plan(records), predicted=True), []
        for start in range(0, records, size):
            part = slice(start, start + size)
            parts.append(watch.look(Batch(np.arange(records)[part], 0, on[part], off[part]), brightest))
        found.append(Decoys.joined(parts))
    for one in found[1:]:
        assert all(np.array_equal(a, b) for a, b in zip(one, found[0], strict=True))
    # Runs of five profiles between which the room moves by 4 times 1.8 px; two of them fit in.
    assert found[0].profile.tolist() == [0, 4, 8, 12, 16, 23, 27, 31, 35, 39]
    np.testing.assert_array_equal(found[0].u[0], off[found[0].profile[0]].argmax(1))


# Stripes that a laser makes go on with most of their neighbours, those of chance with few of them.
def _lit(rng, count, clear=(0.6, 1.0), light=60.0):
    return _with_light(rng, count, clear, light)


def _by_chance(rng, count, clear=(0.02, 0.3), light=20.0):
    return _with_light(rng, count, clear, light)


def _with_light(rng, count, clear, light):
    go_on, brightness = rng.uniform(*clear, count), light * rng.uniform(0.5, 1.5, count)
    return np.stack([go_on, go_on**2 * brightness, go_on**2 * brightness], 1)


def _judged(stripes, decoys, per_profile=300.0):
    """Of lists of stripes, on 500 lines of 8 profiles."""
    fields = []
    for values in (stripes, decoys):
        field = np.zeros((4000, 3), np.float32)
        field[: len(values)] = values
        fields.append(field.reshape(8, 500, 3))
    return judge(fields[0], fields[1], per_profile=per_profile)


def _kept(chance, values):
    return np.count_nonzero(values[:, chance.measure] >= chance.least)


@pytest.mark.parametrize("decoys", [1, 3])
def test_a_small_object_keeps_its_stripes_beside_a_clear_decoy(decoys):
    """A moving reflection may be brighter than every stripe; of 320 stripes it says nothing."""
    rng = np.random.default_rng(2)
    chance = _judged(_lit(rng, 320), _by_chance(rng, decoys, light=400.0), per_profile=40.0)
    assert chance.least == 0.0 and chance.note is None


@pytest.mark.parametrize(("lit", "others"), [(2000, 600), (900, 2500), (100, 3000)])
def test_false_stripes_raise_the_threshold(lit, others):
    """However few the lit lines are: the others are left out."""
    rng = np.random.default_rng(1)
    true, chance, decoys = _lit(rng, lit), _by_chance(rng, others), _by_chance(rng, others)
    found = _judged(np.concatenate([true, chance]), decoys)
    assert _kept(found, true) > 0.97 * lit
    # One in 500; and where one decoy is above the threshold more than 8 of chance are in one case in 28.
    assert _kept(found, chance) <= lit / 500 + 8
    assert found.note is not None and "doubtful" in found.note and "one dark picture as --off" in found.note


@pytest.mark.parametrize("more", [0.5, 1.5])
def test_stripes_of_chance_are_counted_by_those_that_are_no_clearer_than_decoys(more):
    """Lit lines have decoys and no stripe of chance; and bright print is commoner than dark print."""
    rng = np.random.default_rng(4)
    decoys, others = _by_chance(rng, 2000, clear=(0.02, 0.8)), _by_chance(rng, int(2000 * more), clear=(0.02, 0.8))
    true = _lit(rng, 1000)
    found = _judged(np.concatenate([true, others]), decoys)
    false = _kept(found, others) / (_kept(found, true) + _kept(found, others))
    # Three standard deviations of two stripes.
    assert false <= 0.002 + 3 * np.sqrt(0.002 / 1000)
    assert _kept(found, true) > 0.7 * len(true)


@pytest.mark.parametrize(("stripes", "decoys"), [(600, 600), (300, 600), (60, 50), (900, 600)])
def test_no_more_stripes_than_decoys_are_refused(stripes, decoys):
    rng = np.random.default_rng(2)
    with pytest.raises(CaptureError, match="not told from chance"):
        _judged(_by_chance(rng, stripes), _by_chance(rng, decoys), per_profile=stripes / 8)


def test_brightness_tells_where_the_camera_stands():
    """The room goes on from profile to profile as well as the line."""
    rng = np.random.default_rng(6)
    true, chance, decoys = (
        _with_light(rng, count, (0.9, 1.0), light) for count, light in ((400, 90.0), (2000, 9.0), (2000, 9.0))
    )
    for field in (true, chance, decoys):
        field[:, 0] = np.where(field[:, 0] > 0.95, 1.0, field[:, 0])
    found = _judged(np.concatenate([true, chance]), decoys)
    assert found.measure == 1 and _kept(found, true) == 400 and _kept(found, chance) <= 6


def test_lines_tell_where_profiles_are_far_apart():
    """Nothing goes on from one to the next, but by chance."""
    rng = np.random.default_rng(8)
    true, chance, decoys = (_by_chance(rng, count) for count in (1000, 1000, 1000))
    true[:, 2] = 60.0 * rng.uniform(0.5, 1.5, 1000)
    found = _judged(np.concatenate([true, chance]), decoys)
    assert found.measure == 2 and _kept(found, true) == 1000 and _kept(found, chance) <= 6


def test_a_line_beside_a_few_clearer_decoys_is_kept_and_said():
    rng = np.random.default_rng(2)
    chance = _judged(_lit(rng, 320), _lit(rng, 10, clear=(1.0, 1.0), light=600.0), per_profile=40.0)
    assert chance.least == 0.0 and chance.note is not None and "as clear as these" in chance.note


def test_hardly_any_stripe_is_said():
    rng = np.random.default_rng(3)
    for stripes, decoys in ((3, 0), (0, 40)):
        few = _judged(_by_chance(rng, stripes), _by_chance(rng, decoys), per_profile=0.4)
        assert few.note is not None and "hardly any record" in few.note
    # The looked-at records may be just those that show nothing.
    assert _judged(_by_chance(rng, 3), _by_chance(rng, 0), per_profile=40.0).note is None


def test_lines_of_a_sweep_are_left_out_and_few_that_are_left_are_said():
    """A line on twenty lines of all profiles; or on three of them."""
    rng, records = np.random.default_rng(9), 60
    plan = _plan(records, step_deg=10.0)
    for rows, said in ((20, "would keep more"), (1, "hardly any record shows a stripe")):
        u, decoy = (rng.uniform(0.0, SAMPLES, (records, LINES)).astype(np.float32) for _ in range(2))
        u[:, 10 : 10 + rows] = _line(records, rows) % 60.0
        searched = np.concatenate([np.arange(start, start + 5) for start in (0, 18, 36, 55)])
        decoys = Decoys(searched, decoy[searched], np.full((20, LINES), 25.0, np.float32))
        chance, believed = judge_sweep(plan, _fields(u), decoys)
        assert said in chance.note
        assert np.count_nonzero(believed[:, 10 : 10 + rows]) > 0.8 * records * rows
        assert np.count_nonzero(believed) - np.count_nonzero(believed[:, 10 : 10 + rows]) < 0.01 * records * LINES
