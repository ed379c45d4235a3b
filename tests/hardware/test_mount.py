"""The printable mount: closed, of the stated size, and its clamps where baseline and angle say. Needs OpenSCAD."""

import functools
import os
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest


pytestmark = pytest.mark.rig


SOURCE = Path(__file__).resolve().parents[2] / "hardware" / "mount" / "mount.scad"
GIVEN = {"baseline": 170.0, "laser_angle": 7.0, "lens_barrel": 34.0, "laser_barrel": 14.0}
WALL, DEPTH, OVERHANG, EAR, AXIS_HEIGHT, TUBE = 5.0, 24.0, 8.0, 11.0, 32.0, 20.0
# OpenSCAD's circles are polygons of 64 corners: 0.12 % of a radius within the circle.
TOLERANCE_MM = 0.05


@pytest.fixture(scope="module")
def trimesh():
    problem = "the mount is built by OpenSCAD: make mount-deps"
    if not shutil.which("openscad"):
        if os.environ.get("JAXSCAN_REQUIRE_MOUNT"):
            raise pytest.UsageError(problem)
        pytest.skip(problem)
    if os.environ.get("JAXSCAN_REQUIRE_MOUNT"):
        import trimesh

        return trimesh
    return pytest.importorskip("trimesh", reason="make programs")


def build(path, **values):
    """OpenSCAD's words after building a part with these values."""
    shown = {name: f'"{value}"' if isinstance(value, str) else f"{value:g}" for name, value in values.items()}
    words = [word for name, value in shown.items() for word in ("-D", f"{name}={value}")]
    run = subprocess.run(["openscad", "-o", path, *words, SOURCE], capture_output=True, text=True, timeout=120)
    return run.returncode, run.stderr


@pytest.fixture(scope="module")
def built(trimesh, tmp_path_factory):
    """Parts with the given values, each built once: the mesh, and OpenSCAD's words."""
    folder = tmp_path_factory.mktemp("mount")

    @functools.cache
    def part(name):
        code, said = build(folder / f"{name}.stl", part=name, **GIVEN)
        assert code == 0 and "WARNING" not in said, said
        return trimesh.load(folder / f"{name}.stl"), said

    return part


@pytest.mark.parametrize("part", ["whole", "camera", "laser"])
def test_a_part_is_closed_and_of_its_size(built, part):
    mesh, said = built(part)
    assert mesh.is_watertight and mesh.is_winding_consistent and mesh.body_count == 1 and mesh.volume > 0
    barrel = GIVEN["laser_barrel" if part == "laser" else "lens_barrel"]
    left, right = ((GIVEN[name] + 2 * WALL + DEPTH) / 2 + OVERHANG for name in ("lens_barrel", "laser_barrel"))
    ends = {"whole": left + GIVEN["baseline"] + right, "camera": 2 * left, "laser": 2 * right}
    above = AXIS_HEIGHT + barrel / 2 + WALL + EAR
    expected = [ends[part], DEPTH + 2 * OVERHANG, above if part == "whole" else above + TUBE + 2 * WALL]
    np.testing.assert_allclose(mesh.extents, expected, atol=TOLERANCE_MM)
    (size,) = re.findall(r"size = \[([^]]*)\]", said)
    np.testing.assert_allclose([float(number) for number in size.split(",")], expected, atol=1e-3)


def test_the_clamps_are_where_baseline_and_angle_say(built):
    """The bores' faces: their middles are the baseline apart, and their axes the laser's angle."""
    mesh, _ = built("whole")
    for place, barrel, angle in ((0.0, "lens_barrel", 0.0), (GIVEN["baseline"], "laser_barrel", GIVEN["laser_angle"])):
        ahead = np.array([-np.sin(np.deg2rad(angle)), np.cos(np.deg2rad(angle)), 0.0])
        from_axis = mesh.triangles - [place, 0.0, AXIS_HEIGHT]
        beside = np.linalg.norm(np.cross(from_axis, ahead), axis=-1)
        radius = (GIVEN[barrel] + 0.3) / 2
        bore = np.all(np.abs(beside - radius) < TOLERANCE_MM, axis=1)
        assert mesh.area_faces[bore].sum() > 0.8 * 2 * np.pi * radius * DEPTH


@pytest.mark.parametrize(
    "values, message",
    [
        ({"part": "lid"}, "whole, camera or laser"),
        ({"baseline": 40}, "clamps would touch"),
        ({"laser_angle": 50}, "at most 45 degrees"),
        ({"lens_barrel": 60}, "lens would touch the beam"),
    ],
)
def test_what_cannot_be_printed_is_refused(trimesh, values, message, tmp_path):
    code, said = build(tmp_path / "part.stl", **values)
    assert code != 0 and message in said and not (tmp_path / "part.stl").exists()
