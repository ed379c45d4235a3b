"""Frames of targets and of rooms: motions are found, sigmas cover the errors, and what tells no frame is refused."""

import dataclasses
import json
import tracemalloc

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxscan
from jaxscan.cli.main import main
from jaxscan.errors import MeasurementError

from ..files.clouds import make_cloud


def motion(seed, far=10.0):
    rng = np.random.default_rng(seed)
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = Rotation.random(random_state=seed).as_matrix(), rng.uniform(-far, far, 3)
    return transform


def moved(points, transform):
    return points @ transform[:3, :3].T + transform[:3, 3]


@pytest.mark.parametrize("count", [3, 4, 9])
def test_exact_targets_give_the_motion(count):
    a, true = np.random.default_rng(count).uniform(-3, 3, (count, 3)), motion(count, far=1e6)
    found = jaxscan.align_targets(a, moved(a, true))
    # Coordinates of a million metres have a rounding of 1e-10 m.
    np.testing.assert_allclose(moved(a, found.transform), moved(a, true), atol=1e-8)
    np.testing.assert_allclose(found.transform[:3, :3], true[:3, :3], atol=1e-9)
    assert np.linalg.det(found.transform[:3, :3]) == pytest.approx(1.0) and found.sigma_m < 1e-8
    assert found.scale == pytest.approx(1.0) and found.freedom == 3 * count - 6


@pytest.mark.parametrize("count", [4, 6])
def test_sigmas_are_those_of_the_errors(count):
    """Over many draws the errors of a place, in sigmas, have the mean square 1; that of a coordinate is found."""
    rng, noise = np.random.default_rng(count), 0.004
    a = rng.uniform(-3, 3, (count, 3))
    place, squares, predicted, sigmas = np.array([5.0, 1.0, -2.0]), [], [], []
    for seed in range(400):
        true = motion(seed)
        found = jaxscan.align_targets(a, moved(a, true) + noise * rng.normal(size=a.shape))
        at = moved(place, true)
        squares.append(np.sum((moved(place, found.transform) - at) ** 2))
        predicted.append(found.sigma_at(at) ** 2)
        sigmas.append(found.sigma_m**2)
    # 400 draws of at least 6 residuals: the mean of their squares is good to 3 %.
    assert np.mean(sigmas) == pytest.approx(noise**2, rel=0.1)
    # Student's factor: the mean of the predicted squares is f / (f - 2) times the true one, at f = 6 and 12.
    freedom = 3 * count - 6
    assert np.mean(predicted) == pytest.approx(np.mean(squares) * freedom / (freedom - 2), rel=0.25)


def test_targets_that_tell_no_frame_are_refused():
    rng = np.random.default_rng(0)
    a, true = rng.uniform(-3, 3, (5, 3)), motion(1)
    line = np.outer(np.arange(5.0), [1.0, 2.0, 0.5]) + 1e-3 * rng.normal(size=(5, 3))
    mirrored = moved(a * [1, 1, -1], true) + 1e-3 * rng.normal(size=a.shape)
    cases = [
        (a[:2], moved(a[:2], true), "2 targets, expected 3 or more"),
        (line, moved(line, true), "lie on one line in the scanner's"),
        (np.ones((4, 3)), np.ones((4, 3)), "lie on one line"),
        (a, mirrored, "mirror image only"),
        (a[:, [1, 0, 2]], a, "mirror image only"),
        (a, 1e3 * moved(a, true), "1000 times as long"),
    ]
    for scanner, site, says in cases:
        with pytest.raises(MeasurementError, match=says):
            jaxscan.align_targets(scanner, site)


@pytest.mark.parametrize("seed", range(20))
def test_noise_makes_no_mirror_of_targets_in_a_plane(seed):
    """On a wall both hands fit; the noise alone must not decide that the coordinates are wrong."""
    rng, true = np.random.default_rng(seed), motion(seed)
    a = rng.uniform(-3, 3, (4, 3)) * [1, 1, 0]
    seen = a + 0.002 * rng.normal(size=a.shape)
    found = jaxscan.align_targets(seen, moved(a, true) + 0.002 * rng.normal(size=a.shape))
    # Targets some metres apart with 2 mm of noise turn the frame by some milliradians at most.
    assert np.abs(found.transform[:3, :3] - true[:3, :3]).max() < 0.03


@pytest.mark.parametrize(("yaw", "size"), [(0.3, (6.15, 3.82, 2.6)), (2.0, (6.15, 3.82, 2.6)), (-2.5, (3.0, 5.0, 2.4))])
def test_the_frame_of_a_room(box_room, yaw, size):
    """The corner is at the origin, the longer side along x, and the room fills 0 to its size."""
    cloud = box_room(size, yaw=yaw, tilt=0.03, at=(0.4, -0.3, 1.2), grid=(360, 160), elevation=50.0)
    found = jaxscan.align_room(cloud)
    assert np.linalg.det(found.transform[:3, :3]) == pytest.approx(1.0)
    points = moved(cloud.xyz.reshape(-1, 3).astype(float), found.transform)
    low, high = points.min(0), points.max(0)
    # Noise of 1 mm at 2.5 m grows to 6 mm at the corners; of 60 thousand points the outermost are at 4.5 sigma.
    np.testing.assert_allclose(low, 0.0, atol=0.04)
    np.testing.assert_allclose(high, [max(size[:2]), min(size[:2]), size[2]], atol=0.04)
    scanner = found.transform[:3, 3]
    long, other = max(size[:2]), min(size[:2])
    across, along = (0.4, -0.3)[:: 1 if size[0] > size[1] else -1]
    assert min(abs(scanner[0] - long / 2 - across), abs(scanner[0] - long / 2 + across)) < 5 * found.sigma_m[0] + 1e-4
    assert min(abs(scanner[1] - other / 2 - along), abs(scanner[1] - other / 2 + along)) < 5 * found.sigma_m[1] + 1e-4
    assert scanner[2] == pytest.approx(1.2, abs=5 * found.sigma_m[2] + 1e-4)
    assert found.tilt_deg == pytest.approx(np.degrees(0.03), abs=0.02) and found.corner_deg == pytest.approx(
        90, abs=0.05
    )


def test_a_room_without_a_floor_has_no_frame(box_room):
    with pytest.raises(MeasurementError, match="0 floors and 4 walls"):
        jaxscan.align_room(box_room(grid=(240, 60), elevation=8.0))


def test_a_cloud_is_moved_with_its_normals_and_its_place():
    cloud, true = make_cloud(), motion(4)
    there = jaxscan.align_cloud(cloud, true)
    before, after = cloud.points(), there.points()
    np.testing.assert_allclose(after.xyz, moved(before.xyz.astype(float), true), atol=5e-6)
    np.testing.assert_allclose(after.normals, before.normals @ true[:3, :3].T, atol=5e-6)
    np.testing.assert_array_equal(after.sigma_random, before.sigma_random)
    assert not np.asarray(there.xyz)[~cloud.valid].any() and there.xyz.dtype == np.float32
    np.testing.assert_allclose(there.stations.pose, true[None])
    again = jaxscan.align_cloud(there, np.linalg.inv(true))
    np.testing.assert_allclose(again.stations.pose, np.eye(4)[None], atol=1e-12)
    # A national grid: float32 has steps of 0.5 m there.
    far = np.eye(4)
    far[:3, 3] = 4.5e6
    np.testing.assert_allclose(jaxscan.align_cloud(cloud, far).points().xyz - 4.5e6, before.xyz, atol=1e-8)


def test_a_cloud_is_moved_in_little_memory():
    """A point takes 24 bytes, of its new place and normal; the rest is that of a block of 2^18 points."""
    small = make_cloud()
    times = 1 + 1_000_000 // small.valid.size
    fields = {one.name: getattr(small, one.name) for one in dataclasses.fields(small)}
    many = {name: np.repeat(value, times, 0) for name, value in fields.items() if isinstance(value, np.ndarray)}
    cloud = dataclasses.replace(small, **many)
    tracemalloc.start()
    try:
        jaxscan.align_cloud(cloud, motion(4))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 60 * cloud.valid.size


def test_on_the_command_line(tmp_path, capsys, tiny):
    cloud, true = jaxscan.load_cloud(tiny.cloud), motion(2)
    a = np.array([[1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 1.5], [1.0, 1.0, -1.0]])
    b = moved(a, true) + [[0.001, 0, 0], [0, -0.001, 0], [0, 0, 0.001], [0, 0, 0]]
    lines = [f"scanner = {p.tolist()}\nsite = {q.tolist()}\n" for p, q in zip(a, b, strict=True)]
    entries = [f'[[target]]\nname = "T{k}"\n{line}' for k, line in enumerate(lines)]
    targets, target = tmp_path / "targets.toml", tmp_path / "there.ply"
    targets.write_text("".join(entries))
    words = ["align", str(tiny.cloud), "-o", str(target), "--json", str(tmp_path / "a.json")]
    assert main([*words, "--targets", str(targets)]) == 0
    said = json.loads((tmp_path / "a.json").read_text())
    found = jaxscan.align_targets(a, b)
    np.testing.assert_allclose(said["transform_m"], found.transform)
    assert said["sigma_m"] == pytest.approx(found.sigma_m) and set(said["targets"]) == {"T0", "T1", "T2", "T3"}
    written = jaxscan.load_cloud(target)
    wanted = moved(cloud.points().xyz.astype(float), found.transform)
    np.testing.assert_allclose(written.points().xyz, wanted, atol=2e-6)
    np.testing.assert_allclose(written.stations.pose[0], found.transform, atol=1e-6)
    assert "residuals to spare" in capsys.readouterr().out
    assert main([*words, "--room"]) == 0
    box = jaxscan.measure_room(jaxscan.load_cloud(target))
    assert abs(box.length.direction[0]) == pytest.approx(1.0, abs=2e-3)
    before = jaxscan.measure_room(cloud)
    assert box.length.value_m == pytest.approx(before.length.value_m, abs=2 * before.length.sigma_m)
    capsys.readouterr()
    for wrong, says in (([], "neither --room"), (["--room", "--targets", str(targets)], "both --room")):
        assert main([*words, *wrong]) == 1 and says in capsys.readouterr().err
    targets.write_text(entries[0] * 2)
    assert main([*words, "--targets", str(targets)]) == 1 and "two targets have the name" in capsys.readouterr().err


KNOWN = np.array([[0.0, 0.0, 0.3], [4.0, 0.1, 1.6], [3.8, 3.1, 0.7], [0.2, 2.9, 2.1], [2.1, 1.4, 0.2]])


@pytest.mark.parametrize("change", [lambda p: p * [-1, 1, 1], lambda p: p + [1.0, 0, 0], lambda p: 1e3 * p])
def test_a_wrong_target_is_named(change):
    """Of five to a millimetre one has a sign turned, is a metre off, or is in millimetres."""
    seen = KNOWN + np.random.default_rng(0).normal(0, 1e-3, KNOWN.shape)
    names = list("ABCDE")
    assert jaxscan.align_targets(seen, KNOWN, names=names).sigma_m < 3e-3
    wrong = KNOWN.copy()
    wrong[2] = change(wrong[2])
    with pytest.raises(MeasurementError, match="Target 'C' is"):
        jaxscan.align_targets(seen, wrong, names=names)


def test_targets_that_contradict_without_one_to_blame():
    with pytest.raises(MeasurementError, match="exchanged"):
        jaxscan.align_targets(KNOWN, KNOWN[[1, 0, 2, 3, 4]])
    three = KNOWN[:3].copy()
    three[1, 1] += 0.5
    with pytest.raises(MeasurementError, match="do not tell which"):
        jaxscan.align_targets(KNOWN[:3], three)
