"""A laser whose colour is "auto": learned once for a sweep, a capture of a board, or a stack of frames."""

import numpy as np
import pytest

from jaxscan.errors import CaptureError
from jaxscan.files.capture import CaptureHeader, open_capture
from jaxscan.files.recording import create_capture
from jaxscan.observation.board_stripes import learn_colours
from jaxscan.reconstruction import ReconstructSettings, Sweep, reconstruct
from jaxscan.stripes import LaserLine
from jaxscan.stripes.extract import extract_stripes

from .conftest import small_scanner, stripes_on_plane
from .rendered import expose, stripe


WIDTH, HEIGHT, RECORDS = 192, 96, 6
NORMAL = np.array([0.9, 0.4, 0.17]) / np.linalg.norm([0.9, 0.4, 0.17])
COLOURS = ("red", "green", "blue")


@pytest.fixture(scope="module")
def scanner():
    return small_scanner(lasers=2, width=WIDTH, height=HEIGHT)


@pytest.fixture(scope="module")
def centres(scanner):
    return [stripes_on_plane(scanner, np.radians(np.arange(RECORDS)), NORMAL, 1.5, laser) for laser in (0, 1)]


def frames(light, colour, pixel_format, lit=1.0):
    """Pairs [records, ...] of a room of warm light; other channels see a tenth of the laser."""
    if pixel_format == "mono8":
        return expose(light + 12.0, 1), expose(np.full(light.shape, 12.0), 2)
    share = lit * np.where(np.array(COLOURS) == np.asarray(colour)[:, None], 1.0, 0.1)
    room = np.broadcast_to([20.0, 14.0, 6.0], (*light.shape, 3))
    on = room + light[..., None] * share[:, None, None]
    if pixel_format == "bayer_grbg8":
        site = np.array([[1, 0], [2, 1]])[np.arange(HEIGHT)[:, None] % 2, np.arange(WIDTH) % 2]
        on, room = (
            np.take_along_axis(a, np.broadcast_to(site[..., None], (*light.shape, 1)), 3)[..., 0] for a in (on, room)
        )
    return expose(on, 1), expose(room, 2)


# The same learning, whatever is reconstructed: RGB in the sweep of two lasers and in the stack below.
@pytest.mark.more
@pytest.mark.parametrize("pixel_format", ["mono8", pytest.param("rgb8", marks=pytest.mark.slow), "bayer_grbg8"])
def test_a_sweep(scanner, centres, pixel_format):
    """With the colour learned the cloud is that of the colour given."""
    on, off = frames(stripe(*centres[0], 60.0, WIDTH), ["green"] * RECORDS, pixel_format)
    phi = np.radians(np.arange(RECORDS))
    given, learned = (
        reconstruct(Sweep(on, off, phi, pixel_format=pixel_format, lasers=(LaserLine("left", colour),)), scanner)
        for colour in ("green", "auto")
    )
    for name in ("xyz", "valid", "rgb", "sigma_random"):
        np.testing.assert_array_equal(getattr(learned, name), getattr(given, name), err_msg=name)
    assert given.valid.mean() > 0.95
    # How much hangs on it is seen in two lasers of different colours too, by their intensity.
    if pixel_format == "rgb8":
        red = reconstruct(Sweep(on, off, phi, pixel_format=pixel_format, lasers=(LaserLine("left"),)), scanner)
        # Red, the default, would have seen a tenth of the laser: so much hangs on it.
        assert np.median(red.sigma_random[red.valid]) > 2 * np.median(given.sigma_random[given.valid])


@pytest.mark.more
def test_each_laser_has_its_own(scanner, centres):
    """The second one is lit for the first time after the records that are looked at first."""
    number = np.array([0] * 9 + [1] * 3)
    which = np.arange(12) % RECORDS
    light = np.stack(
        [stripe(centres[n][0][k], centres[n][1][k], 60.0, WIDTH) for n, k in zip(number, which, strict=True)]
    )
    on, off = frames(light, np.array(["blue", "green"])[number], "rgb8")
    lines = (LaserLine("left", "auto"), LaserLine("right", "auto"))
    sweep = Sweep(on, off, np.radians(which), pixel_format="rgb8", lasers=lines, laser=number)
    cloud = reconstruct(sweep, scanner)
    error = np.abs(cloud.xyz @ NORMAL - 1.5)
    # Chance alone exceeds five standard deviations once in two million.
    assert cloud.valid.mean() > 0.99 and np.all(error[cloud.valid] < 5 * cloud.sigma_random[cloud.valid])
    assert np.median(cloud.intensity[cloud.valid]) == pytest.approx(60.0, rel=0.05)


def test_what_cannot_be_learned_is_refused(scanner, centres):
    light, phi = stripe(*centres[0], 60.0, WIDTH), np.radians(np.arange(RECORDS))
    line = LaserLine("left", "auto")
    on, off = frames(light, ["green"] * RECORDS, "rgb8", lit=0.0)
    with pytest.raises(CaptureError, match='"left" is "auto" and cannot be learned: No channel'):
        reconstruct(Sweep(on, off, phi, pixel_format="rgb8", lasers=(line,)), scanner)
    on, off = frames(light, ["green"] * RECORDS, "rgb8")
    with pytest.raises(CaptureError, match="without laser-off frames, give its colour"):
        reconstruct(Sweep(on, None, phi, pixel_format="rgb8", lasers=(line,)), scanner)
    together = Sweep(
        on,
        off,
        phi,
        pixel_format="rgb8",
        lasers=(line, LaserLine("right", "auto")),
        record=np.repeat(np.arange(RECORDS), 2),
        laser=np.tile([0, 1], RECORDS),
    )
    with pytest.raises(CaptureError, match='"left" is "auto" and cannot be learned: it is never lit alone'):
        reconstruct(together, scanner, settings=ReconstructSettings(min_range_m=1.0, max_range_m=4.0))


# Mono and Bayer in the sweeps above.
@pytest.mark.more
@pytest.mark.parametrize(
    "pixel_format",
    [pytest.param("mono8", marks=pytest.mark.slow), "rgb8", pytest.param("bayer_grbg8", marks=pytest.mark.slow)],
)
def test_a_stack_of_frames(centres, pixel_format):
    on, off = frames(stripe(*centres[0], 60.0, WIDTH), ["blue"] * RECORDS, pixel_format)
    given, learned = (
        extract_stripes(on, off, pixel_format=pixel_format, line=LaserLine(colour=colour))
        for colour in ("blue", "auto")
    )
    np.testing.assert_array_equal(learned.u, given.u)
    assert np.mean(given.valid[:, 1::2]) > 0.95


def test_a_capture_of_a_board(centres, tmp_path):
    on, off = frames(stripe(*centres[0], 60.0, WIDTH), ["green"] * RECORDS, "rgb8")
    header = CaptureHeader(
        kind="calibration",
        camera={"width": WIDTH, "height": HEIGHT, "pixel_format": "rgb8"},
        laser=[{"name": "left", "colour": "auto"}, {"name": "right", "colour": "auto"}, {"name": "third"}],
        board={"type": "chessboard", "columns": 5, "rows": 4, "square_mm": 30.0},
    )
    with create_capture(tmp_path / "boards", header) as writer:
        for k in range(RECORDS):
            writer.append(angle_deg=float(k), on=on[k], off=off[k], placement=0, lasers=["left"])
    capture = open_capture(tmp_path / "boards")
    assert capture.lasers[0].colour == "auto", "what the header says is kept"
    # What is lit nowhere stays open.
    assert [line.colour for line in learn_colours(capture)] == ["green", "auto", "red"]
