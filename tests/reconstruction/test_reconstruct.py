"""Whole sweeps from known stripes: exactness, chunks, lasers, colour, refusals."""

import subprocess
import sys

import jax
import numpy as np
import pytest

from jaxscan.errors import CalibrationError, CaptureError
from jaxscan.geometry import Scanner
from jaxscan.reconstruction import PointCloud, ReconstructSettings, Sweep, reconstruct
from jaxscan.stripes import LaserLine, NoiseModel

from .conftest import flat_stripes, small_scanner, stripes_on_plane


WIDTH, HEIGHT = 96, 64
SETTINGS = ReconstructSettings(chunk_records=7)
"""One size of chunk for all tests: few compilations."""
ROWS = ReconstructSettings(chunk_records=7, smooth="off")
"""For results that are exact only where every row is by itself."""
NORMAL = np.array([0.9, 0.4, 0.17])
NORMAL = NORMAL / np.linalg.norm(NORMAL)


@pytest.fixture(scope="module")
def frames():
    return np.random.default_rng(3).integers(0, 255, (7, HEIGHT, WIDTH), np.uint8)


def test_points_lie_on_the_plane_they_were_seen_on():
    scanner = small_scanner(covariance=True)
    phi = np.radians(np.arange(14) * 1.5)
    u, seen = stripes_on_plane(scanner, phi, NORMAL, 2.0)
    assert seen.mean() > 0.5
    stripes = flat_stripes(u.shape, u)
    stripes = type(stripes)(**{**vars(stripes), "valid": seen})
    frames = np.zeros((14, HEIGHT, WIDTH), np.uint8)
    cloud = reconstruct(Sweep(frames, frames, phi), scanner, stripes=stripes, settings=ROWS)
    np.testing.assert_array_equal(cloud.valid, seen)
    # 1e-3 px of float32 at up to 30 mm/px.
    np.testing.assert_allclose(cloud.xyz[seen] @ NORMAL, 2.0, atol=3e-5)
    # Coplanar points determine the normal exactly but for their rounding over a window of 5 cm.
    kept = (cloud.normals != 0).any(-1)
    assert kept.sum() > 0.98 * seen.sum()
    np.testing.assert_allclose(cloud.normals[kept] @ NORMAL, -1.0, atol=1e-4)
    assert not cloud.normals[~seen].any() and not cloud.xyz[~seen].any() and not cloud.rgb[~seen].any()
    assert (cloud.sigma_random[seen] > 0).all() and (cloud.sigma_systematic[seen] > 0).all()


def test_sigma_random_is_the_finite_difference():
    scanner = small_scanner()
    frames = np.zeros((1, HEIGHT, WIDTH), np.uint8)
    sweep = Sweep(frames, None, np.zeros(1))
    step = 0.25
    at = [
        reconstruct(sweep, scanner, stripes=flat_stripes((1, HEIGHT), 40.0 + x), settings=ROWS).xyz[0]
        for x in (-step, 0, step)
    ]
    cloud = reconstruct(sweep, scanner, stripes=flat_stripes((1, HEIGHT), 40.0, sigma=0.05), settings=ROWS)
    # Points move across their ray too (by range per focal length); the range is the distance
    # from the camera, which stands at a known place at angle 0.
    centre = np.asarray(scanner.pose(np.zeros(())))[:3, 3].astype(np.float32)
    below, _, above = (np.linalg.norm(points - centre, axis=-1) for points in at)
    slope = np.abs(above - below) / (2 * step)
    # Central differences over 0.25 px: third-order term below 1e-3 of the slope here.
    np.testing.assert_allclose(cloud.sigma_random[0], 0.05 * slope, rtol=2e-3)
    assert not cloud.sigma_systematic.any()


@pytest.mark.more
@pytest.mark.parametrize("chunk", [3, 100])
def test_result_does_not_depend_on_chunks(frames, chunk):
    scanner, stripes = small_scanner(), flat_stripes((7, HEIGHT), np.linspace(30, 50, HEIGHT))
    sweep = Sweep(frames, frames, np.radians(np.arange(7.0)))
    whole = reconstruct(sweep, scanner, stripes=stripes, settings=SETTINGS)
    done = []
    cloud = reconstruct(
        sweep,
        scanner,
        stripes=stripes,
        settings=ReconstructSettings(chunk_records=chunk),
        progress=lambda n, total: done.append((n, total)),
    )
    for name in ("xyz", "rgb", "normals", "sigma_random", "valid"):
        # Loops of another length may be vectorised otherwise: the last bits of float32 at 3 m, and
        # of differences over a window of a few centimetres.
        np.testing.assert_allclose(
            getattr(cloud, name).astype(float),
            getattr(whole, name).astype(float),
            rtol=1e-6,
            atol=2e-5 if name == "normals" else 1e-6,
            err_msg=name,
        )
    assert done[-1] == (7, 7) and len(done) == -(-7 // chunk)


def test_result_does_not_depend_on_x64(frames):
    scanner, stripes = small_scanner(covariance=True), flat_stripes((7, HEIGHT), np.linspace(30, 50, HEIGHT))
    sweep = Sweep(frames, frames, np.radians(np.arange(7.0)))
    double = reconstruct(sweep, scanner, stripes=stripes, settings=SETTINGS)
    with jax.enable_x64(False):
        single = reconstruct(sweep, scanner, stripes=stripes, settings=SETTINGS)
    for name in ("xyz", "normals", "sigma_random", "sigma_systematic"):
        np.testing.assert_array_equal(getattr(double, name), getattr(single, name), err_msg=name)
        assert getattr(double, name).dtype == np.float32


def test_one_compilation_for_any_number_of_records(frames, caplog):
    scanner, settings = small_scanner(), ReconstructSettings(chunk_records=3)

    def run(count, offset):
        stripes = flat_stripes((count, HEIGHT), 40.0 + offset)
        sweep = Sweep(frames[:count], frames[:count], np.radians(offset + np.arange(count)))
        reconstruct(sweep, scanner, stripes=stripes, settings=settings)

    run(7, 0.0)
    with caplog.at_level("WARNING"), jax.log_compiles():
        run(5, 0.3)
    assert not [record for record in caplog.records if "Compiling" in record.getMessage()]


def test_what_is_no_shape_compiles_nothing(frames, caplog):
    """Range limits, gate, normals and the colour that a mono camera does not see, from stripes and from frames."""
    scanner, stripes = small_scanner(), flat_stripes((7, HEIGHT), 40.0)
    lit = np.maximum(frames // 32, np.round(100 * np.exp(-0.5 * ((np.arange(WIDTH) - 40.0) / 1.5) ** 2)))
    on, off = lit.astype(np.uint8), frames // 32

    def run(colour, chunk, **settings):
        sweep = Sweep(on, off, np.radians(np.arange(7.0)), lasers=(LaserLine("left", colour),))
        settings = ReconstructSettings(chunk_records=chunk, **settings)
        reconstruct(sweep, scanner, stripes=stripes, settings=settings)
        return reconstruct(sweep, scanner, settings=settings, noise=NoiseModel())

    before = run("red", 7)
    with caplog.at_level("WARNING"), jax.log_compiles():
        after = run("green", 7, normals=False, gate=False, min_range_m=0.1, max_range_m=9.0, min_incidence=2e-3)
        assert not [record for record in caplog.records if "Compiling" in record.getMessage()]
        # Of as many records at a time: a chunk of 100 holds no more than there are.
        run("red", 100)
    assert not [record for record in caplog.records if "Compiling" in record.getMessage()]
    assert before.valid.any() and after.valid.any() and not after.normals.any()


def test_two_lasers_are_data(frames):
    both = small_scanner(lasers=2)
    lines = (LaserLine("right", "green"), LaserLine("left", "red"))
    number = np.array([0, 1, 1, 0, 1, 0, 0])
    stripes = flat_stripes((7, HEIGHT), np.where(number == 0, 60.0, 40.0)[:, None])
    phi = np.radians(np.arange(7.0))
    settings = SETTINGS
    cloud = reconstruct(
        Sweep(frames, frames, phi, lasers=lines, laser=number), both, stripes=stripes, settings=settings
    )
    # By name: the sweep's "right" is the scanner's second laser.
    np.testing.assert_array_equal(cloud.laser, 1 - number)
    for index in (0, 1):
        alone = Scanner(
            both.camera, jax.tree.map(lambda x, i=index: x[i : i + 1], both.lasers), both.turntable, laser_names=("x",)
        )
        chosen = np.flatnonzero(cloud.laser == index)
        part = jax.tree.map(lambda x, chosen=chosen: x[chosen], stripes)
        single = reconstruct(Sweep(frames[chosen], frames[chosen], phi[chosen]), alone, stripes=part, settings=SETTINGS)
        # Rounding of float32: chunks of other sizes are other vectors.
        np.testing.assert_allclose(cloud.xyz[chosen], single.xyz, atol=3e-7)
        np.testing.assert_allclose(cloud.normals[chosen], single.normals, atol=1e-4)
        np.testing.assert_array_equal(cloud.rgb[chosen], single.rgb)


@pytest.mark.more
def test_columns_turn_the_picture():
    scanner = small_scanner()
    frames = np.arange(HEIGHT * WIDTH, dtype=np.uint64).reshape(1, HEIGHT, WIDTH).astype(np.uint8)
    line = LaserLine(stripe_axis="columns")
    across = flat_stripes((1, WIDTH), np.full(WIDTH, 30.0))
    cloud = reconstruct(Sweep(frames, frames, np.zeros(1), lasers=(line,)), scanner, stripes=across, settings=SETTINGS)
    rows = flat_stripes((1, HEIGHT), 45.0)
    same = reconstruct(Sweep(frames, frames, np.zeros(1)), scanner, stripes=rows, settings=SETTINGS)
    # Column 45 at v = 30 and row 30 at u = 45 are one pixel.
    # Two compiled functions may round otherwise in float32.
    np.testing.assert_allclose(cloud.xyz[0, 45], same.xyz[0, 30], atol=1e-6)
    np.testing.assert_array_equal(cloud.rgb[0, 45], frames[0, 30, 45])
    # Along v the range has another slope.
    assert cloud.sigma_random[0, 45] < same.sigma_random[0, 30]


def test_limits(frames):
    scanner = small_scanner()
    stripes = flat_stripes((1, HEIGHT), np.linspace(2.0, 90.0, HEIGHT))
    sweep = Sweep(frames[:1], None, np.zeros(1))
    everything = reconstruct(sweep, scanner, stripes=stripes, settings=SETTINGS)
    centre = np.asarray(scanner.pose(np.zeros(())))[:3, 3]
    far = np.linalg.norm(everything.xyz[0] - centre, axis=-1)
    cut = reconstruct(sweep, scanner, stripes=stripes, settings=ReconstructSettings(min_range_m=1.0, max_range_m=3.0))
    np.testing.assert_array_equal(cut.valid[0], everything.valid[0] & (far >= 1.0) & (far <= 3.0))
    assert 0 < cut.valid.sum() < everything.valid.sum()
    with pytest.raises(ValueError, match="min_range_m < max_range_m"):
        ReconstructSettings(min_range_m=2.0, max_range_m=1.0)


def test_refusals(frames):
    scanner, stripes = small_scanner(), flat_stripes((7, HEIGHT), 40.0)
    phi = np.zeros(7)
    sweep = Sweep(frames, frames, phi)
    with pytest.raises(CaptureError, match="no records"):
        reconstruct(Sweep(frames[:0], None, phi[:0]), scanner)
    with pytest.raises(CalibrationError, match="96 x 64 px, the sweep has 96 x 60 px"):
        reconstruct(Sweep(frames[:, :60], None, phi), scanner, stripes=stripes, settings=SETTINGS)
    with pytest.raises(CalibrationError, match="carries the object, that of the calibration the scanner"):
        reconstruct(Sweep(frames, None, phi, carries="object"), scanner, stripes=stripes, settings=SETTINGS)
    two = (LaserLine("left"), LaserLine("right"))
    with pytest.raises(CalibrationError, match="2 lasers, the calibration knows 1"):
        reconstruct(Sweep(frames, None, phi, lasers=two), scanner, stripes=stripes, settings=SETTINGS)
    mixed = (LaserLine("left"), LaserLine("right", stripe_axis="columns"))
    with pytest.raises(CaptureError, match="one grid holds one kind"):
        reconstruct(Sweep(frames, None, phi, lasers=mixed), small_scanner(lasers=2), stripes=stripes)
    with pytest.raises(CaptureError, match="7 profiles of 64 lines, the sweep has 6 records"):
        reconstruct(Sweep(frames[:6], None, phi[:6]), scanner, stripes=stripes, settings=SETTINGS)
    nothing = type(stripes)(**{**vars(stripes), "valid": np.zeros((7, HEIGHT), bool)})
    with pytest.raises(CaptureError, match="No stripe was found"):
        reconstruct(sweep, scanner, stripes=nothing)
    with pytest.raises(CalibrationError, match="448 stripe centres were found, but none"):
        reconstruct(sweep, scanner, stripes=stripes, settings=ReconstructSettings(min_range_m=20.0, max_range_m=21.0))


def test_points_are_the_valid_ones_in_the_order_of_the_grid():
    valid = np.array([[True, False, True], [False, False, False], [False, True, False]])
    xyz = np.arange(27, dtype=np.float32).reshape(3, 3, 3)
    one, nothing = np.full((3, 3), 0.3, np.float32), np.zeros((3, 3, 3), np.float32)
    cloud = PointCloud(
        xyz=xyz, rgb=nothing.astype(np.uint8), intensity=one, normals=nothing, sigma_random=one, valid=valid,
        sigma_systematic=0.4 / 0.3 * one, record=np.arange(3), laser=np.array([0, 0, 1]), angle=np.zeros(3),
    )  # fmt: skip
    points = cloud.points()
    np.testing.assert_array_equal(points.xyz, xyz[valid])
    np.testing.assert_allclose(points.sigma, 0.5, rtol=1e-6)
    assert (points.step.tolist(), points.row.tolist(), points.laser.tolist()) == ([0, 0, 2], [0, 2, 1], [0, 0, 1])
    assert cloud.points(1, 3).step.tolist() == [2]


def test_what_is_no_sweep_is_refused_in_one_line():
    # A process of its own: the annotations that tests check would refuse it before.
    code = (
        "import numpy as np\nfrom jaxscan.reconstruction import plan_sweep\n"
        "try:\n    plan_sweep(np.zeros((2, 3, 4)), None, None)\nexcept TypeError as problem:\n    print(problem)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.startswith("Expected a sweep, got ndarray;") and run.stdout.count("\n") == 1


@pytest.mark.more
def test_little_is_compiled(tiny):
    """A cold reconstruction, with its notes and doubts: stripes, smoothing, points and normals, and one to spare."""
    code = (
        "import jax, sys, jaxscan\njax.config.update('jax_log_compiles', True)\n"
        "jaxscan.reconstruct_capture(jaxscan.open_capture(sys.argv[1]), jaxscan.load_scanner(sys.argv[2]), cache=False)"
    )
    command = [sys.executable, "-c", code, str(tiny.sweep), str(tiny.calibration)]
    run = subprocess.run(command, capture_output=True, text=True, check=True)
    compiled = [line for line in run.stderr.splitlines() if "Finished XLA compilation" in line]
    assert 1 < len(compiled) <= 4, compiled
