"""Every verb for clouds, with clouds that are little use: one line that says so, or a result that is a number."""

import json
import os
import re
import struct

import numpy as np
import pytest

import jaxscan


RNG = np.random.default_rng(0)
LOW, HIGH = np.array([-2.0, -1.5, -1.0]), np.array([2.0, 1.5, 1.4])


def walls(count=6000):
    """Points on the six sides of a box, to half a millimetre, of no grid."""
    points = RNG.uniform(LOW, HIGH, (count, 3))
    side = RNG.integers(0, 6, count)
    points[np.arange(count), side % 3] = np.where(side < 3, LOW[side % 3], HIGH[side % 3])
    return points + RNG.normal(0, 5e-4, points.shape)


def ply(path, points, **columns):
    names = ["x", "y", "z", *columns]
    values = np.column_stack([points, *(np.broadcast_to(value, len(points)) for value in columns.values())])
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    head += [*(f"property float {name}" for name in names), "end_header", ""]
    path.write_bytes("\n".join(head).encode() + values.astype("<f4").tobytes())


@pytest.fixture(scope="module")
def clouds(tmp_path_factory):
    folder, room = tmp_path_factory.mktemp("clouds"), walls()
    gaps, far_off = room.copy(), room.copy()
    gaps[::50], far_off[::500] = np.nan, 1e30
    for name, points in {
        "no_grid": room,
        "millimetres": 1e3 * room,
        "none": room[:0],
        "one": room[:1],
        "two": room[:2],
        "gaps": gaps,
        "far_off": far_off,
        "nothing": np.nan * room,
        "same": np.ones((500, 3)),
        "line": np.linspace(0, 5, 500)[:, None] * [1, 0, 0],
        "plane": room * [1, 1, 0],
    }.items():
        ply(folder / f"{name}.ply", points)
    ply(folder / "no_number.ply", room, scalar_sigma=np.inf, scalar_sigma_random=np.nan)
    ply(folder / "no_noise.ply", room, scalar_sigma=0.0, scalar_sigma_random=0.0)
    np.savetxt(folder / "on_a_map.xyz", room + [356000, 5400000, 300], fmt="%.4f")
    (folder / "empty.e57").touch()
    (folder / "words.las").write_text("hello")
    (folder / "noise.pcd").write_bytes(RNG.bytes(500))
    (folder / "short.ptx").write_text("3\n3\n0 0 0\n")
    return folder


NAMES = (
    "no_grid.ply millimetres.ply none.ply one.ply two.ply gaps.ply far_off.ply nothing.ply same.ply line.ply plane.ply "
    "no_number.ply no_noise.ply on_a_map.xyz empty.e57 words.las noise.pcd short.ptx"
).split()
VERBS = {
    "room": ("measure", "room", "CLOUD", "--json", "-"),
    "plane": ("measure", "plane", "CLOUD", "--at", 2, 0.2, 0.1),
    "distance": ("measure", "distance", "CLOUD", "--a", 2, 0.2, 0.1, "--b", -2, 0.2, 0.1, "--radius-mm", 100),
    "points": ("measure", "points", "CLOUD", "--a", 2, 0.2, 0.1, "--b", -2, 0.2, 0.1, "--within-mm", 100),
    "sphere": ("measure", "sphere", "CLOUD", "--near", 2, 0.2, 0.1, "--radius-mm", 100),
    "deviations": ("measure", "deviations", "CLOUD", "--at", 2, 0.2, 0.1, "-o", "made.png"),
    "info": ("info", "CLOUD"),
    "clean": ("clean", "CLOUD", "-o", "made.ply", "--isolated-mm", 50, "--thin-mm", 20),
    "convert": ("convert", "CLOUD", "made.ptx"),
    "align": ("align", "CLOUD", "-o", "made.ply", "--room"),
    "report": ("report", "CLOUD", "-o", "made.html"),
    "mesh": ("mesh", "CLOUD", "-o", "made.glb"),
    "plan": ("plan", "CLOUD", "-o", "made.dxf"),
    "orthophoto": ("orthophoto", "CLOUD", "-o", "made"),
}


def assert_numbers(path, name):
    """No NaN or infinity in a file that a command wrote."""
    if path.suffix in (".dxf", ".ptx", ".html"):
        words = re.sub(r"data:image/[^\"']*", "", path.read_text())
        assert not re.search(r"\b(nan|inf|infinity)\b", words.lower()), (path.name, name)
    elif path.suffix == ".ply":
        cloud = jaxscan.load_cloud(path)
        assert all(np.isfinite(field).all() for field in (cloud.xyz, cloud.sigma_random, cloud.normals)), name
    elif path.suffix == ".glb":
        data = path.read_bytes()
        (length,) = struct.unpack("<I", data[12:16])
        described = json.loads(data[20 : 20 + length])
        for accessor in described["accessors"]:
            if accessor["componentType"] == FLOAT:
                view = described["bufferViews"][accessor["bufferView"]]
                begin = 28 + length + view.get("byteOffset", 0)
                assert np.isfinite(np.frombuffer(data[begin : begin + view["byteLength"]], "<f4")).all(), name
    else:
        assert path.suffix == ".png", path


FLOAT = 5126
"""The component type of glTF."""


@pytest.mark.parametrize(
    # A report draws several pictures of each cloud.
    "verb",
    [pytest.param(verb, marks=[pytest.mark.slow] if verb == "report" else []) for verb in VERBS],
)
def test_one_line_or_a_number(verb, clouds, run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    ended = set()
    for name in NAMES:
        ran = run(*(clouds / name if word == "CLOUD" else word for word in VERBS[verb]))
        ended.add(ran.code)
        if ran.code == 1:
            assert ran.err.startswith("jaxscan: ") and ran.err.count("\n") == 1 and "defect" not in ran.err, (name, ran)
            assert not os.listdir(tmp_path), name
        else:
            assert ran.code == 0 and not re.search(r"\b(nan|inf)\b", ran.out.lower()), (name, ran)
            assert bool(os.listdir(tmp_path)) == ("made" in " ".join(map(str, VERBS[verb]))), name
            for made in tmp_path.iterdir():
                assert_numbers(made, name)
                made.unlink()
    assert 1 in ended


@pytest.mark.parametrize("name", ["no_grid.ply", "millimetres.ply", "on_a_map.xyz"])
def test_align_takes_clouds_of_other_programs(name, clouds, run, tmp_path):
    """In their unit, and wherever their origin is: the box has its sides at 0 then."""
    assert run("align", clouds / name, "-o", tmp_path / "a.ply", "--room").code == 0
    cloud = jaxscan.load_cloud(tmp_path / "a.ply")
    low, high = np.percentile(cloud.xyz[cloud.valid], [1, 99], axis=0)
    np.testing.assert_allclose([low, high], [[0, 0, 0], HIGH - LOW], atol=3e-3)


def test_targets_say_what_is_up(clouds, refused, tmp_path):
    words = ("--targets", tmp_path / "targets.toml", "--up", "y", "-o", tmp_path / "a.ply")
    (tmp_path / "targets.toml").touch()
    assert "--up" in refused("align", clouds / "no_grid.ply", *words)
