"""Normals on closed-form grids: exact on planes, honest at edges, tolerant of holes."""

import numpy as np
import pytest

from jaxscan.reconstruction import grid_normals


STEPS = {"line_step": 1e-3, "profile_step": 2e-3}
PROFILES, LINES = 70, 40


def grid(depth):
    """Points on rays of constant steps from the origin, where the surface x = depth(y/x, z/x) is."""
    a = STEPS["profile_step"] * (np.arange(PROFILES) - PROFILES / 2)[:, None]
    e = STEPS["line_step"] * (np.arange(LINES) - LINES / 2)[None, :]
    x = depth(a, e) * np.ones((PROFILES, LINES))
    return np.stack([x, a * x, e * x], -1).astype(np.float32)


def normals_of(xyz, valid=None, sigma=1e-4):
    valid = np.ones(xyz.shape[:2], bool) if valid is None else valid
    return grid_normals(
        xyz, np.full(valid.shape, sigma, np.float32), valid, np.zeros((len(xyz), 3), np.float32), **STEPS
    )


def test_slanted_plane_with_holes():
    # x + 0.8 y + 0.3 z = 2; every second line missing, as with a Bayer mosaic, and holes at random.
    xyz = grid(lambda a, e: 2.0 / (1.0 + 0.8 * a + 0.3 * e))
    valid = np.random.default_rng(0).uniform(size=xyz.shape[:2]) > 0.3
    valid[:, 1::2] = False
    xyz[~valid] = np.nan
    normals = normals_of(np.where(valid[:, :, None], xyz, 0.0), valid)
    found = (normals != 0).any(-1)
    # Of 7 lines in the window 30 % are missing: fewer than 3 are left in 3 % of windows, and at
    # the ends of a profile, where the window is half as long, more often.
    assert found[valid].mean() > 0.9 and not found[~valid].any()
    expected = -np.array([1.0, 0.8, 0.3]) / np.linalg.norm([1.0, 0.8, 0.3])
    # Rounding of float32 at 2 m over a window of 1 cm: 1e-7 * 2 / 0.01, times a few.
    np.testing.assert_allclose(normals[found], np.broadcast_to(expected, normals[found].shape), atol=3e-4)


def test_step_does_not_bend_the_wall_behind():
    xyz = grid(lambda a, e: np.where(a < 0, 2.0, 1.5) + 0 * e)
    normals = normals_of(xyz)
    # Half a metre is no slope: on both sides the normal is that of its own plane.
    np.testing.assert_allclose(normals, np.broadcast_to([-1.0, 0.0, 0.0], normals.shape), atol=1e-3)


def test_blocks_leave_no_seams():
    xyz = grid(lambda a, e: 2.0 + 0.3 * a + a * e)
    whole = normals_of(xyz)
    part = grid_normals(
        xyz[10:],
        np.full((PROFILES - 10, LINES), 1e-4, np.float32),
        np.ones((PROFILES - 10, LINES), bool),
        np.zeros((PROFILES - 10, 3), np.float32),
        **STEPS,
    )
    # Away from its own ends the part has the same neighbours.
    np.testing.assert_allclose(part[4:], whole[14:], atol=1e-6)


def test_noise_is_averaged():
    rng = np.random.default_rng(0)
    xyz = grid(lambda a, e: 2.0 + 0.001 * rng.normal(size=(PROFILES, LINES)))
    angle = np.degrees(np.arccos(np.clip(-normals_of(xyz, sigma=1e-3)[8:-8, 8:-8, 0], -1, 1)))
    # A slope over n points has the error sigma sqrt(12 / n^3) per step: 13 lines 2 mm apart averaged
    # over 7 profiles, 7 profiles 4 mm apart averaged over 13 lines: 0.80 and 0.74, together 1.09
    # degrees. Neighbours share their noise, so few of the 1300 values are independent.
    assert np.sqrt(np.mean(angle**2)) == pytest.approx(1.09, rel=0.1)


def test_lonely_points_have_none():
    xyz = grid(lambda a, e: 2.0 + 0 * a)
    valid = np.zeros(xyz.shape[:2], bool)
    valid[::20, ::20] = True
    assert not normals_of(xyz, valid).any()
    valid[:] = False
    valid[30] = True
    assert not normals_of(xyz, valid).any()
