"""A real stripe: over-exposed, with a glow, on a textured bust, in compressed colour pictures."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from jaxscan.stripes import extract_stripes


pytestmark = pytest.mark.more


SCENE = Path(__file__).parents[1] / "data" / "ciclop" / "scene"


@pytest.fixture(scope="module")
def pair():
    if not SCENE.is_dir():
        pytest.skip("tests/data/ciclop/scene is not there (real pictures, CC BY-SA 4.0)")
    read = lambda name: cv2.cvtColor(cv2.imread(str(SCENE / name)), cv2.COLOR_BGR2RGB)[None]
    return read("laser.png"), read("laser_background.png")


def test_stripe_on_every_lit_row(pair):
    on, off = pair
    stripes = extract_stripes(on, off, pixel_format="rgb8")
    assert stripes.u.shape == (1, 1280)
    difference = (on[0, :, :, 0].astype(np.float32) - off[0, :, :, 0]).astype(np.float32)
    smooth = cv2.GaussianBlur(difference, (9, 1), 0)
    # Twenty DN is ten times the noise of the difference; 1118 rows have that much.
    lit = smooth.max(1) > 20
    assert 1100 < lit.sum() < 1130
    valid, u = np.asarray(stripes.valid)[0], np.asarray(stripes.u)[0]
    assert np.all(valid[lit])
    # Within the glowing part of a stripe that is 10 to 20 px wide.
    assert np.mean(np.abs(u - smooth.argmax(1))[lit] < 12) > 0.99
    # 719 rows are clipped in red somewhere; the fit knows of nearly all of them.
    assert 650 < np.count_nonzero(np.asarray(stripes.saturated)[0]) < 730
    # The bust is smooth but for its silhouettes.
    steps = np.abs(np.diff(u))[lit[1:] & lit[:-1]]
    assert np.median(steps) < 0.35


def test_without_the_laser_off_picture_it_is_the_same_stripe(pair):
    on, off = pair
    with_off = extract_stripes(on, off, pixel_format="rgb8")
    without = extract_stripes(on, None, pixel_format="rgb8")
    both = np.asarray(with_off.valid & without.valid)[0]
    assert both.sum() > 900
    difference = np.abs(np.asarray(with_off.u) - np.asarray(without.u))[0][both]
    # The glow is background for one and stripe for the other; a quarter pixel of a 12 px stripe.
    assert np.median(difference) < 0.3
