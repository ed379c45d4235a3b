"""Clouds of several stations: joined, written with their poses, and read back by us and by others."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.errors import CloudError
from jaxscan.files.clouds import load_cloud, save_cloud, save_clouds
from jaxscan.geometry import exponential
from jaxscan.reconstruction import SMOOTHED, join_clouds, of_station

from .clouds import PROFILES, make_cloud, unsealed


SECOND = np.asarray(exponential(jnp.array([1.6, -0.7, 0.05, 0.02, -0.03, 2.5])))
_factor = np.random.default_rng(5).normal(size=(6, 6)) * [[1e-4]] * 3 + np.diag([1e-3] * 3 + [4e-4] * 3)
COVARIANCE = _factor @ _factor.T


@pytest.fixture
def stations():
    return [(make_cloud(), np.eye(4), np.zeros((6, 6))), (make_cloud(seed=1), SECOND, COVARIANCE)]


@pytest.fixture
def joined(stations):
    return join_clouds(*zip(*stations, strict=True))


def moved(xyz):
    return xyz.astype(float) @ SECOND[:3, :3].T + SECOND[:3, 3]


# Coordinates of 8 m in float32 are good to 0.5 um; twice turned.
CLOSE_M = 2e-6


def test_a_joined_cloud_is_in_the_frame_of_the_room(stations, joined):
    first, second = stations[0][0], stations[1][0]
    assert joined.stations.number.tolist() == [0] * PROFILES + [1] * PROFILES
    np.testing.assert_array_equal(joined.xyz[:PROFILES], np.where(first.valid[..., None], first.xyz, 0))
    seen = second.valid
    np.testing.assert_allclose(joined.xyz[PROFILES:][seen], moved(second.xyz[seen]), rtol=0, atol=CLOSE_M)
    turned = second.normals[seen] @ SECOND[:3, :3].T
    np.testing.assert_allclose(joined.normals[PROFILES:][seen], turned, rtol=0, atol=1e-6)
    for name in ("rgb", "intensity", "sigma_random", "record", "laser", "angle", "valid"):
        np.testing.assert_array_equal(getattr(joined, name)[PROFILES:], getattr(second, name))
    assert joined.points().station.tolist() == [0] * first.valid.sum() + [1] * seen.sum()
    back = of_station(joined, 1)
    np.testing.assert_allclose(back.xyz[seen], second.xyz[seen], rtol=0, atol=CLOSE_M)
    assert back.stations is None and of_station(back, 0) is back


def test_systematic_sigma_holds_the_pose(stations, joined):
    """The largest standard deviation in any direction, of points that are moved by draws of the pose."""
    rng = np.random.default_rng(2)
    cloud = stations[1][0]
    points, own = cloud.xyz[cloud.valid][:8].astype(float), cloud.sigma_systematic[cloud.valid][:8]
    steps = rng.multivariate_normal(np.zeros(6), COVARIANCE, 4000)
    shifted = points + steps[:, None, :3] + np.cross(steps[:, None, 3:], points)
    largest = np.array([np.linalg.eigvalsh(np.cov(each.T))[-1] for each in shifted.swapaxes(0, 1)])
    expected = np.sqrt(own**2 + largest)
    # 4000 draws: 1.1 % each; four of those.
    np.testing.assert_allclose(joined.sigma_systematic[PROFILES:][cloud.valid][:8], expected, rtol=0.045)
    np.testing.assert_array_equal(
        joined.sigma_systematic[:PROFILES], np.where(stations[0][0].valid, stations[0][0].sigma_systematic, 0)
    )


def test_rows_and_smoothed_rows_are_joined():
    parts = make_cloud(), make_cloud(seed=1, smoothed=True)
    joined = join_clouds(parts, [np.eye(4)] * 2, [np.zeros((6, 6))] * 2)
    np.testing.assert_array_equal(joined.sigma_row[:PROFILES], parts[0].sigma_random)
    assert (joined.shared_lines[:PROFILES] == 1).all() and not joined.shift_px[:PROFILES].any()
    for name in SMOOTHED:
        np.testing.assert_array_equal(getattr(joined, name)[PROFILES:], getattr(parts[1], name))


@pytest.mark.parametrize("suffix", [".ply", ".npz"])
@pytest.mark.parametrize("smoothed", [False, True])
def test_it_is_read_back(tmp_path, suffix, smoothed):
    parts = [(make_cloud(seed=k, smoothed=smoothed), T, COVARIANCE * k) for k, T in enumerate((np.eye(4), SECOND))]
    save_clouds(parts, tmp_path / f"a{suffix}", calibration_digest="sha256:0123")
    back, joined = load_cloud(tmp_path / f"a{suffix}"), join_clouds(*zip(*parts, strict=True))
    np.testing.assert_array_equal(back.stations.number, joined.stations.number)
    np.testing.assert_array_equal(back.stations.pose, joined.stations.pose)
    # Nine digits in the header of a PLY file.
    np.testing.assert_allclose(back.stations.covariance, joined.stations.covariance, rtol=1e-8, atol=0)
    for name in ("xyz", "normals", "sigma_systematic", "rgb", *(SMOOTHED if smoothed else ())):
        np.testing.assert_array_equal(getattr(back, name)[back.valid], getattr(joined, name)[joined.valid])
    for name in ("angle", "record", "laser", "valid"):
        np.testing.assert_array_equal(getattr(back, name), getattr(joined, name))
    # Written once more, it is the same file.
    save_cloud(back, tmp_path / f"b{suffix}", calibration_digest="sha256:0123")
    first, again = ((tmp_path / f"{name}{suffix}").read_bytes() for name in "ab")
    assert suffix == ".npz" or first == again


def test_e57_has_a_scan_with_its_pose_for_each_station(tmp_path, stations, joined):
    pye57 = pytest.importorskip("pye57", reason="the extra `export` is not installed")
    save_clouds(stations, tmp_path / "a.e57", calibration_digest="sha256:0123")
    file = pye57.E57(str(tmp_path / "a.e57"))
    assert file.scan_count == 2
    guids, names = set(), []
    for k, (cloud, pose, _) in enumerate(stations):
        header, raw = file.get_header(k), file.read_scan_raw(k, ignore_unsupported_fields=True)
        np.testing.assert_allclose(header.rotation_matrix, pose[:3, :3], rtol=0, atol=1e-12)
        np.testing.assert_allclose(header.translation, pose[:3, 3], rtol=0, atol=1e-15)
        local = np.stack([raw[f"cartesian{axis}"] for axis in "XYZ"], -1)
        np.testing.assert_allclose(local, cloud.xyz[cloud.valid], rtol=0, atol=CLOSE_M)
        assert [raw["columnIndex"].tolist(), raw["rowIndex"].tolist()] == [
            list(map(int, i)) for i in cloud.valid.nonzero()
        ]
        # The reader applies the pose by itself.
        carried = file.read_scan(k, transform=True, ignore_missing_fields=True)
        room = np.stack([carried[f"cartesian{axis}"] for axis in "XYZ"], -1)
        expected = joined.xyz[k * PROFILES : (k + 1) * PROFILES][cloud.valid]
        np.testing.assert_allclose(room, expected, rtol=0, atol=CLOSE_M)
        guids.add(header["guid"].value())
        names.append(header["name"].value())
        text = header["description"].value()
        assert "covariance of the pose" in text
        values = np.array(text.split(": ")[1].split(), float)
        np.testing.assert_allclose(values, stations[k][2][np.triu_indices(6)], rtol=1e-8, atol=0)
    file.close()
    assert len(guids) == 2 and names == [f"jaxscan, calibration sha256:0123, station {k}" for k in range(2)]


def test_a_block_of_ptx_carries_its_pose(tmp_path, stations, joined):
    """Each block: size, place, axes, then the motion that a row (x, y, z, 1) is multiplied with from the right."""
    save_clouds(stations, tmp_path / "a.ptx")
    lines = (tmp_path / "a.ptx").read_text().splitlines()
    room, at = [], 0
    while at < len(lines):
        count = int(lines[at]) * int(lines[at + 1])
        motion = np.array([line.split() for line in lines[at + 6 : at + 10]], float)
        rows = np.array([line.split()[:3] for line in lines[at + 10 : at + 10 + count]], float)
        rows = rows[rows.any(1)]
        room.append((np.column_stack([rows, np.ones(len(rows))]) @ motion)[:, :3])
        at += 10 + count
    found, expected = np.concatenate(room), joined.xyz[joined.valid]
    # Micrometres are written; the order is that of the blocks.
    for p, q in zip(*(each[np.lexsort(each.round(4).T)] for each in (found, expected)), strict=True):
        np.testing.assert_allclose(p, q, rtol=0, atol=3e-6)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"comment station 1 ", b"comment statiom 1 ", '"station-covariance 0" is missing or wrong'),
        (b"comment station 0 ", b"comment station 7 ", '"station 0" is missing or wrong: found "station 7'),
        (b"comment station 0 1 0", b"comment station 0 1 1", "no rigid motion"),
        (b"comment station 0 1 0", b"comment station 0 nan 0", "missing or wrong"),
        (b"comment station 0 1 0", b"comment station 0 one 0", "missing or wrong"),
    ],
)
def test_wrong_poses_in_a_ply_file_are_refused(tmp_path, joined, old, new, message):
    path = tmp_path / "a.ply"
    save_cloud(joined, path)
    data = unsealed(path)
    assert data.count(old) == 1
    path.write_bytes(data.replace(old, new))
    with pytest.raises(CloudError, match=message):
        load_cloud(path)


def test_wrong_poses_are_not_written(tmp_path, joined):
    def changed(**fields):
        return dataclasses.replace(joined, stations=joined.stations._replace(**fields))

    mirrored = joined.stations.pose @ np.diag([1.0, 1.0, -1.0, 1.0])
    for cloud, message in (
        (changed(pose=mirrored), "no rigid motion"),
        (changed(covariance=-joined.stations.covariance), "a variance below 0"),
        (changed(number=joined.stations.number + 1), "found stations 1 to 2 and poses of 2"),
        (changed(pose=np.tile(np.eye(4), (65, 1, 1))), "poses of 65"),
    ):
        with pytest.raises(CloudError, match=message):
            save_cloud(cloud, tmp_path / "a.npz")
    assert not list(tmp_path.iterdir())


def test_clouds_that_do_not_belong_together_are_refused(stations, joined):
    short = make_cloud()
    short = type(short)(**{k: v[:, :-1] if np.ndim(v) > 1 else v for k, v in vars(short).items() if v is not None})
    still = [np.eye(4)] * 2, [np.zeros((6, 6))] * 2
    with pytest.raises(CloudError, match="same number of lines"):
        join_clouds([stations[0][0], short], *still)
    with pytest.raises(CloudError, match="joined already"):
        join_clouds([stations[0][0], joined], *still)
