"""What a covariance means in millimetres, against closed forms and against draws."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from jaxscan.calibration.propagate import (
    depth_sigma,
    length_sigma,
    measure_good_to,
    measure_lengths,
    predict_lengths,
    stripe_depths,
    stripe_pixels,
    typical_lengths,
)
from jaxscan.geometry import Fisheye, LaserSheet, LinearStage, Pinhole, Scanner, Still, Turntable, root_of, stack_lasers


def room_rig(covariance=None, *, bow=(0.0, 0.0), distortion=(-0.1, 0.06, 2e-4, -1e-4, 0.0)):
    """A sheet 0.4 m beside the camera that crosses the optical axis at 3 m."""
    camera = Pinhole(1400.0, 1400.0, 960.0, 600.0, np.array(distortion), width=1920, height=1200)
    flat = LaserSheet.from_abc(7.5, 0.0, 3.0)
    sheet = LaserSheet(flat.normal, flat.distance, np.array(bow), flat.basis)
    return Scanner(
        camera, stack_lasers([sheet]), Turntable.from_axis([0.02, -1.0, 0.01], [0.2, 0.0, -0.05]), covariance
    )


def uncertain(scanner, **sigma):
    """With independent standard deviations of the named parameters and of nothing else."""
    names = [name.removeprefix("laser.laser.") for name in scanner.parameter_names()]
    variance = np.zeros(len(names))
    for name, value in sigma.items():
        variance[names.index(name.replace("axis_", "axis."))] = value**2
    return replace(scanner, covariance=np.diag(variance))


@pytest.fixture(scope="module")
def realistic():
    """About what thirty boards give, with a strong correlation of focal length and sheet."""
    scanner = room_rig()
    names = scanner.parameter_names()
    sigma = np.full(len(names), 2e-5)
    sigma[:4] = 0.4
    sigma[4:9] = (2e-4, 6e-4, 3e-5, 3e-5, 6e-4)
    sigma[-5:] = 1e-4
    mixing = np.eye(len(names)) + 0.3 * np.random.default_rng(0).normal(size=(len(names), len(names)))
    correlation = mixing @ mixing.T
    root = sigma / np.sqrt(np.diag(correlation))
    return replace(scanner, covariance=correlation * np.outer(root, root))


def test_stripe_pixels_are_where_the_depth_is():
    scanner = room_rig(bow=(2e-3, 1e-3))
    q = stripe_pixels(scanner, 0, 2.5)
    # The whole height of the image: at 2.5 m the stripe is 70 px beside its middle.
    assert len(q) == 1200
    # Rows are found by interpolation between samples 41 px apart; depths are solved for.
    np.testing.assert_allclose(q[:, 1], np.arange(1200), atol=0.1)
    np.testing.assert_allclose(stripe_depths(scanner, 0, q), 2.5, atol=1e-9)
    # Where the sheet is at 0.3 m no pixel looks: it passes the camera 0.4 m to the side.
    assert len(stripe_pixels(scanner, 0, 0.3)) == 0


def test_depth_goes_with_the_distance_of_the_sheet():
    # Every point of a ray is at z = d * (ray_z / n . ray), so its sigma is z / d * sigma_d.
    scanner = uncertain(room_rig(), d=1e-4)
    distance = float(scanner.lasers.distance[0])
    q = stripe_pixels(scanner, 0, 4.0)
    np.testing.assert_allclose(depth_sigma(scanner, 0, q), 4.0 / distance * 1e-4, rtol=1e-9)
    for entry in predict_lengths(scanner).lasers[0].depths:
        expected = 1000.0 * entry.depth_m / distance * 1e-4
        assert entry.sigma_depth_mm == pytest.approx(expected, rel=1e-9)
        # At the nearest depth, 0.6 m, ranges are up to hypot(1, 0.53, 0.46) = 1.22 times the depth.
        assert expected < entry.sigma_range_mm < 1.22 * expected
    within = typical_lengths(scanner, 0)[0]
    assert within.name == "along the stripe"
    np.testing.assert_allclose(length_sigma(scanner, [within]), 0.3 / distance * 1e-4, rtol=1e-6)


def test_a_fisheye_is_judged_alike():
    camera = Fisheye(600.0, 600.0, 960.0, 600.0, np.array([0.02, -0.01, 0.0, 0.0]), width=1920, height=1200)
    scanner = uncertain(replace(room_rig(), camera=camera), d=1e-4)
    q = stripe_pixels(scanner, 0, 2.5)
    # The lowest row is 1 rad = 57 degrees down, within the 72 over which stripes are looked for.
    assert len(q) == 1200
    np.testing.assert_allclose(stripe_depths(scanner, 0, q), 2.5, atol=1e-9)
    np.testing.assert_allclose(depth_sigma(scanner, 0, q), 2.5 / float(scanner.lasers.distance[0]) * 1e-4, rtol=1e-9)
    names = [length.name for length in predict_lengths(scanner).lasers[0].lengths]
    assert names == ["wall", "along the stripe", "across the sweep", "half a turn", "half a turn"]


def test_an_angle_scale_stretches_across_the_sweep_alone():
    scanner = uncertain(room_rig(), gain=1e-3)
    lengths = typical_lengths(scanner, 0)
    along, across, *halves = length_sigma(scanner, lengths)
    assert [length.name for length in lengths] == ["along the stripe", "across the sweep"] + ["half a turn"] * 2
    # A chord 2 r sin(phi / 2) grows by r cos(phi / 2) phi per unit of gain.
    phi, chord = lengths[1].angle[1], 0.3
    assert across == pytest.approx(chord / (2 * np.tan(phi / 2)) * phi * 1e-3, rel=1e-5)
    assert along == 0
    # Half a turn is the diameter: there a chord does not change to first order.
    np.testing.assert_allclose(halves, 0.0, atol=1e-12)


def test_scale_stretches_every_length_alike():
    # Sheet and axis farther away by the same share: as if the board's squares were larger.
    scanner = room_rig()
    names = scanner.parameter_names()
    change = np.zeros(len(names))
    change[names.index("laser.laser.d")] = scanner.lasers.distance[0]
    foot = scanner.turntable.basis @ scanner.turntable.point
    change[names.index("axis.p1")], change[names.index("axis.p2")] = foot
    share = 2e-4
    scanner = replace(scanner, covariance=share**2 * np.outer(change, change))
    lengths = typical_lengths(scanner, 0)
    value = measure_lengths(scanner, lengths)
    np.testing.assert_allclose(value[:2], 0.3, atol=1e-6)
    # Wall to wall, through the axis 0.05 m behind and 0.2 m beside the camera.
    np.testing.assert_allclose(value[2:], [3.92, 6.26], atol=0.01)
    np.testing.assert_allclose(length_sigma(scanner, lengths), share * value, rtol=1e-6)
    entry = next(e for e in predict_lengths(scanner).lasers[0].depths if e.depth_m == 2.5)
    assert entry.sigma_depth_mm == pytest.approx(2.5e3 * share, rel=1e-6)
    # A full turn is stretched about its middle, which no rigid motion undoes: 2.55 m is the radius.
    assert entry.sigma_point_mm == pytest.approx(np.hypot(2.56, 0.68) * 1e3 * share, rel=0.03)


def test_a_verdict_is_that_of_the_wall_and_its_parts_make_it_up():
    scanner = uncertain(room_rig(), gain=1e-3, d=1e-4, fx=0.1)
    steps = root_of(np.asarray(scanner.covariance))
    found, _ = measure_good_to(scanner.camera, scanner, steps, (), None)
    wall = predict_lengths(scanner).lasers[0].lengths[0]
    assert (wall.name, wall.length_m, wall.depth_m) == ("wall", 4.0, 2.5) == ("wall", found.length_m, found.at_m)
    assert found.sigma_mm == pytest.approx(wall.sigma_mm, rel=1e-9)
    assert found.sigma_mm == pytest.approx(np.linalg.norm([part.sigma_mm for part in found.parts]), rel=1e-6)
    parts = {part.name: part.sigma_mm for part in found.parts}
    assert set(parts) == {"angles", "sheet", "camera"}
    # Independent errors: each part is what it would be alone.
    for name, alone in (("angles", {"gain": 1e-3}), ("sheet", {"d": 1e-4}), ("camera", {"fx": 0.1})):
        other = uncertain(room_rig(), **alone)
        single, _ = measure_good_to(other.camera, other, root_of(np.asarray(other.covariance)), (), None)
        assert single.sigma_mm == pytest.approx(parts[name], rel=1e-6)
    # A chord of 4 m at 3.2 m, and higher or lower at its other end.
    radius = np.hypot(2.5, 2.0) + 0.05
    half = np.arcsin(2.0 / radius)
    assert 0.7 < parts["angles"] / (radius * np.cos(half) * 2 * half) < 1.0


def test_errors_that_go_together_are_a_part_of_the_first_that_would_explain_them():
    # The sheet and the focal length are wrong by one common step: known angles leave it, a known sheet does not.
    scanner = room_rig()
    names, step = scanner.parameter_names(), np.zeros(len(scanner.parameter_names()))
    step[[names.index("fx"), names.index("laser.laser.d")]] = 0.1, 1e-4
    found, _ = measure_good_to(scanner.camera, scanner, step[None], (), 2.0)
    assert [part.name for part in found.parts] == ["sheet"] and found.at_m == 2.0 and found.length_m == 3.2
    assert found.parts[0].sigma_mm == pytest.approx(found.sigma_mm, rel=1e-6)


def test_an_object_and_a_stage_have_lengths_of_their_own():
    table = Turntable.from_axis([0.0, -1.0, 0.0], [0.1, 0.0, 1.5], carries="object")
    on_table = uncertain(replace(room_rig(), turntable=table), d=1e-5)
    along = uncertain(replace(room_rig(), turntable=LinearStage.from_direction([1.0, 0.1, 0.0])), d=1e-5)
    near, of_stage, still = (
        measure_good_to(one.camera, one, root_of(np.asarray(one.covariance)), (), at)[0]
        for one, at in ((on_table, 1.2), (along, 2.5), (uncertain(replace(room_rig(), turntable=Still()), d=1e-5), 2.5))
    )
    assert 0 < near.length_m < 1.0 and near.at_m == 1.2 and near.sigma_mm > 0
    assert of_stage.length_m == 0.5 and of_stage.sigma_mm > 0
    assert still.length_m is None and still.sigma_mm == pytest.approx(
        1e-5 * 2.5e3 / float(along.lasers.distance[0]), rel=0.2
    )


@pytest.mark.more
def test_where_the_cloud_lies_is_no_error():
    # c1 (cos phi - 1) turns all points alike by its constant, and shifts them by half of its wave.
    scanner = uncertain(room_rig(), c1=1e-4)
    entry = next(e for e in predict_lengths(scanner).lasers[0].depths if e.depth_m == 2.5)
    rows = stripe_pixels(scanner, 0, 2.5)[np.linspace(0, 1199, 8).round().astype(int)]
    q, angle = np.tile(rows, (24, 1)), np.repeat(2 * np.pi * np.arange(24) / 24, 8)
    step = np.zeros(len(scanner.parameter_names()))
    step[scanner.parameter_names().index("c1")] = 1e-4
    cloud = jax.jit(jax.vmap(lambda s, q, phi: s.point(q, 0, phi)[0], in_axes=(None, 0, 0)))
    true, moved = (np.asarray(cloud(scanner.retract(step * by), q, angle)) for by in (0.0, 1.0))
    # The best rigid motion by singular values (Kabsch) instead of by its linear form.
    a, b = true - true.mean(0), moved - moved.mean(0)
    u, _, vt = np.linalg.svd(a.T @ b)
    left = np.sqrt(np.mean(np.sum((b - a @ u @ vt) ** 2, axis=-1)))
    # The linear form is off by the square of 0.1 mrad.
    assert entry.sigma_point_mm == pytest.approx(1e3 * left, rel=1e-3)
    assert 1e3 * np.sqrt(np.mean(np.sum((true - moved) ** 2, axis=-1))) > 2 * entry.sigma_point_mm


@pytest.mark.more
def test_prediction_is_what_draws_show(realistic):
    lengths = typical_lengths(realistic, 0)
    q = stripe_pixels(realistic, 0, 2.5)[::400]
    root = np.linalg.cholesky(realistic.covariance)
    random = np.random.default_rng(1)
    draws = 1500
    values = []
    moved = jax.jit(lambda step: jax.vmap(realistic.as_dtype(np.float64).retract)(step))
    every = moved(random.normal(size=(draws, len(root))) @ root.T)
    with jax.enable_x64(True):

        @jax.jit
        @jax.vmap
        def measured(scanner):
            ends = jax.vmap(lambda q, phi: scanner.point(q, 0, phi)[0])
            first, second = (
                ends(np.stack([each.q[i] for each in lengths]), np.array([each.angle[i] for each in lengths]))
                for i in range(2)
            )
            return ((first - second) ** 2).sum(-1) ** 0.5

        values = np.asarray(measured(every))
    # A standard deviation from 1500 draws is known to 1 / sqrt(2 * 1500) = 1.8 %: four of these.
    np.testing.assert_allclose(values.std(0), length_sigma(realistic, lengths), rtol=0.075)
    assert (depth_sigma(realistic, 0, q) > 0).all()


def test_small_rig_with_two_lasers_and_a_stripe_along_the_rows():
    camera = Pinhole(1450.0, 1450.0, 641.0, 477.0, np.array([-0.08, 0.05, 0.0, 0.0, 0.0]), width=1280, height=960)
    upright = LaserSheet.from_plane([1 / 0.14, 0.0, 1 / 0.35], 1.0)
    level = LaserSheet.from_plane([0.0, 1 / 0.14, 1 / 0.35], 1.0)
    table = Turntable.from_axis([0.01, -0.97, -0.24], [0.002, 0.0, 0.35], carries="object")
    scanner = Scanner(camera, stack_lasers([upright, level]), table, laser_names=("upright", "level"))
    scanner = replace(scanner, covariance=np.eye(len(scanner.parameter_names())) * 1e-10)
    prediction = predict_lengths(scanner)
    first, second = prediction.lasers
    assert (first.name, second.name) == ("upright", "level")
    # Up to twice the distance of the table; nearer than 0.2 m the sheets leave the image.
    assert [entry.depth_m for entry in first.depths] == [0.25, 0.4, 0.6]
    assert {entry.lines for entry in first.depths} == {960}
    assert {entry.lines for entry in second.depths} == {1280}
    # The middle depth is 0.4 m: lengths are 12 % of it. Two sides of an object are under 0.2 m apart.
    lengths = {entry.name: entry for entry in first.lengths}
    assert lengths["along the stripe"].length_m == pytest.approx(0.048, abs=1e-6)
    assert lengths["across the sweep"].length_m == pytest.approx(0.048, abs=1e-6)
    assert 0.05 < lengths["half a turn"].length_m < 0.2
    assert all(entry.sigma_mm > 0 for entry in lengths.values())


def test_a_scanner_without_covariance_is_refused():
    with pytest.raises(ValueError, match="no covariance"):
        predict_lengths(room_rig())


def test_an_object_nearer_than_every_depth_has_no_lengths_but_is_judged():
    """The axis 4 cm in front of the camera, with the object on the table: no listed depth is within twice that."""
    rig = room_rig()
    near = Turntable.from_axis([0.0, -1.0, 0.0], [0.0, 0.0, 0.04])
    table = Turntable(near.direction, near.point, near.gain, near.harmonics, near.basis, "object")
    scanner = uncertain(replace(rig, turntable=table), d=1e-4)
    assert typical_lengths(scanner, 0) == []
    (laser,) = predict_lengths(scanner).lasers
    assert laser.depths == () and laser.lengths == ()
