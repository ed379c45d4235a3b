"""Sweeps without laser-off images in which next to nothing but the laser is seen."""

import numpy as np
import pytest

from jaxscan.reconstruction import ReconstructSettings, Sweep, extract
from jaxscan.reconstruction.without_off import dark_room

from .rooms import room


SETTINGS = ReconstructSettings(min_range_m=0.5, max_range_m=5.0)
EVEN = "laser-off images are taken as even"


def whitish(world, peak_dn=3000.0):
    """The stripe as a cheap camera sees it: clipped in its own channel, and a tenth of it in the others."""
    light = world.light / world.light.max() * peak_dn
    seen = light[..., None] * np.array([1.0, 0.1, 0.07])
    return np.clip(np.rint(world.dark + seen), 0, 255).astype(np.uint8), light


def centres(light):
    u = np.arange(light.shape[2])
    return (light * u).sum(2) / np.maximum(light.sum(2), 1e-9), light.max(2) > 200


@pytest.mark.more
@pytest.mark.parametrize("white_dn", [4.0, 130.0])
def test_a_clipped_line_before_a_dark_room_is_found_in_all_channels(white_dn):
    world = room("rgb8", 150.0, seed=31, yaw_deg=50.0, white_dn=white_dn)
    on, light = whitish(world)
    sweep = Sweep(on, None, world.angles, pixel_format="rgb8")
    found = extract(sweep, world.scanner, settings=SETTINGS)
    dark = white_dn < 10
    assert any(EVEN in note for note in found.notes) == dark
    if not dark:
        return
    truth, lit = centres(light)
    u, valid = np.asarray(found.stripes.u), np.asarray(found.stripes.valid)
    black = extract(Sweep(on, np.zeros_like(on), world.angles, pixel_format="rgb8"), world.scanner, settings=SETTINGS)
    best, known = np.asarray(black.stripes.u), np.asarray(black.stripes.valid)
    assert np.count_nonzero(valid & lit) >= 0.98 * np.count_nonzero(known & lit)
    error, least = (np.median(np.abs(centre - truth)[valid & known & lit]) for centre in (u, best))
    # As good as with a black picture as laser-off image.
    assert error < 1.1 * least + 0.002


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
