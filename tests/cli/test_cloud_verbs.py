"""`jaxscan info`, `clean` and `register`: what a file is, fewer points, and stations joined."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

import jaxscan


@pytest.fixture
def about(run):
    """What `jaxscan info` says as JSON."""

    def asked(path):
        ran = run("info", path, "--json", "-")
        assert ran.code == 0, ran
        return json.loads(ran.out)

    return asked


class TestInfo:
    def test_a_cloud(self, room, about, run):
        cloud, found = jaxscan.load_cloud(room), about(room)
        xyz = cloud.xyz[np.asarray(cloud.valid)]
        assert (found["kind"], found["points"], found["unit"], found["frame"]) == (
            "cloud",
            len(xyz),
            "metre",
            "scanner",
        )
        assert found["grid"] == list(cloud.valid.shape) and found["bytes"] == room.stat().st_size
        np.testing.assert_allclose([found["from"], found["to"]], [xyz.min(0), xyz.max(0)], atol=1e-6)
        shown = run("info", room).out
        assert f"points: {len(xyz):,}" in shown and "unit: metre" in shown and " MB" in shown

    def test_a_calibration(self, tiny, about):
        found = about(tiny.calibration)
        assert found["kind"] == "calibration" and found["verdict"] and found["lasers"]
        assert "px" in found["camera"] and found["digest"].startswith("sha256:")

    def test_captures(self, tiny, about):
        kinds = [about(folder)["kind"] for folder in (tiny.boards, tiny.sweep)]
        assert kinds == ["capture (calibration)", "capture (sweep)"]
        assert about(tiny.boards)["board"] and about(tiny.sweep)["records"] > 0

    def test_a_configuration(self, tmp_path, about):
        (tmp_path / "a.toml").write_text("[camera]\nwidth = 640\n")
        assert about(tmp_path / "a.toml")["tables"] == ["camera"]

    @pytest.mark.parametrize("suffix", [".glb", ".obj", ".ply", ".stl"])
    def test_a_mesh(self, room, run, about, tmp_path, suffix):
        path = tmp_path / f"mesh{suffix}"
        made = json.loads(run("mesh", room, "-o", path, "--json", "-").out)
        found = about(path)
        assert (found["kind"], found["faces"]) == ("mesh", made["faces"])
        assert suffix == ".stl" or found["vertices"] == made["vertices"]
        assert ("metre" in found["unit"]) and f"faces: {made['faces']:,}" in run("info", path).out

    def test_the_place_of_a_glb(self, room, run, about, tmp_path):
        run("mesh", room, "-o", tmp_path / "mesh.glb")
        found, cloud = about(tmp_path / "mesh.glb"), jaxscan.load_cloud(room)
        xyz = np.asarray(cloud.xyz)[np.asarray(cloud.valid)]
        assert found["up"] == "y" and found["to"][1] <= xyz[:, 2].max() + 1e-5

    @pytest.mark.parametrize("suffix", [".glb", ".pdf", ".svg", ".png", ".ifc", ".stl", ".ply"])
    @pytest.mark.parametrize("content", [b"", b"hello", b"glTF" + 16 * b"\xff", b"%PDF-1.4 /MediaBox [0 0 x y]"])
    def test_what_is_not_what_its_name_says(self, tmp_path, run, suffix, content):
        (tmp_path / f"a{suffix}").write_bytes(content)
        ran = run("info", tmp_path / f"a{suffix}")
        assert (ran.code == 1 and len(ran.err.splitlines()) == 1) or suffix in (".pdf", ".ply")

    def test_what_it_does_not_know(self, tmp_path, refused):
        (tmp_path / "notes.txt").write_text("hello")
        assert "expected a cloud" in refused("info", tmp_path / "notes.txt")
        (tmp_path / "broken.toml").write_text("= 3")
        assert "is no TOML" in refused("info", tmp_path / "broken.toml")
        assert "capture.toml" in refused("info", tmp_path)


class TestClean:
    def test_a_box(self, room, run, tmp_path):
        cloud = jaxscan.load_cloud(room)
        low, high = np.array([-1.0, -1.0, -0.5]), np.array([9.0, 9.0, 9.0])
        inside = np.asarray(cloud.valid) & ((cloud.xyz >= low) & (cloud.xyz <= high)).all(-1)
        ran = run("clean", room, "-o", tmp_path / "part.npz", "--box", *low, *high)
        assert ran.code == 0, ran
        found = jaxscan.load_cloud(tmp_path / "part.npz")
        # The points that stay are as they were, in their places.
        np.testing.assert_array_equal(found.valid, inside)
        np.testing.assert_array_equal(found.xyz[inside], cloud.xyz[inside])

    def test_one_point_in_each_cube(self, room, run, tmp_path):
        assert run("clean", room, "-o", tmp_path / "thin.npz", "--thin-mm", 100).code == 0
        before, after = (jaxscan.load_cloud(path) for path in (room, tmp_path / "thin.npz"))
        low = before.xyz[np.asarray(before.valid)].min(0)
        cubes = [np.floor((one.xyz[np.asarray(one.valid)].astype(float) - low) / 0.1) for one in (before, after)]
        assert len(np.unique(cubes[0], axis=0)) == len(cubes[1]) < len(cubes[0])

    def test_a_point_that_stands_alone(self, room, run, tmp_path):
        cloud = jaxscan.load_cloud(room)
        xyz = np.array(cloud.xyz)
        profile, line = np.argwhere(np.asarray(cloud.valid))[7]
        xyz[profile, line] = [0.3, 0.2, 0.1]
        jaxscan.save_cloud(replace(cloud, xyz=xyz), tmp_path / "one.npz")
        words = ("clean", tmp_path / "one.npz", "-o", tmp_path / "two.npz", "--isolated-mm", 150, "--neighbours", 1)
        assert run(*words).code == 0
        valid = np.asarray(jaxscan.load_cloud(tmp_path / "two.npz").valid)
        assert not valid[profile, line]
        assert np.count_nonzero(valid) > 0.9 * np.count_nonzero(cloud.valid)

    def test_refusals(self, room, refused, tmp_path):
        words = ("clean", room, "-o", tmp_path / "a.ply")
        assert "found none of --box" in refused(*words)
        assert "--thin-mm" in refused(*words, "--thin-mm", 0)
        assert "the lower one first" in refused(*words, "--box", 1, 1, 1, 0, 2, 2)
        assert "no point is left" in refused(*words, "--box", 50, 50, 50, 51, 51, 51)
        assert "would be lost" in refused("clean", room, "-o", room, "--thin-mm", 1)
        assert list(tmp_path.iterdir()) == []


class TestRegister:
    def test_clouds_of_one_frame(self, room, run, tmp_path):
        """Clouds that say where their scanner stood are put together as they are."""
        cloud = jaxscan.load_cloud(room)
        for name, place in (("a", [0.0, 0.0, 0.0]), ("b", [2.0, 1.0, 0.0])):
            transform = np.eye(4)
            transform[:3, 3] = place
            jaxscan.save_cloud(jaxscan.align_cloud(cloud, transform), tmp_path / f"{name}.ply")
        words = ("register", tmp_path / "a.ply", tmp_path / "b.ply", "-o", tmp_path / "both.npz")
        ran = run(*words, "--json", tmp_path / "both.json")
        assert ran.code == 0 and "stands at 2.000 1.000 0.000 m" in ran.out
        stations = json.loads((tmp_path / "both.json").read_text())["stations"]
        np.testing.assert_allclose([one["at_m"] for one in stations], [[0, 0, 0], [2, 1, 0]], atol=1e-9)
        both = jaxscan.load_cloud(tmp_path / "both.npz")
        assert np.count_nonzero(both.valid) == 2 * np.count_nonzero(cloud.valid)

    def test_refusals(self, room, tiny, refused, tmp_path):
        out = ("-o", tmp_path / "a.ply")
        assert "expected two or more sweeps" in refused("register", room, *out)
        assert "expected two or more sweeps" in refused("register", room, tiny.sweep, *out)
        assert "expected one for sweeps" in refused("register", tiny.sweep, tiny.sweep, *out)
        assert "does not say where its scanner stood" in refused("register", room, room, *out)
        assert list(tmp_path.iterdir()) == []

    @pytest.mark.slow
    def test_sweeps_from_two_places(self, tiny, run, tmp_path):
        """Their walls say where the second stood."""
        text = tiny.config.read_text()
        found = re.search(r"rig_m = \[(.*?), (.*?), (.*?)\]", text)
        x, y, z = map(float, found.groups())
        text = text.replace(found[0], f"rig_m = [{x + 0.25}, {y - 0.2}, {z}]")
        # One board, which nobody looks at.
        text = re.sub(r"(free_views|placements|angles) = \d+", r"\1 = 1", text)
        (tmp_path / "there.toml").write_text(text)
        assert run("simulate", tmp_path / "there.toml", "-o", tmp_path / "there").code == 0
        both = tmp_path / "both.npz"
        ran = run("register", tiny.sweep, tmp_path / "there/sweep", "-c", tiny.calibration, "-o", both, "--json", "-")
        assert ran.code == 0, ran
        first, second = (np.array(one["at_m"]) for one in json.loads(ran.out)["stations"])
        # The tiny rig hardly sees the floor, so heights are known to centimetres only.
        assert np.hypot(*(second - first)[:2]) == pytest.approx(np.hypot(0.25, 0.2), abs=0.005)
        assert len(jaxscan.load_cloud(both).stations.pose) == 2
