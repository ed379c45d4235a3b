"""Colour, Bayer, response, axis: the same stripe, seen another way."""

import jax
import numpy as np
import pytest

from jaxscan.stripes import FrameFormat, LaserLine, NoiseModel, extract_stripes
from jaxscan.stripes.frames.formats import decode_table, laser_plane, laser_sites


KNOWN = NoiseModel(read_dn=1.0, electrons_per_dn=40.0)
FIELDS = ("u", "sigma", "amplitude", "width", "chi2", "saturated", "valid")
TILES = ["rggb", "bggr", "grbg", "gbrg"]


def _same(a, b):
    for name in FIELDS:
        np.testing.assert_array_equal(np.asarray(getattr(a, name)), np.asarray(getattr(b, name)), err_msg=name)


def _mosaic(tile, colour, shape):
    """Which pixels of a Bayer image carry a colour."""
    row, column = np.indices(shape)
    letters = np.array(list(tile)).reshape(2, 2)
    return letters[row % 2, column % 2] == colour[0]


@pytest.mark.parametrize("tile", TILES)
@pytest.mark.parametrize("colour", ["red", "green", "blue"])
def test_bayer_sites_are_those_of_the_tile(tile, colour):
    rows, columns = 6, 8
    row, column = np.indices((rows, columns))
    # Each pixel holds its own coordinates, so the plane tells where its samples come from.
    frame = (16 * row + column).astype(np.uint8)[None]
    line = LaserLine(colour=colour)
    pixel_format = f"bayer_{tile}8"
    plane, sites = laser_plane(frame, pixel_format=pixel_format, line=line)[0], laser_sites(pixel_format, line)
    claimed = np.zeros((rows, columns), bool)
    for k in range(plane.shape[0]):
        for s in range(plane.shape[1]):
            r, c = sites.first_line + sites.line_step * k, sites.offsets[k % len(sites.offsets)] + sites.pitch * s
            assert divmod(int(plane[k, s]), 16) == (r, c)
            claimed[r, c] = True
    np.testing.assert_array_equal(claimed, _mosaic(tile, colour, (rows, columns)))


@pytest.mark.more
@pytest.mark.parametrize(
    ("tile", "colour"),
    [
        ("rggb", "red"),
        # The sites of all tiles and colours are above; here one of every two lines, and one of every line.
        pytest.param("grbg", "blue", marks=pytest.mark.slow),
        ("bggr", "green"),
    ],
)
def test_bayer_centre_is_that_of_the_mono_image(tile, colour, render):
    scene = render(2.0, 100.0)
    carries = _mosaic(tile, colour, scene.on.shape[1:])
    rng = np.random.default_rng(1)
    on = np.where(carries, scene.on, rng.integers(0, 256, scene.on.shape)).astype(np.uint8)
    off = np.where(carries, scene.off, rng.integers(0, 256, scene.on.shape)).astype(np.uint8)
    line, pixel_format = LaserLine(colour=colour), f"bayer_{tile}8"
    stripes = extract_stripes(on, off, pixel_format=pixel_format, line=line, noise=KNOWN)
    valid = np.asarray(stripes.valid)[0]
    lines = carries.any(1)
    # One line per image row; lines without sites of the colour are not valid.
    assert stripes.u.shape == (1, 2048)
    assert not np.any(valid[~lines])
    assert valid[lines].mean() > 0.99
    pull = ((np.asarray(stripes.u)[0] - scene.u) / np.where(valid, np.asarray(stripes.sigma)[0], 1.0))[valid]
    # At least 1000 rows: three standard errors of mean and root mean square are 0.1 and 0.07.
    assert abs(pull.mean()) < 0.1
    assert 0.92 < np.sqrt(np.mean(pull**2)) < 1.08
    mono = extract_stripes(scene.on, scene.off, noise=KNOWN)
    # Half the samples: the variance doubles, by 1.41 in sigma (a little scatter from the phase).
    ratio = np.asarray(stripes.sigma)[0][valid].mean() / np.asarray(mono.sigma)[0][valid].mean()
    assert ratio == pytest.approx(np.sqrt(2.0), rel=0.05)


@pytest.mark.more
def test_colour_of_no_sites_changes_nothing(render):
    scene = render(2.0, 100.0)
    carries = _mosaic("rggb", "red", scene.on.shape[1:])
    line = LaserLine(colour="red")
    planes = [
        extract_stripes(
            np.where(carries, scene.on, filler).astype(np.uint8),
            np.where(carries, scene.off, 255 - filler).astype(np.uint8),
            pixel_format="bayer_rggb8",
            line=line,
            noise=KNOWN,
        )
        for filler in (0, 255)
    ]
    _same(*planes)


@pytest.mark.more
def test_odd_sizes_of_a_bayer_image(render):
    scene = render(2.0, 100.0)
    on, off = scene.on[:, :2047, :95], scene.off[:, :2047, :95]
    stripes = extract_stripes(on, off, pixel_format="bayer_rggb8", line=LaserLine(colour="green"), noise=KNOWN)
    assert stripes.u.shape == (1, 2047)
    # The last row is half a tile: left out.
    assert np.asarray(stripes.valid)[0, :2046].mean() > 0.99
    assert not np.asarray(stripes.valid)[0, 2046]


@pytest.mark.more
def test_stripe_along_the_rows_of_a_mosaic_is_the_transposed_one(render):
    scene = render(2.0, 100.0)
    on, off = scene.on, scene.off
    upright = extract_stripes(on, off, pixel_format="bayer_grbg8", line=LaserLine(colour="green"), noise=KNOWN)
    # What stood to the right of the first pixel now stands below it.
    lying = extract_stripes(
        np.swapaxes(on, 1, 2),
        np.swapaxes(off, 1, 2),
        pixel_format="bayer_gbrg8",
        line=LaserLine(colour="green", stripe_axis="columns"),
        noise=KNOWN,
    )
    _same(upright, lying)


def _srgb(x):
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


@pytest.mark.parametrize(
    ("response", "code"),
    [pytest.param("srgb", _srgb, marks=pytest.mark.more), ("gamma 2.2", lambda x: x ** (1 / 2.2))],
)
def test_a_response_is_decoded_before_the_fit(response, code, profile):
    rng = np.random.default_rng(2)
    u = rng.uniform(40, 56, 2048)
    frames = []
    for level in (profile(u, 1.5, 100.0, 96) + 20.0, np.full((2048, 96), 20.0)):
        linear = rng.poisson(level * 40) / 40 + rng.normal(size=level.shape)
        frames.append(np.round(255 * code(np.clip(linear, 0, 255) / 255)).astype(np.uint8)[None])
    stripes = extract_stripes(*frames, pixel_format=FrameFormat("mono8", response), noise=KNOWN)
    assert np.asarray(stripes.valid).mean() > 0.99
    error = np.asarray(stripes.u)[0] - u
    assert 0.92 < np.sqrt(np.mean((error / np.asarray(stripes.sigma)[0]) ** 2)) < 1.08
    assert abs(np.asarray(stripes.chi2).mean() - 1.0) < 0.08
    # Read without decoding, width and amplitude come out wrong by a third.
    assert np.median(np.asarray(stripes.width)) == pytest.approx(1.5, rel=0.02)
    assert np.median(np.asarray(stripes.amplitude)) == pytest.approx(100.0, rel=0.02)


def test_decode_table_ends_and_slope():
    level, slope = decode_table("srgb")
    assert (level[0], level[255]) == (0.0, pytest.approx(255.0))
    assert np.all(np.diff(level) > 0)
    # The slope is the derivative: central differences of a smooth table, second order.
    np.testing.assert_allclose(slope[20:-1], np.gradient(level)[20:-1], rtol=2e-3)
    level, slope = decode_table("linear")
    np.testing.assert_allclose(level, np.arange(256))
    np.testing.assert_array_equal(slope, 1.0)


def test_wrong_arrays(render):
    scene = render(1.5, 80.0)
    with pytest.raises(ValueError, match="uint8 with 4 dimensions"):
        extract_stripes(scene.on, scene.off, pixel_format="rgb8")
    with pytest.raises(ValueError, match="`off` must be like `on`"):
        extract_stripes(scene.on, scene.off[:, :100])
    with pytest.raises(ValueError, match="uint8"):
        extract_stripes(scene.on.astype(np.float32))
    with pytest.raises(ValueError, match="at least one frame"):
        extract_stripes(scene.on[:0])


@pytest.mark.parametrize("transform", [jax.jit, jax.vmap])
def test_stripes_within_a_transformation_are_refused_in_words(transform):
    frames = np.zeros((2, 8, 16), np.uint8)
    with pytest.raises(TypeError, match="call it outside"):
        transform(lambda on: extract_stripes(on, on).u)(frames)
