"""Which laser-off images are taken where the sweep has none, or one picture for all."""

import numpy as np
import pytest

from jaxscan.reconstruction import ReconstructSettings, Sweep, extract
from jaxscan.reconstruction.extraction import _Lines
from jaxscan.reconstruction.without_off import dark_room, darks

from .rooms import room


SETTINGS = ReconstructSettings(min_range_m=0.5, max_range_m=5.0)
ALONE = "the laser-off images are what each channel predicts by itself"


def whitish(world, peak_dn, others):
    """The stripe as a cheap camera sees it: in all channels."""
    light = world.light / world.light.max() * peak_dn
    seen = light[..., None] * np.array([1.0, others, 0.8 * others])
    return np.clip(np.rint(world.dark + seen), 0, 255).astype(np.uint8), light


def centres(light):
    u = np.arange(light.shape[2])
    return (light * u).sum(2) / np.maximum(light.sum(2), 1e-9), light.max(2) > 8


@pytest.mark.more
@pytest.mark.parametrize(
    ("white_dn", "others", "picture"), [(40.0, 0.6, None), (40.0, 0.6, "wrong"), (130.0, 0.04, None)]
)
def test_a_line_that_all_channels_see_is_not_subtracted_by_them(white_dn, others, picture):
    world = room("rgb8", 150.0, seed=31, yaw_deg=50.0, white_dn=white_dn)
    on, light = whitish(world, 600.0, others)
    # A picture of the room from another angle is worse than a prediction.
    given = None if picture is None else np.broadcast_to(world.off[5], on.shape)
    found, best = (
        extract(Sweep(on, off, world.angles, pixel_format="rgb8"), world.scanner, settings=SETTINGS)
        for off in (given, world.off)
    )
    assert any(ALONE in note for note in found.notes) == (others > 0.5)
    truth, lit = centres(light)
    (u, valid), (known_u, known) = ((np.asarray(one.stripes.u), np.asarray(one.stripes.valid)) for one in (found, best))
    assert np.count_nonzero(valid & lit) >= 0.9 * np.count_nonzero(known & lit)
    error, least = (np.median(np.abs(centre - truth)[valid & known & lit]) for centre in (u, known_u))
    # As good as with true laser-off images; a tenth for the luck of the noise of those.
    assert error < 1.1 * least


def wavy(noise_px, seed, false=0):
    """Lines on a bent surface, with noise and with some that lie anywhere."""
    rng = np.random.default_rng(seed)
    u = 100.0 + 5.0 * np.sin(np.arange(400) / 60.0) + noise_px * rng.standard_normal((8, 400))
    u[:, :false] = rng.uniform(0.0, 200.0, (8, false))
    return _Lines(u, np.ones(u.shape, bool), 1)


def test_the_gain_is_that_of_the_variance_and_of_the_straight_lines():
    usual = wavy(0.06, 1)
    # 3,136 bends: their quantile is known to 2 %, the square of a ratio to 5 %.
    assert wavy(0.03, 2).over(usual) == pytest.approx(4.0, rel=0.15)
    # A quarter of the lines lies anywhere: those are no gain, however straight the others are.
    assert wavy(0.06, 3, false=100).over(usual) == pytest.approx(0.75, rel=0.15)
    none = usual._replace(valid=np.zeros(usual.valid.shape, bool))
    assert none.over(usual) == 0.0 and usual.over(none) > 1.0


def test_there_is_a_choice_where_no_picture_or_one_for_all_is_given():
    rng = np.random.default_rng(1)
    on, off = (rng.integers(30, 200, (3, 40, 60, 3)).astype(np.uint8) for _ in range(2))

    def sources(one, **settings):
        sweep = Sweep(on, one, np.zeros(3), pixel_format="rgb8", **settings)
        return [dark.source for dark in darks(sweep, next(sweep.chunks(3)))]

    assert sources(None) == ["predicted", "alone"]
    assert sources(np.broadcast_to(off[0], off.shape)) == ["given", "predicted", "alone"]
    assert sources(off) == ["given"]


@pytest.mark.parametrize("pixel_format", ["mono8", "rgb8", "bayer_grbg8"])
def test_a_room_is_dark_in_all_channels_or_not_at_all(pixel_format):
    rng = np.random.default_rng(1)
    shape = (3, 40, 60, 3) if pixel_format == "rgb8" else (3, 40, 60)
    on = rng.integers(3, 9, shape).astype(np.uint8)
    on[:, :, 30:33] = 255
    sweep = Sweep(on, None, np.zeros(3), pixel_format=pixel_format)
    found = dark_room(sweep, on)
    assert found.shape == on.shape[1:] and found.dtype == np.uint8
    assert found.min() >= 4 and found.max() <= 7
    on[:, :10] += 40
    assert dark_room(sweep, on) is None
