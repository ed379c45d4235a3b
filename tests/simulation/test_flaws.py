"""Dark and soft corners, pixels that differ, curves, JPEG, and prints that are blurred and shine."""

from functools import partial

import numpy as np
import pytest
from scipy.special import erf

from jaxscan.simulation import (
    BoardsSpec,
    LightSpec,
    SeenBoard,
    SensorSpec,
    SimulationConfig,
    develop,
    expect_record,
    expose,
    make_print,
    make_rig,
    take_frame,
)
from jaxscan.simulation.rig import Motion, project, rodrigues
from jaxscan.simulation.scene import Material, Mesh, build_scene
from tests.simulation import plain
from tests.simulation.plain import CX, WIDTH, F, scene_of, wall


HEIGHT, CY = 180, 90.3


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.Generator(np.random.SFC64(seed))


def config(**changes) -> SimulationConfig:
    return plain.config(HEIGHT, {"waist_mm": 2.0}, **changes)


def before_a_wall(c: SimulationConfig, z: float = 2.0, board: SeenBoard | None = None):
    """A record of a grey wall that faces the camera."""
    return expect_record(make_rig(c), scene_of(partial(wall, z=z)), 0.0, board=board)


def test_corners_are_darker_by_the_square_of_their_distance():
    plain, dark = (before_a_wall(config(sensor=SensorSpec(vignetting=v))) for v in (0.0, 0.4))
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    r2 = (u - CX) ** 2 + (v - CY) ** 2
    share = 1 - 0.4 * r2 / r2.max()
    np.testing.assert_allclose(dark.off, plain.off * share, rtol=1e-5)
    np.testing.assert_allclose(dark.laser, plain.laser * share, rtol=1e-5, atol=1e-6)
    # The true amplitude is that of the light that arrives.
    assert (dark.truth.amplitude < plain.truth.amplitude).all()
    np.testing.assert_array_equal(dark.truth.u, plain.truth.u)


def spread(image: np.ndarray) -> np.ndarray:
    """Variance of the light in every row [px^2]."""
    u = np.arange(image.shape[1])
    mean = image @ u / image.sum(1)
    return (image * (u - mean[:, None]) ** 2).sum(1) / image.sum(1)


@pytest.mark.parametrize(("edge", "defocus", "z"), [(0.0, 0.0, 2.0), (0.6, 0.0, 2.0), (0.0, 1.5, 1.0), (0.4, 1.0, 3.0)])
def test_blur_varies_over_the_field_and_with_distance(edge, defocus, z):
    sensor = SensorSpec(psf_px=0.9, psf_edge=edge, defocus_px_m=defocus, focus_m=2.0)
    image = before_a_wall(config(sensor=sensor), z).laser.astype(float)
    u = image @ np.arange(WIDTH) / image.sum(1)
    r2 = (u - CX) ** 2 + (np.arange(HEIGHT) - CY) ** 2
    farthest = max((CX - a) ** 2 + (CY - b) ** 2 for a in (0, WIDTH - 1) for b in (0, HEIGHT - 1))
    psf = 0.9 * (1 + edge * r2 / farthest)
    # The sheet cuts the wall under its own slant, and is as thick as at its distance from the laser.
    normal = np.array([1 / 0.3, 0, 1 / 2.0])
    normal /= np.linalg.norm(normal)
    legs = np.stack([0.3 * (1 - z / 2) - 0.3 + 0 * u, (np.arange(HEIGHT) - CY) * z / F, z + 0 * u])
    thick = np.hypot(0.002, 0.0003 * (np.linalg.norm(legs, axis=0) - 2.0))
    expected = psf**2 + (defocus * (1 / z - 0.5)) ** 2 + (thick / normal[0] * F / z) ** 2 + 1 / 12
    inside = slice(8, -8)  # light from beyond the border is unknown
    np.testing.assert_allclose(spread(image)[inside], expected[inside], rtol=0.01)


def test_the_room_is_soft_in_the_corners_too():
    """A step between two walls of one distance is as wide as the blur there."""
    mesh = Mesh()
    for right, grey in ((0.0, 0.2), (9.0, 0.8)):
        start = np.array([2.0, -right + 9.0, -9.0])
        mesh.quad(start, np.array([0, -9.0, 0]), np.array([0, 0, 18.0]), Material(((grey,) * 3,)))
    scene = build_scene(mesh, np.array([0, 0, 2.0]), 2.0, shadows=False)
    widths = []
    for edge in (0.0, 1.0):
        rig = make_rig(config(sensor=SensorSpec(psf_px=0.8, psf_edge=edge)))
        off = expect_record(rig, scene, 0.0).off[:, 69:91].astype(float)
        widths.append(spread(np.abs(np.diff(off, axis=1))))
    far = (np.arange(HEIGHT) - CY) ** 2 / ((WIDTH - 1 - CX) ** 2 + CY**2)
    more = 0.8**2 * ((1 + far) ** 2 - 1)
    # Five passes of three pixels stand for a Gaussian: some hundredths of a squared pixel.
    np.testing.assert_allclose((widths[1] - widths[0])[8:-8], more[8:-8], atol=0.04)


def test_pixels_differ_in_gain_and_offset_and_are_the_same_in_all_frames():
    sensor = SensorSpec(gain_spread=0.02, offset_spread_dn=1.5, read_dn=0.5, black_dn=20.0)
    c = config(sensor=sensor)
    source = rng()

    def mean(level: float) -> np.ndarray:
        light = np.full((HEIGHT, WIDTH), level, np.float32)
        return np.mean([take_frame(light, c, source) for _ in range(60)], axis=0)

    dark, bright = mean(0.0), mean(150.0)
    # 28,800 pixels: five standard errors of a standard deviation are 2 %; noise that 60 frames leave: 2 %.
    assert dark.std() == pytest.approx(1.5, rel=0.04)
    assert (bright - dark).std() / 150 == pytest.approx(0.02, rel=0.06)
    assert dark.mean() == pytest.approx(20, abs=0.06) and bright.mean() == pytest.approx(170, abs=0.15)
    # Another seed is another camera.
    other = take_frame(np.zeros((HEIGHT, WIDTH), np.float32), c.model_copy(update={"seed": 5}), source)
    assert abs(np.corrcoef(dark.ravel(), other.ravel().astype(float))[0, 1]) < 0.03


def test_some_pixels_are_hot():
    c = config(sensor=SensorSpec(hot_pixels=0.01, hot_dn=60.0, read_dn=0.3))
    frames = [take_frame(np.zeros((HEIGHT, WIDTH), np.float32), c, rng(k)).astype(float) for k in range(2)]
    hot = frames[0] > 10
    # A share exp(-10 / 60) of 288 pixels; five standard errors.
    assert hot.sum() == pytest.approx(288 * np.exp(-1 / 6), abs=5 * 288**0.5)
    assert (frames[1][hot] > 4).all()


def test_a_lamp_flickers_from_frame_to_frame():
    c = config(light=LightSpec(shadows=False, flicker=0.05), sensor=SensorSpec(read_dn=0.1))
    record = before_a_wall(c)
    source = rng(2)
    pairs = [develop(record, c, source) for _ in range(150)]
    level = np.array([[image[:, -30:].mean() for image in (pair.on, pair.off)] for pair in pairs])
    level /= record.off[:, -30:].mean()
    # 300 values: five standard errors of a standard deviation are 20 %.
    assert level.std() == pytest.approx(0.05, rel=0.2)
    assert abs(np.corrcoef(level.T)[0, 1]) < 0.4


def test_the_gamma_curve_is_a_power():
    image = expose(
        np.full(2000, 0.18 * 255, np.float32),
        SensorSpec(response="gamma 2.2", read_dn=0.1, electrons_per_dn=1e4),
        rng(),
    )
    assert image.mean() == pytest.approx(255 * 0.18 ** (1 / 2.2), abs=0.2)


@pytest.mark.parametrize("pixel_format", ["mono8", "rgb8"])
def test_jpegs_lose_what_their_quality_says(pixel_format):
    light = rng().uniform(60, 70, (HEIGHT, WIDTH) + ((3,) if pixel_format == "rgb8" else ())).astype(np.float32)

    def image(quality):
        c = config(sensor=SensorSpec(pixel_format=pixel_format, jpeg_quality=quality))
        return take_frame(light, c, rng(1)).astype(float)

    plain = image(None)
    errors = [np.abs(image(quality) - plain).mean() for quality in (95, 75, 30)]
    assert 0 < errors[0] < errors[1] < errors[2]
    assert image(95).shape == plain.shape


def test_a_print_has_its_own_ink_paper_and_blur():
    spec = BoardsSpec(
        type="chessboard", columns=7, rows=5, square_mm=30.0, ink=0.15, paper=0.7, print_blur_mm=0.8, border_mm=15.0
    )
    y, x = np.mgrid[: spec.rows + 1, : spec.columns + 1]
    texture = np.kron(((x + y) % 2 * 255).astype(np.uint8), np.ones((60, 60), np.uint8))
    board = SeenBoard(make_print(spec, texture), Motion(np.eye(3), np.array([0.0, 0.0, -1.0])))
    # From the middle of a square over its edge, half way between corners.
    x = np.linspace(-0.012, 0.012, 97)
    corner = spec.board().corners()[0, :2]
    albedo = board.albedo(corner[0] + x, np.full(97, corner[1] + 0.015))
    edge = erf(x / np.hypot(0.0008, 0.0005 / 12**0.5 * 1.5) / 2**0.5)
    sign = np.sign(albedo[-1] - albedo[0])
    np.testing.assert_allclose(albedo, 0.425 + sign * 0.275 * edge, atol=0.01)


def test_lamination_shows_the_lamp_where_a_mirror_would():
    spec = BoardsSpec(type="chessboard", columns=7, rows=5, square_mm=150.0)
    images = []
    motion = Motion(rodrigues(np.array([1.0, 0.0, 0.0]), np.deg2rad(-25)), np.array([-0.45, -0.3, 1.6]))
    lamp = np.array([0.0, 0.0, 2.0])
    for gloss in (0.0, 0.5):
        c = config(boards=spec.model_copy(update={"gloss": gloss, "gloss_deg": 4.0}))
        texture = np.full((60 * (spec.rows + 1), 60 * (spec.columns + 1)), 255, np.uint8)
        board = SeenBoard(make_print(c.boards, texture), motion.inverse())
        record = before_a_wall(c, 5.0, board)
        images.append(record.off.astype(float))
        turned = make_rig(c).pose(0.0).inverse().apply(lamp)
    shine = images[1] - images[0]
    # The lamp's picture behind the board's plane, seen through it.
    normal = motion.rotation[:, 2]
    mirrored = turned - 2 * (normal @ (turned - motion.translation)) * normal
    u, v = project(c.camera, mirrored[None])
    row, column = np.unravel_index(shine.argmax(), shine.shape)
    assert abs(column - u[0]) < 3 and abs(row - v[0]) < 3
    assert shine.min() > -1e-3 and shine.max() > 5
    # Four degrees of the bisector are eight of the view: beyond three such widths is nothing.
    away = np.hypot(*(np.mgrid[:HEIGHT, :WIDTH] - np.array([v[0], u[0]])[:, None, None])) > F * np.tan(np.deg2rad(26))
    assert shine[away].max(initial=0) < 0.02 * shine.max()


def test_lamination_shines_in_the_laser_s_light():
    """A board that faces the bisector of laser and view is brighter; one that is tilted is not."""
    for tilt, brighter in ((-4.0, True), (30.0, False)):
        peaks = []
        for gloss in (0.0, 0.4):
            spec = BoardsSpec(type="chessboard", columns=7, rows=5, square_mm=60.0, gloss=gloss, gloss_deg=5.0)
            c = config(boards=spec)
            texture = np.full((60 * (spec.rows + 1), 60 * (spec.columns + 1)), 255, np.uint8)
            turn = rodrigues(np.array([0.0, 1.0, 0.0]), np.deg2rad(tilt))
            middle = np.append(spec.board().outline().mean(0), 0)
            place = np.array([0.05, 0.0, 1.6]) - turn @ middle
            record = before_a_wall(c, 5.0, SeenBoard(make_print(spec, texture), Motion(turn, place).inverse()))
            peaks.append(record.laser[HEIGHT // 2].max())
        assert (peaks[1] > 1.2 * peaks[0]) == brighter
