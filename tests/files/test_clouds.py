"""Cloud files. Every format inherits `WriterContract` and is read by a library that is not ours."""

import dataclasses
import functools
import os
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.errors import CloudError, DependencyError
from jaxscan.files.clouds import WRITERS, load_cloud, save_cloud
from jaxscan.files.clouds import clouds as clouds_module
from jaxscan.reconstruction import SMOOTHED
from jaxscan.surface import load_open3d

from .clouds import LINES, PROFILES, make_cloud


@functools.cache
def open3d():
    """Open3D, or a skip that says why."""
    try:
        return load_open3d()
    except DependencyError as problem:
        assert not os.environ.get("JAXSCAN_REQUIRE_OPEN3D"), str(problem)
        pytest.skip(f"Open3D does not load: {problem}")


class WriterContract:
    """The values that every format keeps. A subclass names the suffix, and how a program that is not ours reads it."""

    suffix = ""
    xyz_error = 1e-3
    """How far a coordinate may move, m: nothing, where the format holds float32."""
    intensity_of = staticmethod(lambda dn: dn)

    def read(self, path):
        """Columns of the file: xyz [n, 3], and further columns of the format. By default our own reader tells them."""
        cloud = load_cloud(path)
        points = cloud.points()
        names = {"rgb", "normals", "intensity", "sigma_random", "sigma_systematic"} - set(cloud.lacks)
        return {name: getattr(points, name) for name in ("xyz", *names)}

    def expected(self, cloud):
        """The points in the order of the file."""
        step, row = np.nonzero(cloud.valid)
        return step, row

    @pytest.fixture
    def path(self, tmp_path):
        return tmp_path / f"room{self.suffix}"

    @pytest.mark.parametrize("smoothed", [False, True])
    def test_round_trip(self, path, smoothed):
        cloud = make_cloud(smoothed=smoothed)
        save_cloud(cloud, path, calibration_digest="sha256:0123")
        columns = self.read(path)
        step, row = self.expected(cloud)
        # The poison of masked entries is far outside the room: one that slipped in is seen.
        assert columns["xyz"].shape == (np.count_nonzero(cloud.valid), 3)
        assert np.abs(columns["xyz"] - cloud.xyz[step, row]).max() <= self.xyz_error
        sigma = np.hypot(cloud.sigma_random, cloud.sigma_systematic)
        wanted = {
            "rgb": cloud.rgb[step, row],
            "normals": cloud.normals[step, row],
            "intensity": self.intensity_of(cloud.intensity[step, row]),
            "sigma": sigma[step, row],
            "sigma_random": cloud.sigma_random[step, row],
            "sigma_systematic": cloud.sigma_systematic[step, row],
            "step": step,
            "row": row,
            "laser": cloud.laser[step],
        }
        if smoothed:
            wanted |= {name: getattr(cloud, name)[step, row] for name in SMOOTHED}
        # A format that holds the sigma of a point holds the lines too that share its noise.
        assert set(SMOOTHED) & columns.keys() == (set(SMOOTHED) if smoothed and "sigma_random" in columns else set())
        for name in columns.keys() - {"xyz"}:
            assert np.array_equal(columns[name].astype(wanted[name].dtype), wanted[name]), name

    def test_double_precision_and_jax_arrays_are_taken(self, path):
        wide = make_cloud(dtype=np.float64)
        save_cloud(jax.tree.map(jnp.asarray, wide), path)
        first = self.read(path)["xyz"]
        step, row = self.expected(wide)
        assert np.abs(first - wide.xyz[step, row]).max() <= self.xyz_error

    def test_a_failing_writer_leaves_the_old_file(self, path, monkeypatch):
        path.write_bytes(b"old")
        writer = WRITERS[self.suffix]

        def full(cloud, part, digest):
            writer(cloud, part, digest)
            assert part.suffix == self.suffix
            raise OSError("No space left on device")

        monkeypatch.setitem(clouds_module.WRITERS, self.suffix, full)
        with pytest.raises(CloudError, match=f"room{self.suffix}: cannot be written: No space left"):
            save_cloud(make_cloud(), path)
        assert path.read_bytes() == b"old" and os.listdir(path.parent) == [path.name]


class TestPly(WriterContract):
    suffix = ".ply"
    xyz_error = 0.0

    def read(self, path):
        point = open3d().t.io.read_point_cloud(str(path)).point
        columns = {"xyz": point.positions.numpy(), "rgb": point.colors.numpy(), "normals": point.normals.numpy()}
        # Without the prefix MeshLab takes the intensity for the colour, and CloudCompare drops the rest.
        prefix = "scalar_"
        names = ("intensity", "sigma", "sigma_random", "sigma_systematic", "step", "row", "laser")
        names += tuple(name for name in SMOOTHED if prefix + name in point)
        return columns | {name: point[prefix + name].numpy()[:, 0] for name in names}

    def test_header(self, path):
        save_cloud(make_cloud(), path, calibration_digest="sha256:0123")
        header = path.read_bytes().split(b"end_header\n")[0].decode().splitlines()
        assert header[:7] == [
            "ply",
            "format binary_little_endian 1.0",
            "comment jaxscan-cloud/1",
            "comment unit metre",
            "comment frame scanner",
            f"comment grid {PROFILES} {LINES}",
            "comment calibration sha256:0123",
        ]
        names = "x y z nx ny nz red green blue".split()
        scalars = "intensity sigma sigma_random sigma_systematic step row laser angle".split()
        names += [f"scalar_{name}" for name in scalars]
        assert [line.split()[2] for line in header if line.startswith("property")][: len(names)] == names


class TestPcd(WriterContract):
    suffix = ".pcd"
    xyz_error = 0.0

    def read(self, path):
        point = open3d().t.io.read_point_cloud(str(path)).point
        columns = {"xyz": point.positions.numpy(), "rgb": point.colors.numpy(), "normals": point.normals.numpy()}
        names = ("intensity", "sigma", "sigma_random", "sigma_systematic", "step", "row", "laser")
        names += tuple(name for name in SMOOTHED if name in point)
        columns |= {name: point[name].numpy()[:, 0] for name in names}
        # The file holds the grid; cells without a point are not a number.
        assert len(columns["xyz"]) == PROFILES * LINES
        seen = np.isfinite(columns["xyz"]).all(1)
        return {name: column[seen] for name, column in columns.items()}


class TestXyz(WriterContract):
    suffix = ".xyz"
    # Written to the micrometre.
    xyz_error = 0.51e-6

    def read(self, path):
        table = np.loadtxt(path)
        assert table.shape[1] == 6
        points = np.asarray(open3d().io.read_point_cloud(str(path)).points)
        assert np.array_equal(points, table[:, :3])
        return {"xyz": points, "rgb": table[:, 3:]}


class TestPtx(WriterContract):
    suffix = ".ptx"
    xyz_error = 0.51e-6

    def expected(self, cloud):
        # In any order here; `test_ptx.py` looks at that of a room.
        step, row = np.nonzero(cloud.valid)
        order = np.lexsort(cloud.xyz[step, row].T)
        return step[order], row[order]

    def read(self, path):
        lines = path.read_text().splitlines()
        assert len(lines) == 2 * (10 + PROFILES // 2 * LINES)
        rows = []
        for block in (lines[: len(lines) // 2], lines[len(lines) // 2 :]):
            assert block[:2] == [str(PROFILES // 2), str(LINES)]
            assert np.array_equal(np.array([line.split() for line in block[6:10]], float), np.eye(4))
            rows += block[10:]
        table = np.array([line.split() for line in rows], float)
        holes = (table[:, :3] == 0).all(1)
        assert not table[holes][:, 4:].any()
        assert table[:, 3].min() >= 0 and table[:, 3].max() <= 1
        table = table[~holes]
        table = table[np.lexsort(table[:, :3].T)]
        return {"xyz": table[:, :3], "rgb": table[:, 4:]}


class TestE57(WriterContract):
    suffix = ".e57"
    xyz_error = 0.0

    def read(self, path):
        pye57 = pytest.importorskip("pye57", reason="the extra `export` is not installed")
        file = pye57.E57(str(path))
        # It knows no extensions.
        scan = file.read_scan_raw(0, ignore_unsupported_fields=True)
        plain = file.read_scan(0, intensity=True, colors=True)
        assert np.array_equal(plain["cartesianX"], scan["cartesianX"])
        header = file.get_header(0)
        assert np.array_equal(header.rotation, [1, 0, 0, 0]) and not np.any(header.translation)
        columns = {
            "xyz": np.stack([scan[f"cartesian{axis}"] for axis in "XYZ"], -1),
            "rgb": np.stack([scan[f"color{name}"] for name in ("Red", "Green", "Blue")], -1),
            "intensity": scan["intensity"],
            "step": scan["columnIndex"],
            "row": scan["rowIndex"],
        }
        file.close()
        return columns


class TestLas(WriterContract):
    suffix = ".las"
    # Coordinates are multiples of 0.1 mm.
    xyz_error = 0.51e-4
    # Whole numbers of the 16 bits, of which the largest amplitude is the largest.
    intensity_of = staticmethod(lambda dn: np.round(dn.astype(float) * min(257, 65535 / dn.max().astype(float))))

    def read(self, path):
        laspy = pytest.importorskip("laspy", reason="the extra `export` is not installed")
        las = laspy.read(path)
        assert las.header.point_format.id == 7 and str(las.header.version) == "1.4"
        names = ("intensity", "sigma", "sigma_random", "sigma_systematic", "step", "row")
        smoothed = [name for name in SMOOTHED if name in las.point_format.dimension_names]
        colours = np.stack([las.red, las.green, las.blue], -1)
        assert not (colours % 257).any()
        return {
            "xyz": np.asarray(las.xyz),
            "rgb": colours // 257,
            "normals": np.stack([las[f"normal_{axis}"] for axis in "xyz"], -1),
            "laser": np.asarray(las.user_data),
            **{name: np.asarray(las[name]) for name in (*names, *smoothed)},
        }

    def test_no_amplitude_is_clipped(self, path):
        cloud = make_cloud()
        laspy = pytest.importorskip("laspy", reason="the extra `export` is not installed")
        save_cloud(cloud, path)
        bright, las = cloud.intensity[cloud.valid], laspy.read(path)
        assert bright.max() > 255 and np.array_equal(las["amplitude"], bright)
        assert np.array_equal(np.argsort(np.asarray(las.intensity), kind="stable"), np.argsort(bright, kind="stable"))

    def test_the_frame_is_stated(self, path):
        laspy = pytest.importorskip("laspy", reason="the extra `export` is not installed")
        save_cloud(make_cloud(), path)
        header = laspy.read(path).header
        # Point formats 6 to 10 need it: LAS 1.4 R15, table 4.
        assert header.global_encoding.wkt
        assert header.vlrs.get("WktCoordinateSystemVlr")[0].string.startswith(
            'LOCAL_CS["jaxscan, frame of the scanner"'
        )


class TestLaz(TestLas):
    suffix = ".laz"

    def test_it_is_compressed(self, path):
        save_cloud(make_cloud(), path)
        laspy = pytest.importorskip("laspy", reason="the extra `export` is not installed")
        with laspy.open(path) as file:
            assert file.header.are_points_compressed


class TestNpz(WriterContract):
    suffix = ".npz"
    xyz_error = 0.0

    def read(self, path):
        with np.load(path, allow_pickle=False) as arrays:
            assert str(arrays["format"]) == "jaxscan-cloud/1" and str(arrays["unit"]) == "metre"
            valid = arrays["valid"]
            names = ("xyz", "rgb", "normals", "intensity", "sigma_random", "sigma_systematic")
            return {name: arrays[name][valid] for name in (*names, *(name for name in SMOOTHED if name in arrays))}

    def test_double_precision_and_jax_arrays_are_taken(self, path):
        wide = make_cloud(dtype=np.float64, smoothed=True)
        save_cloud(jax.tree.map(jnp.asarray, wide), path)
        back = load_cloud(path)
        assert back.stations is None
        for name, field in ((name, field) for name, field in vars(back).items() if name not in ("stations", "absent")):
            # Lossless means the masked entries and the type too.
            assert np.array_equal(field, getattr(wide, name)) and field.dtype == getattr(wide, name).dtype


def test_what_no_format_takes(tmp_path):
    cloud, path = make_cloud(), tmp_path / "room.ply"
    empty = dataclasses.replace(cloud, valid=np.zeros_like(cloud.valid))
    with pytest.raises(CloudError, match=r"room\.ply: the cloud has no valid point"):
        save_cloud(empty, path)
    for field in ("xyz", "sigma_random"):
        broken = dataclasses.replace(cloud, **{field: getattr(cloud, field).copy()})
        getattr(broken, field)[0, 0] = np.nan
        with pytest.raises(CloudError, match=f"{field} of a valid point is not finite"):
            save_cloud(broken, path)
    with pytest.raises(CloudError, match="nowhere does not exist"):
        save_cloud(cloud, tmp_path / "nowhere" / "room.ply")
    assert os.listdir(tmp_path) == []


# A format that has no test of its own yet.
for _suffix in WRITERS.keys() - {one.suffix for one in (*WriterContract.__subclasses__(), TestLaz)}:
    _name = f"Test{_suffix[1:].title()}"
    globals()[_name] = type(_name, (WriterContract,), {"suffix": _suffix})


GRIDS = [".e57", ".las", ".laz", ".npz", ".pcd", ".ply"]


@pytest.mark.parametrize("smoothed", [False, True])
@pytest.mark.parametrize("suffix", GRIDS)
def test_the_organised_grid_comes_back(tmp_path, suffix, smoothed):
    cloud = make_cloud(smoothed=smoothed)
    save_cloud(cloud, tmp_path / f"room{suffix}")
    back = load_cloud(tmp_path / f"room{suffix}")
    # Profiles without a point are listed in two formats alone.
    known = np.ones(PROFILES, bool) if suffix in (".ply", ".npz") else cloud.valid.any(1)
    assert np.array_equal(back.valid, cloud.valid)
    for name in ("record", "laser", "angle"):
        assert np.array_equal(getattr(back, name)[known], getattr(cloud, name)[known]), name
    assert back.xyz.dtype == np.float32
    # LAS has steps of 0.1 mm.
    error_m = 0.51e-4 if suffix in (".las", ".laz") else 0.0
    assert np.abs(back.xyz - cloud.xyz)[cloud.valid].max() <= error_m
    for name in ("rgb", "normals", "intensity", "sigma_random", "sigma_systematic"):
        assert np.array_equal(getattr(back, name)[cloud.valid], getattr(cloud, name)[cloud.valid]), name
        if suffix != ".npz":
            assert not getattr(back, name)[~cloud.valid].any(), name
    for name in SMOOTHED:
        values = getattr(back, name)
        assert (values is not None) == smoothed
        if smoothed:
            assert np.array_equal(values[cloud.valid], getattr(cloud, name)[cloud.valid]), name


def test_blocks_do_not_show(tmp_path, monkeypatch):
    from jaxscan.files.clouds import points

    save_cloud(make_cloud(), tmp_path / "WHOLE.PLY")
    # One profile per block, of which one is empty.
    monkeypatch.setattr(points, "BLOCK_POINTS", LINES)
    save_cloud(make_cloud(), tmp_path / "parts.ply")
    assert (tmp_path / "WHOLE.PLY").read_bytes() == (tmp_path / "parts.ply").read_bytes()


@pytest.mark.parametrize("name", ["room.obj", "room", "room.ply.gz"])
def test_unknown_suffixes_list_the_known_ones(tmp_path, name):
    known = re.escape(f"known are {', '.join(WRITERS)}")
    with pytest.raises(CloudError, match=known):
        save_cloud(make_cloud(), tmp_path / name)
    with pytest.raises(CloudError, match=known):
        load_cloud(tmp_path / name)


@pytest.mark.parametrize(("suffix", "module"), [(".e57", "pye57"), (".las", "laspy"), (".laz", "laspy")])
def test_a_missing_extra_says_what_to_install(tmp_path, monkeypatch, suffix, module):
    monkeypatch.setitem(__import__("sys").modules, module, None)
    with pytest.raises(DependencyError, match=r'pip install "jaxscan\[export\]"'):
        save_cloud(make_cloud(), tmp_path / f"room{suffix}")
    assert os.listdir(tmp_path) == []
