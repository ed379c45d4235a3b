"""What clouds keep on their way through other formats and programs: names, grid, frame, digest, map."""

import dataclasses

import numpy as np
import pytest

from jaxscan.errors import CloudError, DependencyError
from jaxscan.files.clouds import load_cloud, read_cloud, save_cloud, save_clouds, shifted
from jaxscan.reconstruction import SMOOTHED, PointCloud, join_clouds

from .clouds import LINES, PROFILES, make_cloud
from .test_joined_clouds import COVARIANCE, SECOND


STATING = (".e57", ".las", ".laz", ".npz", ".pcd", ".ply")
"""Formats with room for the header of ours."""
TEXTS = (".ptx", ".xyz")
NEEDS = {".e57": "pye57", ".las": "laspy", ".laz": "laspy"}
MAP = (356000.25, 5400000.5, 312.125)


def needed(suffix):
    if suffix in NEEDS:
        pytest.importorskip(NEEDS[suffix], reason="the extra `export` is not installed")


def room(*, turn=1.0, down=True, at=(0.3, -0.2)):
    """A room of 5 x 4 x 2.6 m seen from within by a grid of 90 x 40 rays; `turn` is the sense of the table."""
    angle = turn * np.linspace(0.1, 6.1, 90)
    rise = np.radians(np.linspace(50, -50, 40)[:: 1 if down else -1])
    a, e = np.meshgrid(angle, rise, indexing="ij")
    rays = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], -1)
    low, high = np.array([-2.5 - at[0], -2 - at[1], -1.2]), np.array([2.5 - at[0], 2 - at[1], 1.4])
    far = np.where(rays > 0, high / rays, low / rays).min(-1)
    xyz = (rays * far[..., None]).astype(np.float32)
    grid = far.shape
    return PointCloud(
        xyz=xyz,
        rgb=np.full((*grid, 3), 90, np.uint8),
        intensity=np.full(grid, 100, np.float32),
        normals=np.zeros((*grid, 3), np.float32),
        sigma_random=np.full(grid, 1e-3, np.float32),
        sigma_systematic=np.full(grid, 2e-3, np.float32),
        valid=np.ones(grid, bool),
        record=np.arange(90, dtype=np.int32),
        laser=np.zeros(90, np.int32),
        angle=angle,
    )


def same(back, cloud, *, names=("xyz", "rgb", "normals", "intensity", "sigma_random", "sigma_systematic")):
    for name in names:
        assert np.array_equal(getattr(back, name)[cloud.valid], getattr(cloud, name)[cloud.valid]), name


# --- names


@pytest.mark.parametrize("smoothed", [False, True])
def test_files_with_the_old_names_are_read(tmp_path, smoothed):
    cloud = make_cloud(smoothed=smoothed)
    save_cloud(cloud, tmp_path / "a.ply", calibration_digest="sha256:0123")
    data = (tmp_path / "a.ply").read_bytes()
    assert data.count(b" scalar_") == 8 + 3 * smoothed
    (tmp_path / "a.ply").write_bytes(data.replace(b" scalar_", b" "))
    stored = read_cloud(tmp_path / "a.ply")
    same(stored.cloud, cloud)
    assert np.array_equal(stored.cloud.angle, cloud.angle) and stored.about.calibration == "sha256:0123"
    assert all((getattr(stored.cloud, name) is not None) == smoothed for name in SMOOTHED)


def as_another_program(cloud, path, *, drop=(), change=()):
    """A PLY of floats with the columns of ours, without its comments, as CloudCompare writes it."""
    points = cloud.points()
    values = {"x": points.xyz[:, 0], "y": points.xyz[:, 1], "z": points.xyz[:, 2]}
    for name in ("intensity", "sigma", "sigma_random", "sigma_systematic", "step", "row", "laser"):
        values[f"scalar_{name}"] = getattr(points, name)
    values["scalar_angle"] = cloud.angle[points.step]
    values |= {f"scalar_{name}": getattr(points, name) for name in SMOOTHED if getattr(points, name) is not None}
    values = {name: value for name, value in values.items() if name not in drop} | dict(change)
    table = np.stack([np.asarray(value, np.float32) for value in values.values()], -1)
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(table)}"]
    head += [f"property float {name}" for name in values]
    path.write_bytes("\n".join([*head, "end_header", ""]).encode() + table.tobytes())
    return path


def test_the_grid_is_regained_from_the_columns_that_another_program_kept(tmp_path):
    cloud = make_cloud()
    back = load_cloud(as_another_program(cloud, tmp_path / "a.ply"))
    # The last line, and profiles after the last point, are known by nobody.
    profiles, lines = back.valid.shape
    assert np.array_equal(back.valid, cloud.valid[:profiles, :lines])
    assert not cloud.valid[profiles:].any() and not cloud.valid[:, lines:].any()
    seen = cloud.valid.any(1)[:profiles]
    assert np.array_equal(back.laser[seen], cloud.laser[:profiles][seen])
    assert np.allclose(back.angle[seen], cloud.angle[:profiles][seen], rtol=1e-7, atol=0)
    for name in ("xyz", "sigma_random", "sigma_systematic", "intensity"):
        assert np.array_equal(getattr(back, name)[back.valid], getattr(cloud, name)[cloud.valid]), name


COUNT = int(make_cloud().valid.sum())


@pytest.mark.parametrize(
    "change",
    [
        {"scalar_step": np.zeros(COUNT), "scalar_row": np.zeros(COUNT)},
        {"scalar_step": np.arange(COUNT) + 0.5},
        {"scalar_step": -np.arange(COUNT)},
        {"scalar_row": np.full(COUNT, np.nan)},
        {"scalar_row": np.full(COUNT, 1e9)},
        {"scalar_laser": np.full(COUNT, 300.0)},
        {"scalar_step": np.arange(COUNT) * 1e6, "scalar_row": np.arange(COUNT) * 1e2},
    ],
    ids=["one cell", "halves", "negative", "no number", "large", "laser", "sparse"],
)
def test_columns_that_are_no_grid_any_more_leave_the_points(tmp_path, change):
    cloud = make_cloud()
    back = load_cloud(as_another_program(cloud, tmp_path / "a.ply", change=change))
    assert back.valid.shape == (1, COUNT)
    assert np.array_equal(back.xyz[0], cloud.xyz[cloud.valid])
    assert np.array_equal(back.sigma_random[0], cloud.sigma_random[cloud.valid])


# --- digest, map, stations


@pytest.mark.parametrize("suffix", [*STATING, *TEXTS])
def test_digest_and_code_come_back(tmp_path, suffix):
    needed(suffix)
    pytest.importorskip("pyproj", reason="the extra `export` is not installed")
    save_cloud(make_cloud(), tmp_path / f"a{suffix}", calibration_digest="sha256:0123", epsg=25832)
    about = read_cloud(tmp_path / f"a{suffix}").about
    text = suffix in TEXTS
    assert about.calibration == ("" if text else "sha256:0123")
    assert about.epsg == (None if text else 25832)
    # The one format that says nothing at all.
    assert (about.in_metres, about.upright) == ((False, False) if suffix == ".xyz" else (True, True))


@pytest.mark.parametrize("suffix", [".las", ".laz", ".e57"])
def test_a_map_is_stated_as_wkt(tmp_path, suffix):
    needed(suffix)
    pyproj = pytest.importorskip("pyproj", reason="the extra `export` is not installed")
    save_cloud(make_cloud(), tmp_path / f"a{suffix}", epsg=5555)
    if suffix == ".e57":
        import pye57

        file = pye57.E57(str(tmp_path / "a.e57"))
        wkt = file.root["coordinateMetadata"].value()
        file.close()
    else:
        import laspy

        wkt = laspy.read(tmp_path / f"a{suffix}").header.vlrs.get("WktCoordinateSystemVlr")[0].string
    assert pyproj.CRS.from_wkt(wkt).to_epsg() == 5555


@pytest.mark.parametrize(
    ("code", "says"),
    [
        (4326, "EPSG:4326: is WGS 84, whose coordinates are not metres on a map"),
        (2263, "whose coordinates are not metres"),
        (4978, "whose coordinates are not metres"),
        (999999, "EPSG:999999: no coordinate reference system has this code"),
    ],
)
@pytest.mark.parametrize("suffix", [".las", ".e57"])
def test_codes_that_are_no_map_in_metres_are_refused(tmp_path, suffix, code, says):
    needed(suffix)
    pytest.importorskip("pyproj", reason="the extra `export` is not installed")
    with pytest.raises(CloudError, match=says):
        save_cloud(make_cloud(), tmp_path / f"a{suffix}", epsg=code)
    assert not list(tmp_path.iterdir())


def test_a_code_without_pyproj_says_what_to_install(tmp_path, monkeypatch):
    needed(".las")
    monkeypatch.setitem(__import__("sys").modules, "pyproj", None)
    with pytest.raises(DependencyError, match=r'EPSG code needs pyproj: pip install "jaxscan\[export\]"'):
        save_cloud(make_cloud(), tmp_path / "a.las", epsg=25832)


# Of LAS 0.1 mm; of others a nanometre, which doubles of 5.4e6 have; of text a micrometre.
ERRORS_M = {".las": 0.51e-4, ".laz": 0.51e-4, ".xyz": 0.51e-6, ".ptx": 0.51e-6}


@pytest.mark.parametrize("suffix", [*STATING, *TEXTS])
def test_a_cloud_on_a_map_comes_back(tmp_path, suffix):
    needed(suffix)
    cloud = make_cloud()
    moved = shifted(cloud, MAP)
    save_cloud(moved, tmp_path / f"a{suffix}")
    back = load_cloud(tmp_path / f"a{suffix}")
    expected = cloud.xyz[cloud.valid].astype(float) + MAP
    found = back.xyz[back.valid]
    assert found.dtype == np.float64
    if suffix == ".ptx":
        found, expected = (each[np.lexsort(each.round(3).T)] for each in (found, expected))
    assert np.abs(found - expected).max() <= ERRORS_M.get(suffix, 0) + 2e-9
    if suffix != ".xyz":
        assert np.array_equal(back.stations.pose[:, :3, 3], [MAP])


@pytest.mark.parametrize("suffix", [".ply", ".npz", ".pcd", ".las", ".laz", ".e57"])
@pytest.mark.parametrize("smoothed", [False, True])
def test_stations_come_back(tmp_path, suffix, smoothed):
    needed(suffix)
    parts = [(make_cloud(seed=k, smoothed=smoothed), T, COVARIANCE * k) for k, T in enumerate((np.eye(4), SECOND))]
    save_clouds(parts, tmp_path / f"a{suffix}")
    back = load_cloud(tmp_path / f"a{suffix}")
    seen = np.concatenate([cloud.valid for cloud, _, _ in parts])
    assert np.array_equal(back.valid, seen)
    known = seen.any(1)
    assert np.array_equal(back.stations.number[known], np.repeat([0, 1], PROFILES)[known])
    np.testing.assert_allclose(back.stations.pose, [np.eye(4), SECOND], rtol=0, atol=1e-12)
    np.testing.assert_allclose(back.stations.covariance[1], COVARIANCE, rtol=1e-8, atol=0)
    # Singles, twice turned; LAS has steps of 0.1 mm.
    error_m = 0.53e-4 if suffix in (".las", ".laz") else 2e-6
    expected = parts[1][0].xyz[parts[1][0].valid].astype(float) @ SECOND[:3, :3].T + SECOND[:3, 3]
    np.testing.assert_allclose(back.xyz[PROFILES:][parts[1][0].valid], expected, rtol=0, atol=error_m)


# --- the single formats


def towards(cells):
    """Share of cells of a grid [column, row] whose normal, right times up, is on the side of the scanner."""
    right, up = cells[1:, :-1] - cells[:-1, :-1], cells[:-1, 1:] - cells[:-1, :-1]
    return np.mean(np.einsum("ijk,ijk->ij", np.cross(right, up), -cells[:-1, :-1]) > 0)


@pytest.mark.parametrize("turn", [1.0, -1.0])
@pytest.mark.parametrize("down", [False, True])
def test_columns_of_ptx_run_upwards_and_to_the_right(tmp_path, turn, down):
    cloud = room(turn=turn, down=down)
    save_cloud(cloud, tmp_path / "a.ptx")
    lines = (tmp_path / "a.ptx").read_text().splitlines()
    assert lines[:2] == ["90", "40"]
    cells = np.array([line.split()[:3] for line in lines[10:]], float).reshape(90, 40, 3)
    # But for the cells across an edge of the room.
    assert towards(cells) > 0.95
    assert np.mean(np.diff(cells[..., 2], axis=1) >= 0) > 0.95
    back = load_cloud(tmp_path / "a.ptx")
    assert back.valid.shape == (90, 40) and back.valid.all() and np.array_equal(back.rgb, cloud.rgb)
    # To 1e-6 of 255 DN, and of 1 m.
    assert np.abs(back.intensity - 100).max() < 255e-6
    assert np.abs(np.sort(back.xyz.reshape(-1, 3), 0) - np.sort(cloud.xyz.reshape(-1, 3), 0)).max() < 0.6e-6


def test_no_intensity_of_ptx_is_clipped(tmp_path):
    cloud = room()
    cloud.intensity[:] = np.linspace(1, 1000, cloud.intensity.size).reshape(cloud.intensity.shape)
    save_cloud(cloud, tmp_path / "a.ptx")
    levels = np.array([line.split()[3] for line in (tmp_path / "a.ptx").read_text().splitlines()[10:]], float)
    assert len(np.unique(levels)) == cloud.intensity.size and levels.max() == 1


def test_pcd_holds_the_grid(tmp_path):
    cloud = make_cloud()
    save_cloud(cloud, tmp_path / "a.pcd", calibration_digest="sha256:0123")
    head, body = (tmp_path / "a.pcd").read_bytes().split(b"DATA binary\n")
    for line in (b"WIDTH %d" % LINES, b"HEIGHT %d" % PROFILES, b"POINTS %d" % (LINES * PROFILES)):
        assert line + b"\n" in head
    xyz = np.frombuffer(body, [("xyz", "<f4", 3), ("rest", "V53")])["xyz"].reshape(PROFILES, LINES, 3)
    assert np.array_equal(np.isfinite(xyz).all(-1), cloud.valid)
    assert np.array_equal(xyz[cloud.valid], cloud.xyz[cloud.valid])
    # A cloud of another program has no grid, and an almost empty one would be large.
    valid = np.zeros((PROFILES, LINES), bool)
    valid[0, 0] = True
    save_cloud(dataclasses.replace(cloud, valid=valid), tmp_path / "b.pcd")
    assert b"HEIGHT 1\n" in (tmp_path / "b.pcd").read_bytes()
    assert np.array_equal(load_cloud(tmp_path / "b.pcd").valid, valid)


def test_a_scan_of_e57_says_what_it_is(tmp_path):
    needed(".e57")
    import time

    import pye57

    cloud = make_cloud()
    save_cloud(cloud, tmp_path / "a.e57", calibration_digest="sha256:0123")
    file = pye57.E57(str(tmp_path / "a.e57"))
    header = file.get_header(0)
    assert header["name"].value() == "jaxscan, calibration sha256:0123"
    assert "calibration sha256:0123" in header["description"].value()
    assert len(header["guid"].value()) == 38 and header.has_pose()
    # Of today, in seconds since 1980-01-06 with 18 leap seconds.
    written = file.root["creationDateTime"]["dateTimeValue"].value() + 315964800 - 18
    assert abs(written - time.time()) < 3600
    libe57, fields, buffers = pye57.libe57, {}, pye57.libe57.VectorSourceDestBuffer()
    for name in ("nor:normalX", "jaxscan:sigma_random", "jaxscan:sigma_systematic", "jaxscan:sigma"):
        assert name in header.point_fields
        fields[name] = np.empty(header.point_count, np.float32)
        buffers.append(libe57.SourceDestBuffer(file.image_file, name, fields[name], header.point_count, True, True))
    header.points.reader(buffers).read()
    uris = {file.image_file.extensionsUri(k) for k in range(file.image_file.extensionsCount())}
    file.close()
    assert "http://www.libe57.org/E57_EXT_surface_normals.txt" in uris
    assert np.array_equal(fields["nor:normalX"], cloud.normals[cloud.valid][:, 0])
    assert np.array_equal(fields["jaxscan:sigma_random"], cloud.sigma_random[cloud.valid])


SEALED = (".ply", ".pcd")


@pytest.mark.parametrize("suffix", SEALED)
@pytest.mark.parametrize("joined", [False, True])
def test_any_changed_bit_is_noticed(tmp_path, monkeypatch, suffix, joined):
    """Neither format has a checksum of its own; the digest is taken a block at a time."""
    monkeypatch.setattr("jaxscan.files.clouds.header._BLOCK_BYTES", 100)
    cloud = make_cloud()
    if joined:
        cloud = join_clouds([cloud, make_cloud(seed=1)], [np.eye(4)] * 2, [np.zeros((6, 6))] * 2)
    path = tmp_path / f"a{suffix}"
    save_cloud(cloud, path, calibration_digest="sha256:0123")
    whole = path.read_bytes()
    assert np.array_equal(load_cloud(path).xyz[cloud.valid], cloud.xyz[cloud.valid])
    line = range(whole.index(b"seal"), whole.index(b" bytes\n") + 7)
    unnoticed = []
    for at in range(0, len(whole), 7):
        data = bytearray(whole)
        data[at] ^= 1 << at % 8
        path.write_bytes(data)
        try:
            load_cloud(path)
            unnoticed.append(at)
        except CloudError:
            pass
    # Without its line the file is one of another program.
    assert set(unnoticed) <= set(line)
    place = whole.index(b"0123") + 1
    path.write_bytes(whole[:place] + b"7" + whole[place + 1 :])
    with pytest.raises(CloudError, match=f"{path.name}: has changed since it was written: found digest"):
        load_cloud(path)
    # As the message says.
    start = whole.rindex(b"\n", 0, line.start) + 1
    path.write_bytes(whole[:start] + whole[line.stop :])
    assert np.array_equal(load_cloud(path).xyz[cloud.valid], cloud.xyz[cloud.valid])


@pytest.mark.parametrize("suffix", SEALED)
def test_another_programs_header_frees_it_from_the_digest(tmp_path, suffix):
    """Such a program may keep our comments, digest and all, and change the points."""
    path = tmp_path / f"a{suffix}"
    save_cloud(make_cloud(), path)
    head, body = path.read_bytes().split(b"seal", 1)
    comment = b"comment " if suffix == ".ply" else b"# "
    changed = bytearray(head + b"Created by another program\n" + comment + b"seal" + body)
    changed[-200:-196] = bytes(4)
    path.write_bytes(changed)
    load_cloud(path)
