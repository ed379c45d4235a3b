"""Reading clouds of other programs, and of those who mean ill."""

import dataclasses

import numpy as np
import pytest

from jaxscan.errors import CloudError
from jaxscan.files.clouds import load_cloud, save_cloud
from jaxscan.reconstruction import PointCloud

from .clouds import LINES, PROFILES, make_cloud, unsealed
from .conftest import refused


XYZ = np.array([[0.5, 1.5, -2.0], [3.0, 4.0, 5.0], [1e3, 0.0, 0.25]])
RGB = np.array([[255, 0, 7], [1, 2, 3], [9, 9, 9]], np.uint8)


def ply(header, data=b"", path=None):
    text = "ply\n" + "\n".join(header) + "\nend_header\n"
    path.write_bytes(text.encode() + data)
    return path


def vertex(kind="float", count=3, more=()):
    return [f"element vertex {count}", *(f"property {kind} {axis}" for axis in "xyz"), *more]


def test_ascii_with_everything(tmp_path):
    more = [f"property float n{axis}" for axis in "xyz"] + ["property float scalar_intensity", "property int other"]
    rows = ["0.5 1.5 -2 0 0 2 10 1", "3 4 5 nan 0 0 20 1", "nan 0 0 0 1 0 nan 1"]
    path = ply(["format ascii 1.0", *vertex(more=more)], "\n".join(rows).encode(), tmp_path / "a.ply")
    cloud = load_cloud(path)
    assert cloud.valid.tolist() == [[True, True, False]]
    assert np.array_equal(cloud.xyz[0, :2], XYZ[:2])
    # Normals become unit vectors, or zero where there are none; invalid cells are zero, never NaN.
    assert cloud.normals.tolist() == [[[0, 0, 1], [0, 0, 0], [0, 0, 0]]]
    assert cloud.intensity.tolist() == [[10, 20, 0]]
    assert not cloud.xyz[0, 2].any()


def test_smoothed_points_without_their_grid_claim_what_their_rows_are_worth(tmp_path):
    cloud = make_cloud(smoothed=True)
    save_cloud(cloud, tmp_path / "a.ply")
    whole = unsealed(tmp_path / "a.ply")
    (tmp_path / "a.ply").write_bytes(whole.replace(b"property int scalar_step", b"property int scalar_strp"))
    back = load_cloud(tmp_path / "a.ply")
    assert np.array_equal(back.sigma_random[0], cloud.sigma_row[cloud.valid]) and back.shared_lines is None
    (tmp_path / "a.ply").write_bytes(whole.replace(b"float scalar_sigma_row", b"float scalar_sigma_rox"))
    assert not load_cloud(tmp_path / "a.ply").sigma_random.any()


@pytest.mark.parametrize(
    ("name", "value"), [("sigma_row", -1.0), ("shared_lines", -1.0), ("shared_lines", 1001.0), ("shift_px", np.inf)]
)
@pytest.mark.parametrize("suffix", [".ply", ".npz"])
def test_impossible_numbers_of_smoothed_points_are_refused(tmp_path, suffix, name, value):
    cloud = make_cloud(smoothed=True)
    getattr(cloud, name)[0, 0] = value
    with pytest.raises(CloudError, match=name):
        save_cloud(cloud, tmp_path / f"a{suffix}")


def test_ours_without_the_profiles(tmp_path):
    cloud = make_cloud()
    save_cloud(cloud, tmp_path / "a.ply")
    data = unsealed(tmp_path / "a.ply")
    (tmp_path / "a.ply").write_bytes(data.replace(b"element profile", b"element another"))
    back = load_cloud(tmp_path / "a.ply")
    assert np.array_equal(back.valid, cloud.valid)
    seen = cloud.valid.any(1)
    assert np.array_equal(back.laser[seen], cloud.laser[seen])
    # Of the vertices, in single precision.
    assert np.array_equal(back.angle[seen], cloud.angle[seen].astype(np.float32)) and not back.angle[~seen].any()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"end_header\n", b"end_heador\n", "not a PLY file, or its header does not end"),
        (b"jaxscan-cloud/1", b"jaxscan-cloud/3", "found jaxscan-cloud/3, expected jaxscan-cloud/1"),
        (b"comment grid 6 5", b"comment grid 6", "is missing or wrong"),
        (b"comment grid 6 5", b"comment grid 5 5", "found 6 profiles, expected 5"),
        (b"comment grid 6 5", b"comment grid 7 5", "found 6 profiles, expected 7"),
        (b"comment grid 6 5", b"comment grid 99999999 99999999", "more than"),
        (b"comment grid 6 5", b"comment grid -6 5", "is missing or wrong"),
        (b"element vertex ", b"element vertex 9999999999", "the file ends before"),
        (b"element vertex ", b"element vertex -", 'found "element vertex -'),
        (b"element profile 6", b"element profile 7", "announces 7 of profile, but the file ends before"),
        (b"property float x", b"property list uchar float x", "items is longer than the file"),
        (b"property float x", b"property half x", 'found "property half x"'),
        (b"property float y", b"property float x", "the header is wrong"),
        (b"property float x", b"property float q", "no x, y and z"),
        (b"binary_little_endian 1.0", b"binary_middle_endian 1.0", "which PLY does not know"),
        (b"format binary_little_endian 1.0\n", b"", "names no known format"),
    ],
)
def test_wrong_headers(tmp_path, old, new, message):
    path = tmp_path / "a.ply"
    save_cloud(make_cloud(), path)
    data = unsealed(path)
    assert data.count(old) == 1
    path.write_bytes(data.replace(old, new))
    refused(CloudError, lambda: load_cloud(path), message, "a.ply")


def test_points_that_share_a_cell_or_are_not_finite(tmp_path):
    path = tmp_path / "a.ply"
    save_cloud(make_cloud(), path)
    head, body = unsealed(path).split(b"end_header\n")
    # A vertex has 11 floats, 3 colours, 2 ints and a laser: 56 bytes.
    path.write_bytes(head + b"end_header\n" + body[:56] + body[:56] + body[112:])
    with pytest.raises(CloudError, match="two points have the same step and row"):
        load_cloud(path)
    path.write_bytes(head + b"end_header\n" + np.float32(np.nan).tobytes() + body[4:])
    with pytest.raises(CloudError, match="x of a point is not finite"):
        load_cloud(path)


@pytest.mark.parametrize(
    ("count", "rows", "message"),
    [
        (3, "1.0 2 3\n4 5\n7 8 9", "not a readable .ply file"),
        (3, "1 2 3\n4 5 six\n7 8 9", "not a readable .ply file"),
        (3, "1.00 2.00 3.00\n4 5 6\n  \n ", "found (2, 3)"),
        (0, "", "holds no points"),
        (1, "nan nan nan", "holds no finite point"),
        (1, "0 -1.7e308 0", "expected at most 1e+15"),
    ],
)
def test_broken_ascii(tmp_path, count, rows, message):
    path = ply(["format ascii 1.0", *vertex("double", count)], rows.encode(), tmp_path / "a.ply")
    refused(CloudError, lambda: load_cloud(path), message, "a.ply")


def npz(path, **arrays):
    save_cloud(make_cloud(), path)
    with np.load(path) as good:
        np.savez(path, **{**{name: good[name] for name in good.files}, **arrays})
    return path


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"xyz": np.zeros((PROFILES, LINES, 2), np.float32)}, "xyz: found float32 with shape (6, 5, 2), expected"),
        ({"angle": np.zeros(PROFILES + 1)}, "angle: found float64 with shape (7,), expected floating with shape (6,)"),
        ({"angle": np.full(PROFILES, np.nan)}, "angle is not finite"),
        ({"format": np.array("something")}, "found the format 'something', expected 'jaxscan-cloud/1'"),
    ],
)
def test_wrong_npz(tmp_path, arrays, message):
    refused(CloudError, lambda: load_cloud(npz(tmp_path / "a.npz", **arrays)), message)


NATIONAL = np.array([4500000.123, 600000.456, 300.789])
"""A place in a national grid [m]: single precision rounds it to half a metre."""


@pytest.fixture
def national(tmp_path):
    """A cloud of another program with doubles, as it is read."""
    points = NATIONAL + np.random.default_rng(0).uniform(-30, 30, (50, 3))
    path = ply(["format binary_little_endian 1.0", *vertex("double", 50)], points.tobytes(), tmp_path / "n.ply")
    return points, load_cloud(path)


@pytest.mark.parametrize("suffix", [".ply", ".npz"])
def test_doubles_come_back_to_the_last_bit(tmp_path, national, suffix):
    points, cloud = national
    save_cloud(cloud, tmp_path / f"b{suffix}")
    back = load_cloud(tmp_path / f"b{suffix}")
    assert back.xyz.dtype == np.float64 and np.array_equal(back.xyz[0], points)


@pytest.mark.parametrize("suffix", [".las", ".laz"])
@pytest.mark.parametrize(("reach_m", "step_m"), [(30.0, 1e-4), (3e5, 1e-3)])
def test_las_moves_its_origin_to_far_clouds(tmp_path, suffix, reach_m, step_m):
    laspy = pytest.importorskip("laspy", reason="the extra `export` is not installed")
    points = NATIONAL + np.random.default_rng(0).uniform(-reach_m, reach_m, (50, 3))
    header = ["format binary_little_endian 1.0", *vertex("double", 50)]
    save_cloud(load_cloud(ply(header, points.tobytes(), tmp_path / "n.ply")), tmp_path / f"b{suffix}")
    found = np.asarray(laspy.read(tmp_path / f"b{suffix}").xyz)
    assert np.abs(found - points).max() <= 0.51 * step_m


@pytest.mark.parametrize("far", [1e10, 0.9e15])
def test_las_refuses_points_too_far_apart(tmp_path, far):
    pytest.importorskip("laspy", reason="the extra `export` is not installed")
    points = np.array([[0.0, 0, 0], [far, 0, 0], [-far, 0, 0]])
    cloud = load_cloud(
        ply(["format binary_little_endian 1.0", *vertex("double")], points.tobytes(), tmp_path / "n.ply")
    )
    with pytest.raises(CloudError, match=r"LAS holds points at most 4295 km apart, and these are"):
        save_cloud(cloud, tmp_path / "b.laz")
    for suffix in (".ply", ".xyz", ".pcd", ".npz"):
        save_cloud(cloud, tmp_path / f"b{suffix}")


def test_rows_beyond_65535_keep_their_number_in_e57(tmp_path):
    pye57 = pytest.importorskip("pye57", reason="the extra `export` is not installed")
    points = np.random.default_rng(0).uniform(-1, 1, (70000, 3)).astype(np.float32)
    path = ply(["format binary_little_endian 1.0", *vertex(count=70000)], points.tobytes(), tmp_path / "n.ply")
    # As a cloud of one long profile, which has rows.
    save_cloud(dataclasses.replace(load_cloud(path), absent=None), tmp_path / "b.e57")
    file = pye57.E57(str(tmp_path / "b.e57"))
    bounds = file.get_header(0).node["indexBounds"]
    # pye57's reader has 16 bits for a row; the bounds are written apart from the points.
    assert bounds["rowMaximum"].value() == 69999


def test_fewer_points_than_the_file_holds_are_noticed(tmp_path):
    path = tmp_path / "a.ply"
    save_cloud(make_cloud(), path)
    data = unsealed(path)
    count = np.count_nonzero(make_cloud().valid)
    path.write_bytes(data.replace(b"element vertex %d" % count, b"element vertex %d" % (count // 2)))
    with pytest.raises(CloudError, match=r"goes on after the data that its header announces"):
        load_cloud(path)
    for rest, fits in ((b"\n", True), (b"\0", False), (b"\n" * 100_000 + b"x", False)):
        path.write_bytes(data + rest)
        if fits:
            load_cloud(path)
        else:
            with pytest.raises(CloudError, match="goes on after the data"):
                load_cloud(path)


@pytest.mark.parametrize("name", ["x", "nx", "sigma_random", "step", "row", "laser"])
def test_ours_with_a_property_line_missing_is_damaged(tmp_path, name):
    path = tmp_path / "a.ply"
    save_cloud(make_cloud(), path)
    kind = {"step": "int", "row": "int", "laser": "uchar"}.get(name, "float")
    spelled = name if name in ("x", "nx") else f"scalar_{name}"
    data = unsealed(path)
    assert data.count(f"property {kind} {spelled}\n".encode()) == 1
    path.write_bytes(data.replace(f"property {kind} {spelled}\n".encode(), b"", 1))
    with pytest.raises(CloudError):
        load_cloud(path)


@pytest.mark.parametrize("name", ["sigma_random", "sigma_systematic"])
def test_ours_with_one_sigma_lost_claims_none(tmp_path, name):
    cloud = make_cloud()
    save_cloud(cloud, tmp_path / "a.ply")
    data = unsealed(tmp_path / "a.ply")
    data = data.replace(f"float scalar_{name}".encode(), f"float scalar_{name[:-1]}x".encode(), 1)
    (tmp_path / "a.ply").write_bytes(data)
    back = load_cloud(tmp_path / "a.ply")
    assert np.array_equal(back.xyz[0], cloud.xyz[cloud.valid])
    assert not back.sigma_random.any() and not back.sigma_systematic.any()


@pytest.mark.parametrize("suffix", [".ply", ".npz"])
def test_a_negative_sigma_is_refused(tmp_path, suffix):
    cloud = make_cloud()
    sigma = cloud.sigma_systematic.copy()
    # What is not valid may hold anything.
    sigma[2, 0] = -1.0
    save_cloud(dataclasses.replace(cloud, sigma_systematic=sigma), tmp_path / f"a{suffix}")
    load_cloud(tmp_path / f"a{suffix}")
    data = unsealed(tmp_path / f"a{suffix}")
    with pytest.raises(CloudError, match="sigma_systematic of a valid point is negative"):
        save_cloud(dataclasses.replace(cloud, sigma_systematic=-cloud.sigma_systematic), tmp_path / f"b{suffix}")
    value = cloud.sigma_systematic[0, 0].tobytes()
    damaged = data.replace(value, (-cloud.sigma_systematic[0, 0]).tobytes(), 1)
    assert damaged != data
    if suffix == ".npz":
        with pytest.raises(CloudError, match="negative"):
            load_cloud(npz(tmp_path / "c.npz", sigma_systematic=-cloud.sigma_systematic))
        return
    (tmp_path / "c.ply").write_bytes(damaged)
    with pytest.raises(CloudError, match="negative"):
        load_cloud(tmp_path / "c.ply")


@pytest.mark.parametrize("laser", [-1, 2**31 - 1])
def test_an_impossible_laser_is_refused(tmp_path, laser):
    with pytest.raises(CloudError, match=f"found laser {laser}, expected 0 to 255"):
        load_cloud(npz(tmp_path / "a.npz", laser=np.full(PROFILES, laser)))


def test_a_grid_is_no_larger_than_its_points_can_need(tmp_path):
    """492 bytes ask for 13 GB."""
    path = tmp_path / "a.ply"
    save_cloud(make_cloud(), path)
    whole = load_cloud(path)
    data = unsealed(path).replace(b"element profile", b"element another")
    path.write_bytes(data.replace(b"comment grid 6 5", b"comment grid 16384 16384"))
    points = load_cloud(path)
    assert points.valid.shape == (1, np.count_nonzero(whole.valid))
    for field in ("xyz", "rgb", "intensity", "sigma_random", "sigma_systematic"):
        assert np.array_equal(getattr(points, field)[0], getattr(whole, field)[whole.valid])
    path.write_bytes(data.replace(b"comment grid 6 5", b"comment grid 16384 16385"))
    with pytest.raises(CloudError, match=r"found a grid of 16384 x 16385, none or more than the 268435456 cells"):
        load_cloud(path)
    # A damaged point is found without its grid too.
    path.write_bytes(data.replace(b"comment grid 6 5", b"comment grid 2 134217728"))
    with pytest.raises(CloudError, match="a point lies outside the grid"):
        load_cloud(path)
    path.write_bytes(data.replace(b"comment grid 6 5", b"comment grid 2048 2048"))
    assert load_cloud(path).valid.shape == (2048, 2048)


def test_a_large_and_almost_empty_cloud_of_ours_is_read(tmp_path):
    """7200 profiles of 4096 lines, as of a rig in the open air, with two points."""
    profiles, lines = 7200, 4096
    valid = np.zeros((profiles, lines), bool)
    valid[3, 5] = valid[7000, 4000] = True

    def spread(value, kind=np.float32):
        # A view: the fields of such a grid take a gigabyte.
        return np.broadcast_to(np.array(value, kind), valid.shape + np.shape(value))

    numbers = np.arange(profiles, dtype=np.int32)
    cloud = PointCloud(
        xyz=spread([1, 2, 3]),
        rgb=spread([4, 5, 6], np.uint8),
        intensity=spread(7),
        normals=spread([0, 0, 1]),
        sigma_random=spread(0.5),
        sigma_systematic=spread(0.25),
        valid=valid,
        record=numbers,
        laser=np.zeros(profiles, np.int32),
        angle=numbers / 1e3,
    )
    save_cloud(cloud, tmp_path / "a.ply")
    assert load_cloud(tmp_path / "a.ply").xyz.tolist() == [[[1, 2, 3], [1, 2, 3]]]


LONG = "q" * 5000


@pytest.mark.parametrize(
    ("header", "data"),
    [
        (["format ascii 1.0", *vertex(count=1)], LONG.encode()),
        (["format ascii 1.0", f"element {LONG} 9"], b""),
        (["format ascii 1.0", "element vertex 1", *[f"property float {LONG}"] * 2], b"1 2"),
        (["format ascii 1.0", f"comment jaxscan-cloud/{LONG}", *vertex(count=1)], b"1 2 3"),
    ],
)
def test_quoted_text_is_cut(tmp_path, header, data):
    said = refused(CloudError, lambda: load_cloud(ply(header, data, tmp_path / "a.ply")))
    assert len(said) < 300 + len(str(tmp_path))
