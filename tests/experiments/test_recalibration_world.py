"""Stripes of known rooms against the geometry, which knows nothing of how they were made."""

from functools import partial
from pathlib import Path

import jax
import numpy as np
import pytest

import jaxscan
from experiments.recalibration.trial import draw_truth
from experiments.recalibration.world import (
    Noise,
    Sweeping,
    box_of,
    curved,
    moved,
    room_from_rig,
    shift_axis,
    stepped,
    sweep_of,
    true_sweep,
    turn_laser,
)
from jaxscan.simulation import SimulationConfig, true_scanner


pytestmark = pytest.mark.more


CONFIGS = Path(__file__).resolve().parents[2] / "configs"
EXACT = Noise(px=0.0)
BOXES = {"room": {}, "empty": {"furniture": False}}


def rig(name: str = "unkind") -> SimulationConfig:
    return draw_truth(jaxscan.load_simulation(CONFIGS / f"{name}.toml"), 3)


def triangulated(config, stripes, angle=None):
    """Points of the geometry's own scanner, in the room [n, 3]."""
    profile, line = np.nonzero(stripes.valid)
    at = (stripes.angle if angle is None else angle)[stripes.record[profile]]
    with jax.enable_x64(True):
        point = jax.jit(jax.vmap(lambda q, phi: true_scanner(config).point(q, 0, phi)[0]))
        q = np.stack([stripes.centre[profile, line], line.astype(float)], -1)
        return room_from_rig(config).apply(np.asarray(point(q, at)))


@pytest.mark.parametrize("kind", BOXES)
@pytest.mark.parametrize("name", ["unkind", "paper"])
def test_points_are_where_the_geometry_has_them(name, kind):
    config = rig(name)
    stripes, truth = true_sweep(config, 1, Sweeping(steps=24, line_stride=8, noise=EXACT, **BOXES[kind]))
    assert stripes.valid[:, ::8].mean() > 0.9 and not stripes.valid[:, 1::8].any()
    np.testing.assert_allclose(triangulated(config, stripes), truth.point[stripes.valid], atol=1e-9)


def test_points_lie_on_the_walls_of_the_box():
    config = rig()
    stripes, truth = true_sweep(config, 1, Sweeping(steps=60, furniture=False, line_stride=8, noise=EXACT))
    box, wall = box_of(config.room), truth.surface[stripes.valid]
    assert set(wall) >= {0, 1, 2, 3}
    walls, points = wall < 6, truth.point[stripes.valid]
    off = np.einsum("ij,ij->i", points[walls], box.normal[wall[walls]]) - box.distance[wall[walls]]
    assert np.abs(off).max() < 1e-9
    assert ((points > -1e-6) & (points < np.array(config.room.size_m) + 1e-6)).all()


def test_rough_walls_are_as_rough_as_asked():
    config = rig()
    _, truth = true_sweep(config, 1, Sweeping(steps=120, furniture=False, rough_m=1e-3, noise=EXACT))
    box = box_of(config.room)
    for wall in range(4):
        off = truth.point[truth.surface == wall] @ box.normal[wall] - box.distance[wall]
        assert 0.8e-3 < np.std(off) < 1.2e-3


@pytest.mark.parametrize(("extra", "wall"), [(stepped, 0), (curved, 3)])
def test_a_wall_that_is_not_flat_stands_out(extra, wall):
    config = rig()
    room = config.room
    how = partial(Sweeping, steps=60, furniture=False, line_stride=8, noise=EXACT)
    extras = extra(room, 0.01)
    _, flat = true_sweep(config, 1, how())
    _, bent = true_sweep(config, 1, how(extras=extras))
    depth = np.linalg.norm(bent.point - flat.point, axis=-1)[(flat.surface == wall) & (bent.surface >= 0)]
    others = np.linalg.norm(bent.point - flat.point, axis=-1)[(flat.surface == 1) & (bent.surface == 1)]
    assert 0.005 < depth.max() < 0.1 and others.max() < 1e-9


def test_noise_is_as_stated():
    config = rig()
    how = partial(Sweeping, steps=60, furniture=False)
    noise = Noise(px=0.1, shared_lines=5, neighbours=0.6)
    stripes, truth = true_sweep(config, 1, how(noise=noise))
    error = np.where(stripes.valid, stripes.centre - truth.centre, np.nan)
    np.testing.assert_allclose(np.nanstd(error), 0.1, rtol=0.05)
    along = np.nanmean(error[:, :-2] * error[:, 2:]) / 0.01
    np.testing.assert_allclose(along, 1 - 2 / 5, atol=0.05)
    np.testing.assert_allclose(np.nanmean(error[:-1] * error[1:]) / 0.01, 0.6, atol=0.08)
    np.testing.assert_array_equal(stripes.shared_lines, 5)


def test_a_table_that_lost_steps_stands_elsewhere():
    config = rig()
    how = Sweeping(steps=30, furniture=False, line_stride=8, lost=(12, 1.8), noise=EXACT)
    stripes, truth = true_sweep(config, 1, how)
    np.testing.assert_allclose(truth.angle[11], stripes.angle[11])
    np.testing.assert_allclose(truth.angle[12], stripes.angle[12] + np.deg2rad(1.8))
    np.testing.assert_allclose(triangulated(config, stripes, truth.angle), truth.point[stripes.valid], atol=1e-9)


def test_drifts_are_as_large_as_asked():
    config = rig()
    before, after = true_scanner(config), true_scanner(turn_laser(config, 0.05, 2))
    angle = np.rad2deg(np.arccos(before.lasers.normal[0] @ after.lasers.normal[0]))
    np.testing.assert_allclose(angle, 0.05, rtol=1e-6)
    shifted = true_scanner(shift_axis(config, 2e-4, 2)).turntable
    np.testing.assert_allclose(np.linalg.norm(shifted.point - before.turntable.point), 2e-4, rtol=1e-9)
    np.testing.assert_allclose(shifted.direction, before.turntable.direction, atol=1e-12)


def test_another_station_sees_the_same_room():
    config = rig()
    there = moved(config, (1.2, 1.0, 1.3), 200.0)
    stripes = sweep_of(there, 2, Sweeping(steps=40, furniture=False, line_stride=8, noise=EXACT, station=1))
    points = triangulated(there, stripes)
    assert stripes.station == 1
    assert ((points > -1e-6) & (points < np.array(config.room.size_m) + 1e-6)).all()
