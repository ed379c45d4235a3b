"""The size of the harm: injected errors of known size are stated, and the widened sigmas cover the true errors."""

from dataclasses import replace

import numpy as np
import pytest

from jaxscan.calibration import CalibrationSettings, calibrate_observations


FREE = CalibrationSettings().free
AT_M = 1.0
"""Boards are held at 0.7 to 1.3 m: what is stated there is no extrapolation."""
SEEDS = range(3)
BEND_PX = 0.6


def settings(held=None, **others):
    return CalibrationSettings(free=tuple(block for block in FREE if block != held), at_m=AT_M, **others)


def bend(q):
    """A sheet that is bent by up to 0.6 px across, in a shape that neither plane nor bow has."""
    return BEND_PX * np.cos(np.pi * q[..., 1] / 1023.0 * 1.5)[..., None] * np.array([1.0, 0.0])


CASES = {
    "lens": ({"lens": (-0.10, 0.06, 6e-3, 0.0, 0.0)}, "tangential"),
    "board": ({"warp": (4e-4, 0.0)}, "warp"),
    "axis": ({"wobble": tuple(map(tuple, 5e-4 * np.random.default_rng(3).normal(size=(40, 3)) * [1, 0, 1]))}, None),
    "sheet": ({}, None),
}


def trial(world, name, seed):
    """The rig, and its calibration from noisy observations."""
    truth, held = CASES[name]
    rig = world.Rig(**truth, spread=0.3)
    seen = world.observe(rig, free=14, placements=2, seed=seed)
    if name == "sheet":
        moved = seen.stripes.q + np.where(seen.stripes.valid[..., None], bend(seen.stripes.q), 0.0)
        seen = replace(seen, stripes=replace(seen.stripes, q=moved))
    return rig, calibrate_observations(world.with_noise(seen, seed), settings=settings(held))


def numbers(scanner):
    camera, table, sheet = scanner.camera, scanner.turntable, scanner.lasers
    return (
        ((float(camera.fx), float(camera.fy)), (float(camera.cx), float(camera.cy)), np.asarray(camera.distortion)),
        (np.asarray(sheet.normal[0]), float(sheet.distance[0])),
        (np.asarray(table.direction), np.asarray(table.point), float(table.gain), np.asarray(table.harmonics)),
    )


def true_numbers(rig):
    return (
        (rig.focal, rig.centre, rig.lens),
        (rig.normal(), rig.distances[0]),
        (rig.direction(), rig.foot(), rig.gain, np.array(rig.harmonics)),
    )


def true_error_mm(world, rig, found, shape):
    """Error of the points of a full turn at AT_M after the best rigid motion; by plain NumPy on both sides."""
    n, d = rig.normal(), rig.distances[0]
    y = np.linspace(-0.38, 0.38, 9)
    p = np.column_stack([(d - n[1] * y - n[2] * AT_M) / n[0], y, np.full(9, AT_M)])
    q = world.project(rig, p)
    q, phi = np.tile(q, (24, 1)), np.repeat(2 * np.pi * np.arange(24) / 24, 9)
    true = world.scanned(*true_numbers(rig), q, phi)
    measured = world.scanned(*numbers(found.scanner), q + (bend(q) if shape == "sheet" else 0.0), phi)
    a, b = true - true.mean(0), measured - measured.mean(0)
    u, _, vt = np.linalg.svd(a.T @ b)
    turn = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    return 1e3 * np.sqrt(np.mean(np.sum((a @ turn - b) ** 2, axis=1)))


@pytest.fixture(scope="module", params=CASES)
def trials(request, world):
    """Of each kind of error: its name, and (rig, calibration, true error) of each seed."""
    found = [trial(world, request.param, seed) for seed in SEEDS]
    return request.param, [(*pair, true_error_mm(world, *pair, request.param)) for pair in found]


def test_what_is_injected_is_stated_at_its_size(trials):
    """Root mean square over the seeds: within a factor of 1.5 of the true one, either way."""
    name, found = trials
    stated = np.sqrt(np.mean([one.quality.verdict.good_to.sigma_mm**2 for _, one, _ in found]))
    noise = np.sqrt(np.mean([one.quality.verdict.good_to.statistical_mm**2 for _, one, _ in found]))
    true = np.sqrt(np.mean([error**2 for _, _, error in found]))
    print(name, stated, noise, true)
    assert true / 1.5 < stated < 1.5 * true
    assert noise < stated / 1.5, "without the harm it would be stated too small"
