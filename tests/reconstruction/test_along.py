"""Clouds whose points use their neighbours along the stripe: kept fields of rows, and settings without effect."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.api import reconstruct_capture
from jaxscan.files.capture import Capture, load_stripes
from jaxscan.geometry.rigid import invert, transform
from jaxscan.reconstruction import SMOOTHED, ReconstructSettings, Sweep, extract, reconstruct
from jaxscan.stripes import StripeSettings

from .conftest import small_scanner, stripes_on_plane
from .rendered import pairs, stripe


WIDTH, HEIGHT, RECORDS = 192, 96, 6
NORMAL = np.array([0.9, 0.4, 0.17]) / np.linalg.norm([0.9, 0.4, 0.17])
EDGE = ReconstructSettings(min_range_m=1.0, max_range_m=4.0, chunk_records=3)
ROWS = replace(EDGE, smooth="off")
PHI = np.radians(np.arange(RECORDS, dtype=float))


@pytest.fixture(scope="module")
def scanner():
    return small_scanner(width=WIDTH, height=HEIGHT, covariance=True)


@pytest.fixture(scope="module")
def truth(scanner):
    return stripes_on_plane(scanner, PHI, NORMAL, 1.5)


@pytest.fixture(scope="module")
def sweep(truth):
    return Sweep(*pairs(stripe(*truth, 25.0, WIDTH)), PHI)


@pytest.fixture(scope="module")
def stripes(sweep, scanner):
    return extract(sweep, scanner, settings=EDGE).stripes


@pytest.fixture(scope="module")
def clouds(sweep, scanner, stripes):
    return tuple(reconstruct(sweep, scanner, stripes=stripes, settings=one) for one in (EDGE, ROWS))


def off_plane(cloud):
    return cloud.xyz[cloud.valid] @ NORMAL - 1.5


@pytest.mark.more
def test_points_are_better_than_their_rows(clouds):
    smooth, rows = clouds
    np.testing.assert_array_equal(smooth.valid, rows.valid)
    assert np.std(off_plane(smooth)) < 0.6 * np.std(off_plane(rows))
    assert np.median(smooth.sigma_random[smooth.valid]) < 0.6 * np.median(rows.sigma_random[rows.valid])
    # So are their normals.
    tilt = [np.linalg.norm(np.cross(one.normals[one.valid], NORMAL), axis=1).mean() for one in clouds]
    assert tilt[0] < 0.8 * tilt[1]


@pytest.mark.more
def test_without_smoothing_nothing_is_shared(clouds):
    assert all(getattr(clouds[1], name) is None and getattr(clouds[0], name) is not None for name in SMOOTHED)
    assert all(not getattr(clouds[0], name)[~clouds[0].valid].any() for name in SMOOTHED)
    assert (clouds[0].shared_lines[clouds[0].valid] >= 1).all()


def test_the_centre_of_the_row_comes_back(clouds, scanner):
    """A point seen by its camera is the smoothed centre; `shift_px` further is the point of the row alone."""
    smooth, rows = clouds
    exact = scanner.as_dtype(jnp.float64)
    for profile, line in [(0, 20), (2, 50), (5, 70)]:
        assert smooth.valid[profile, line] and smooth.shift_px[profile, line] != 0
        phi, laser = jnp.asarray(smooth.angle[profile]), jnp.asarray(0, jnp.int32)
        p_cam = transform(invert(exact.pose(phi)), jnp.asarray(smooth.xyz[profile, line], jnp.float64))
        q = exact.camera.project(p_cam)
        # Float32 of a point at 1.5 m.
        assert float(q[1]) == pytest.approx(line, abs=1e-3)
        row, _ = exact.point(q + jnp.asarray([smooth.shift_px[profile, line], 0.0], jnp.float64), laser, phi)
        np.testing.assert_allclose(row, rows.xyz[profile, line], atol=2e-5)


def test_the_sigma_of_the_row_is_kept(clouds, stripes):
    smooth, rows = clouds
    # Slopes are those at centres some hundredths of a pixel apart; scatter may widen a class of amplitudes a little.
    ratio = smooth.sigma_row[smooth.valid] / rows.sigma_random[smooth.valid]
    assert 0.95 < ratio.min() and ratio.max() < 1.15
    assert np.median(ratio) == pytest.approx(1.0, abs=0.06)


def test_frames_give_the_same(sweep, scanner, clouds):
    again = reconstruct(sweep, scanner, settings=EDGE)
    for name in ("xyz", "sigma_random", *SMOOTHED):
        np.testing.assert_array_equal(getattr(again, name), getattr(clouds[0], name), err_msg=name)


@pytest.mark.more
def test_several_candidates_of_a_line_are_no_neighbours(sweep, scanner):
    settings = replace(EDGE, stripes=StripeSettings(choice="all"))
    one, other = (reconstruct(sweep, scanner, settings=replace(settings, smooth=how)) for how in ("edge", "off"))
    np.testing.assert_array_equal(one.xyz, other.xyz)
    assert one.shared_lines is None


def test_lasers_and_records_are_smoothed_apart(sweep, scanner, stripes, clouds):
    """Profiles in any order give the same points."""
    order = np.array([3, 0, 5, 1, 4, 2])
    turned = Sweep(sweep.on[order], sweep.off[order], PHI[order])
    mixed = type(stripes)(**{name: field[order] for name, field in vars(stripes).items()})
    cloud = reconstruct(turned, scanner, stripes=mixed, settings=EDGE)
    np.testing.assert_allclose(cloud.xyz, clouds[0].xyz[order], atol=1e-6)


def test_kept_stripes_are_those_of_the_rows(sweep, scanner, stripes, tmp_path):
    from jaxscan.files.capture import CaptureHeader, cache_path, open_capture
    from jaxscan.files.recording import create_capture

    camera = {"width": WIDTH, "height": HEIGHT, "pixel_format": "mono8"}
    with create_capture(tmp_path / "room", CaptureHeader(kind="sweep", camera=camera, laser=[{"name": "left"}])) as to:
        for on, off, phi in zip(sweep.on, sweep.off, PHI, strict=True):
            to.append(angle_deg=float(np.degrees(phi)), on=on, off=off)
    capture: Capture = open_capture(tmp_path / "room")
    smooth = reconstruct_capture(capture, scanner, settings=EDGE)
    kept, _ = load_stripes(cache_path(capture))
    np.testing.assert_array_equal(kept["u"], stripes.u)
    # The same stripes serve whether or not they are smoothed.
    rows = reconstruct_capture(capture, scanner, settings=ROWS)
    assert smooth.kept and rows.from_cache and rows.cloud.shared_lines is None
    assert np.std(off_plane(smooth.cloud)) < 0.6 * np.std(off_plane(rows.cloud))


def test_an_unknown_way_is_refused():
    settings = ReconstructSettings()
    # Annotations are checked in tests, and not where a program of somebody else calls.
    object.__setattr__(settings, "smooth", "blur")
    with pytest.raises(ValueError, match='"off" or "edge"'):
        settings.__post_init__()
