"""Stripes fitted through the print, in a world that is written apart: at their noise, whatever ink is under them."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from jaxscan.geometry import BoardPicture, Charuco, Chessboard, Pinhole
from jaxscan.observation import FoundStripe, SolvedRig
from jaxscan.observation.board_stripes import with_speckle
from jaxscan.observation.printed import Sight, fit_on_print
from jaxscan.observation.printed.lattice import Lattice
from jaxscan.observation.printed.room_light import fit_room_light
from jaxscan.observation.printed.windows import Windows, cut_windows
from jaxscan.stripes import FrameFormat, LaserLine, NoiseModel, Sites
from jaxscan.vision import draw_print

from . import printed_scene as scene


BOARD = Charuco(7, 5, 0.066, 0.066 * 0.75, "DICT_4X4_50")
CHESS = Chessboard(7, 5, 0.05)
NOISE = NoiseModel(scene.READ_DN, scene.ELECTRONS_PER_DN, scene.BLACK_DN)
SEEDS = range(1, 7)


def fit(seen, board=BOARD, *, picture=None, pose=None, columns=False, noise=NOISE):
    """The fit of one record, started from centres that err by 0.3 px."""
    # On its side x and y of image and camera are exchanged, so the board is seen mirrored.
    turned, axis = (np.s_[::-1], "columns") if columns else (np.s_[:], "rows")
    size, pose = scene.SIZE[turned], seen.pose if pose is None else pose
    numbers = scene.FOCAL, scene.FOCAL, *((one - 1) / 2 for one in size)
    camera = Pinhole(*numbers, np.zeros(5), *size)
    picture = BoardPicture.of(board, draw_print(board)) if picture is None else picture
    rig = SolvedRig(camera, None, board, np.zeros(3), pose[None], np.ones(1, bool), 0.05, picture=picture)
    pose = np.eye(4)[[1, 0, 2, 3]] @ pose if columns else pose
    lines = len(seen.u)
    raw = seen.u + 0.3 * np.random.default_rng(0).normal(size=lines)
    stripe = FoundStripe(raw, np.full(lines, 0.1), np.full(lines, 1.3), seen.inside, axis)
    sight = Sight(seen.on, seen.off, 1.0, Sites(), FrameFormat(), LaserLine(stripe_axis=axis), noise)
    return fit_on_print(stripe, seen.inside, sight, rig, pose)


def pooled(seen, found):
    """Errors, stated sigmas and contrast classes of all records together."""
    parts = [
        (f.u[f.valid] - s.u[f.valid], f.sigma[f.valid], f.contrast[f.valid]) for s, f in zip(seen, found, strict=True)
    ]
    return (np.concatenate(part) for part in zip(*parts, strict=True))


@pytest.fixture(scope="module")
def marked():
    seen = [scene.look(scene.markers(7, 5, 0.75), 0.066, seed) for seed in SEEDS]
    return seen, [fit(one) for one in seen]


@pytest.mark.more
def test_as_good_as_stated_whatever_ink_is_under_the_stripe(marked):
    seen, found = marked
    error, sigma, contrast = pooled(seen, found)
    assert len(error) > 0.95 * sum(one.inside.sum() for one in seen)
    # Of an even share of paper, weak edges and strong ones; most points of a board of markers lie at strong ones.
    counts = np.bincount(contrast, minlength=3)
    assert counts.min() > 60 and counts[2] > 0.5 * len(error)
    for number in range(3):
        z = (error / sigma)[contrast == number]
        # The size of z is known to 1 / sqrt(2 n): 0.08 of the smallest class.
        assert 0.9 - 0.08 < np.sqrt(np.mean(z**2)) < 1.15, number
        assert abs(z.mean()) < 3.0 / np.sqrt(len(z)), number
    # Speckle and photons of neighbours are independent; errors of the print would be shared.
    z = error / sigma
    assert abs(np.mean(z[1:] * z[:-1])) < 0.1


def test_a_stripe_without_noise_shows_what_the_model_lacks():
    seen = [scene.look(scene.markers(7, 5, 0.75), 0.066, seed, noisy=False) for seed in SEEDS[:3]]
    error, _, contrast = pooled(seen, [fit(one) for one in seen])
    # Rounding of levels is worth 0.01 px on paper, several times that on ink, and OpenCV's markers are off by up to
    # 1/168 of a square. Without the print the same points err by 0.3 px.
    assert np.sqrt(np.mean(error[contrast == 2] ** 2)) < 0.03
    assert abs(error.mean()) < 0.005


def test_an_error_of_the_pose_is_found_or_stated():
    """The print is placed by the laser-off image too; the error that is left is in sigma."""
    seen = [scene.look(scene.markers(7, 5, 0.75), 0.066, seed) for seed in SEEDS[:4]]
    moved = []
    for one in seen:
        pose = one.pose.copy()
        pose[:2, 3] += np.array([0.25, -0.2]) * pose[2, 3] / scene.FOCAL
        moved.append(fit(one, pose=pose))
    error, sigma, contrast = pooled(seen, moved)
    z = (error / sigma)[contrast == 2]
    assert np.sqrt(np.mean(z**2)) < 1.15


def test_a_chessboard_of_either_colour():
    low = (-0.05, -0.05)
    for picture in (scene.squares(8, 6), 1.0 - scene.squares(8, 6)):
        seen = [scene.look(picture, 0.05, seed, low=low) for seed in SEEDS[:3]]
        error, sigma, _ = pooled(seen, [fit(one, CHESS) for one in seen])
        # Of 500 points the size is known to 0.03.
        assert 0.85 < np.sqrt(np.mean(np.square(error / sigma))) < 1.15


def test_columns_are_rows_of_the_transposed_picture(marked):
    seen, found = marked
    rows, columns = found[0], fit(seen[0], columns=True)
    np.testing.assert_array_equal(rows.valid, columns.valid)
    # The same numbers but for their rounding in single precision.
    np.testing.assert_allclose(rows.u[rows.valid], columns.u[rows.valid], atol=2e-3)
    np.testing.assert_allclose(rows.sigma[rows.valid], columns.sigma[rows.valid], rtol=2e-2)


def test_a_board_of_other_print_is_not_forced_upon_the_picture(marked):
    half = Charuco(14, 10, 0.033, 0.033 * 0.75, "DICT_6X6_250")
    assert all(fit(one, half) is None for one in marked[0][:3])


def test_markers_that_are_not_there_cost_their_lines_alone():
    picture = draw_print(BOARD).copy()
    seen = [scene.look(scene.markers(7, 5, 0.75), 0.066, seed) for seed in SEEDS[:3]]
    # A part of the middle row is believed to be paper.
    picture[2 * 160 + 30 : 2 * 160 + 100] = 1.0
    found = [fit(one, picture=BoardPicture.of(BOARD, picture)) for one in seen]
    error, sigma, _ = pooled(seen, found)
    assert len(error) < 0.95 * sum(one.inside.sum() for one in seen)
    assert np.sqrt(np.mean(np.square(error / sigma))) < 1.2


def test_lines_that_something_covers_are_left_out(marked):
    seen, found = marked
    one = seen[1]
    line = np.flatnonzero(one.inside)
    hidden = line[len(line) // 2 : len(line) // 2 + 25]
    off, on = one.off.copy(), one.on.copy()
    # A cable across the stripe, of an even grey.
    for frame in (off, on):
        frame[hidden] = np.where(frame is on, 40, 24) + np.random.default_rng(0).integers(-2, 3, frame[hidden].shape)
    covered = fit(one._replace(on=on, off=off))
    assert not covered.valid[hidden[2:-2]].any()
    clear = np.setdiff1d(line, np.arange(hidden[0] - 3, hidden[-1] + 4))
    assert covered.valid[clear].mean() > 0.95
    both = clear[covered.valid[clear] & found[1].valid[clear]]
    moved = (covered.u - found[1].u)[both] / found[1].sigma[both]
    assert np.sqrt(np.mean(moved**2)) < 0.3


def test_without_room_light_the_print_is_where_the_pose_has_it():
    """A dark laser-off image shows no print: pose and stripe alone then say where it lies."""
    seen = [scene.look(scene.markers(7, 5, 0.75), 0.066, seed, room_dn=0.0) for seed in SEEDS[:3]]
    error, sigma, contrast = pooled(seen, [fit(one) for one in seen])
    z = (error / sigma)[contrast == 2]
    assert len(z) > 200 and np.sqrt(np.mean(z**2)) < 1.2


def test_the_drawn_print_is_that_of_opencv():
    drawn, opencv = draw_print(BOARD), scene.markers(7, 5, 0.75)
    assert drawn.shape == (5 * 160, 7 * 160)
    shown = cv2.resize(opencv, drawn.shape[::-1], interpolation=cv2.INTER_AREA)
    # OpenCV rounds edges to 1/168 of a square, and about a tenth of the elements lie at an edge.
    assert np.mean(np.abs(drawn - shown)) < 0.01


@pytest.mark.parametrize("paper", [0.0, 1.0])
def test_a_print_of_one_colour_shows_no_place_and_is_not_exchanged(paper):
    """Level and brightness of the print are then one number: no coin toss decides that colours are exchanged."""
    for seed in SEEDS:
        random = np.random.default_rng(seed)
        dark = 40.0 + random.normal(0.0, 2.0, (120, 17))
        windows = Windows(
            dark,
            np.full_like(dark, 8.0),
            dark,
            np.full_like(dark, 4.0),
            np.ones(dark.shape, bool),
            8.0,
            np.arange(-8.0, 9),
        )
        lattice = Lattice.around(8, 1, 0.1)
        shape = len(lattice.across), 120, len(lattice.along)
        room = fit_room_light(windows, np.full(shape, paper, np.float32), lattice)
        assert not room.exchanged
        assert room.explained.mean() > 0.95
        # Nothing but the expectation is known of blur and place.
        assert (room.shared.across, room.shared.along) == (0.0, 0.0)
        np.testing.assert_allclose(np.sqrt(np.diag(room.covariance)), [0.5, 0.2, 0.2])


def test_room_light_shows_where_the_print_lies():
    """An edge across the window, drawn aside from where it is predicted, in light that falls off."""
    random, lattice = np.random.default_rng(0), Lattice.around(8, 1, 0.0)
    lines, pixels = np.arange(120.0), lattice.pixels
    # Edges at several places, slanted to either side, so that both directions are seen.

    def at(u, v, line):
        edge = 3.0 * np.sin(line / 9.0) + np.where(line % 2 > 0, 0.4, -0.4) * v
        return (u > edge).astype(np.float32)

    u, v = lattice.across[:, None, None], lattice.along[None, None, :]
    paper = at(u, v, lines[None, :, None])
    true = (0.12, -0.1)
    # Rendered apart, by points 0.1 px apart that the lens blurs by 0.75 px before the pixel collects them.
    fine = (np.arange(-35, 36)) / 10.0
    weight = np.convolve(np.exp(-0.5 * (fine / 0.75) ** 2), [0.05, *[0.1] * 9, 0.05], "same")
    weight /= weight.sum()
    seen = np.zeros((120, len(pixels)))
    for share_down, down in zip(weight, fine, strict=True):
        for share, across in zip(weight, fine, strict=True):
            place = pixels[None] + across - true[0], down - true[1]
            seen += share * share_down * at(*place, lines[:, None])
    dark = 8.0 + 60.0 * (1 + 0.2 * np.linspace(-1, 1, 120)[:, None]) * seen + random.normal(0.0, 1.0, seen.shape)
    one = np.ones_like(dark)
    windows = Windows(dark, one, dark, one, one > 0, 8.0, pixels)
    for colours, exchanged in ((paper, False), (np.float32(1.0) - paper, True)):
        room = fit_room_light(windows, colours, lattice)
        assert room.exchanged == exchanged and room.explained.all()
        assert room.shared.across == pytest.approx(true[0], abs=0.02)
        assert room.shared.along == pytest.approx(true[1], abs=0.04)
        assert np.exp(room.shared.blur) == pytest.approx(0.75, abs=0.04)


@pytest.mark.more
def test_faint_stripes_are_as_good_as_stated():
    """Light of 5 to 20 DN, where the error is no longer small beside the stripe."""
    seen = [scene.look(scene.markers(7, 5, 0.75), 0.066, seed, laser_dn=30.0, room_dn=3.0) for seed in SEEDS]
    error, sigma, contrast = pooled(seen, [fit(one) for one in seen])
    assert len(error) > 400
    for number in range(3):
        z = (error / sigma)[contrast == number]
        assert 0.85 < np.sqrt(np.mean(z**2)) < 1.15, number


@pytest.mark.more
@pytest.mark.parametrize("contrast", [0.2, 0.6])
def test_speckle_is_in_the_sigmas(contrast):
    """As strong as lasers show it, with its contrast as other boards told it, or not at all."""
    seen = [scene.look(scene.markers(7, 5, 0.75), 0.066, seed, speckle=contrast) for seed in SEEDS]
    inside = sum(one.inside.sum() for one in seen)
    for known, least in ((0.0, 0.94), (contrast, 0.97)):
        error, sigma, number = pooled(seen, [fit(one, noise=replace(NOISE, speckle=known)) for one in seen])
        assert len(error) > least * inside
        assert 0.9 < np.sqrt(np.mean((error / sigma) ** 2)) < 1.15
        for kind in range(3):
            assert 0.82 < np.sqrt(np.mean((error / sigma)[number == kind] ** 2)) < 1.15, kind


@pytest.mark.more
@pytest.mark.parametrize("contrast", [0.0, 0.45])
def test_even_print_tells_the_contrast_of_speckle(contrast):
    """Edges of the print, which scatter centres and widths too, tell nothing."""
    seen = [scene.look(scene.markers(7, 5, 0.75), 0.066, seed, speckle=contrast) for seed in range(1, 9)]
    on, off = (np.stack(frames) for frames in zip(*((one.on, one.off) for one in seen), strict=True))
    found = with_speckle(on, off, FrameFormat(), LaserLine(), NOISE)
    assert found.speckle == pytest.approx(contrast, rel=0.25) and replace(found, speckle=0.0) == NOISE


def test_brighter_lamps_bring_photons_and_no_read_noise():
    noise, ratio = NoiseModel(2.0, 4.0, 10.0), 1.5
    off = np.full((1, 40), 50, np.uint8)
    sight = Sight(np.full((1, 40), 70, np.uint8), off, ratio, Sites(), FrameFormat(), LaserLine(), noise)
    windows, _ = cut_windows(sight, np.zeros(1, int), np.full(1, 20.0), 3)
    frame, light = 2.0**2 + 1 / 12, 40.0 / 4.0
    np.testing.assert_allclose(windows.variance, frame + ratio * light + ratio**2 * (frame + light))
