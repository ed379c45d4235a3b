"""What is made of clouds on the command line: plans, pictures of walls, and the newer measures."""

import json

import ezdxf
import numpy as np
import pytest
from matplotlib.image import imread

import jaxscan

from ..measurement.rooms import HEIGHT


def numbers(value):
    """All numbers of a result."""
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list):
        return [number for each in value for number in numbers(each)]
    return [value] if isinstance(value, float) else []


def test_plan(room, run, tmp_path):
    ran = run("plan", room, "-o", tmp_path / "plan.dxf", "--height", 1.0, 0.5, "--json", tmp_path / "plan.json")
    assert ran.code == 0, ran
    result = json.loads((tmp_path / "plan.json").read_text())
    assert result["format"] == "jaxscan-plan/1" and np.isfinite(numbers(result)).all() and "nan" not in ran.out
    lengths = sorted(wall["length"]["value"] for wall in result["walls"])
    np.testing.assert_allclose(lengths, [2.5, 2.5, 2.5, 3.5, 5.0, 6.0], atol=2e-3)
    assert result["floor_area"]["value"] == pytest.approx(23.75, abs=0.01)
    assert result["volume"]["value"] == pytest.approx(23.75 * HEIGHT, abs=0.03)
    assert sorted(one["kind"] for one in result["openings"]) == ["door", "window"]
    assert "±" in ran.out and "one standard deviation" in ran.out
    drawn = [one.get_measurement() for one in ezdxf.readfile(tmp_path / "plan.dxf").modelspace().query("DIMENSION")]
    for length in lengths:
        assert np.abs(np.array(drawn) - length).min() < 1e-4


def test_plan_on_a_sheet(room, run, tmp_path):
    """A picture of a whole A3; the drawing says its scale."""
    words = ["--sheet", "a3", "--scale", 50, "--name", "Kitchen", "--project", "House 7", "--dpi", 50]
    ran = run("plan", room, "-o", tmp_path / "plan.png", *words)
    assert ran.code == 0 and "1 : 50 on A3" in ran.out
    assert imread(tmp_path / "plan.png").shape[:2] == (584, 826)
    # Units stand with every number of the table.
    for row in (line for line in ran.out.splitlines() if "│ W" in line):
        assert " m " in row and row.rstrip(" │").endswith("m²")


def test_plan_as_a_model(room, run, tmp_path):
    ran = run("plan", room, "-o", tmp_path / "room.ifc", "--name", "Kitchen")
    assert ran.code == 0 and ran.out.splitlines()[-1].startswith("written:") and "W1" in ran.out
    assert "IFCSPACE" in (tmp_path / "room.ifc").read_text()
    ran = run("plan", room, "-o", tmp_path / "section.ifc", "--section", "W1+0.9")
    assert ran.code == 1 and "an .ifc holds the whole room" in ran.err
    ran = run("plan", room, "-o", tmp_path / "plan.pdf", "--scale", 10)
    assert ran.code == 1 and "choose 1 : 50 or a larger sheet" in ran.err
    ran = run("plan", room, "-o", tmp_path / "plan.pdf", "--north", "nan")
    assert ran.code == 1 and "--north: found nan, expected degrees, -360 to 360." in ran.err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["room.ifc"]


def test_section(room, run, tmp_path):
    ran = run("plan", room, "-o", tmp_path / "section.svg", "--section", 0.7, 1, 0.7, 2)
    assert ran.code == 0 and (tmp_path / "section.svg").read_bytes().startswith(b"<?xml")
    # What was cut is said, not the walls of the plan.
    assert "Section through (0.70, 1.00) and (0.70, 2.00) of the plan" in ran.out and "width" in ran.out
    assert "W1" not in ran.out and "frame of the plan: origin at" in ran.out


def test_section_before_a_wall(room, run, tmp_path):
    """It is parallel to the wall and so far from it, inside of the room."""
    ran = run("plan", room, "-o", tmp_path / "section.svg", "--section", "W1+0.9", "--json", tmp_path / "s.json")
    assert ran.code == 0 and "0.9 m before W1" in ran.out
    result = json.loads((tmp_path / "s.json").read_text())
    a, b = np.array(result["section_m"])
    corners = [np.array(wall["start_m"])[:2] for wall in result["walls"][:2]]
    along = (corners[1] - corners[0]) / np.linalg.norm(corners[1] - corners[0])
    np.testing.assert_allclose((b - a) / np.linalg.norm(b - a), along, atol=1e-9)
    # Walls are in the order in which the room is to their left.
    assert (a - corners[0]) @ [-along[1], along[0]] == pytest.approx(0.9, abs=2e-3)  # corners at the floor and at 1 m


def test_orthophoto(room, run, tmp_path):
    ran = run("orthophoto", room, "-o", tmp_path / "walls", "--pixel-mm", 20, "--json", "-")
    result = json.loads(ran.out)
    assert result["format"] == "jaxscan-orthophoto/1" and result["pixel_m"] == 0.02
    assert sorted(path.name for path in (tmp_path / "walls").iterdir()) == [f"W{n}.png" for n in range(1, 7)]


def test_deviations(room, run, tmp_path):
    at = jaxscan.load_cloud(room).xyz[10, 40]
    ran = run("measure", "deviations", room, "--at", *at, "-o", tmp_path / "map.png", "--json", "-")
    result = json.loads(ran.out)
    cells = np.array(result["deviation_m"], float)
    seen = ~np.isnan(cells)
    assert (seen == ~np.isnan(np.array(result["sigma_m"], float))).all()
    assert np.sqrt(np.mean(cells[seen] ** 2)) == pytest.approx(result["rms_m"])
    assert (tmp_path / "map.png").read_bytes().startswith(b"\x89PNG")


def test_points(room, run):
    cloud = jaxscan.load_cloud(room)
    a, b = cloud.xyz[10, 40], cloud.xyz[100, 40]
    result = json.loads(run("measure", "points", room, "--a", *a, "--b", *b, "--json", "-").out)
    assert result["value_m"] == pytest.approx(float(np.linalg.norm(a - b)), abs=1e-6) and result["sigma_m"] > 0


def test_points_of_a_cloud_in_millimetres(room, run):
    """Said to be in millimetres, metres are a thousandth of what they were."""
    a, b = np.array([1.0, 0.2, 0.1]) / 1e3, np.array([1.0, -0.8, 0.1]) / 1e3
    words = ("measure", "points", room, "--a", *a, "--b", *b, "--within-mm", 20, "--json", "-")
    found = json.loads(run(*words, "--unit", "mm").out)
    assert 0 < found["value_m"] < 0.01


def test_sphere(room, refused):
    at = jaxscan.load_cloud(room).xyz[10, 40]
    assert "No sphere" in refused("measure", "sphere", room, "--near", *at, "--radius-mm", 100)


class TestRefusals:
    @pytest.mark.parametrize("height", [0, -1, 3, "nan", "1e30"])
    def test_height(self, room, refused, tmp_path, height):
        assert "eight" in refused("plan", room, "-o", tmp_path / "plan.dxf", "--height", height)
        assert list(tmp_path.iterdir()) == []

    def test_a_section_beside_the_room(self, room, refused, tmp_path):
        words = ("plan", room, "-o", tmp_path / "plan.dxf", "--section")
        assert "does not meet the room" in refused(*words, 50, 0, 50, 1)
        assert "are one" in refused(*words, 1, 1, 1, 1)
        assert "--section" in refused(*words, 1, 1, 1, "nan")
        assert "expected a wall and metres" in refused(*words, 1, 1, 1)
        assert "expected one of the plan's: W1, W2" in refused(*words, "W77+1")
        assert "does not meet the room" in refused(*words, "W1+99")
        assert list(tmp_path.iterdir()) == []

    def test_names(self, room, refused, tmp_path):
        assert '".dwg"' in refused("plan", room, "-o", tmp_path / "plan.dwg")
        assert '".jpg"' in refused("measure", "deviations", room, "--at", 1, 0, 0, "-o", tmp_path / "map.jpg")
        (tmp_path / "file").write_text("")
        assert "is a file" in refused("orthophoto", room, "-o", tmp_path / "file")
        assert "no such file" in refused("plan", tmp_path / "nowhere.ply", "-o", tmp_path / "plan.dxf")

    @pytest.mark.parametrize("size", [0, -1, "nan", "inf"])
    def test_sizes(self, room, refused, tmp_path, size):
        assert "--radius" in refused("measure", "sphere", room, "--near", 1, 0, 0, "--radius-mm", size)
        assert "--within-mm" in refused("measure", "points", room, "--a", 1, 0, 0, "--b", 0, 0, 0, "--within-mm", size)
        assert "--cell-mm" in refused("measure", "deviations", room, "--at", 1, 0, 0, "--cell-mm", size)
        assert "--pixel-mm" in refused("orthophoto", room, "-o", tmp_path / "walls", "--pixel-mm", size)

    def test_a_cloud_of_another_program(self, refused, tmp_path):
        lines = ["ply", "format ascii 1.0", "element vertex 3", *(f"property float {axis}" for axis in "xyz")]
        text = "\n".join([*lines, "end_header", "0 0 1", "1 0 1", "0 1 1", ""])
        (tmp_path / "a.ply").write_text(text)
        refused("plan", tmp_path / "a.ply", "-o", tmp_path / "plan.dxf")
        assert "no sigmas" in refused("measure", "points", tmp_path / "a.ply", "--a", 0, 0, 1, "--b", 1, 0, 1)
        assert "no sigmas" in refused("measure", "sphere", tmp_path / "a.ply", "--near", 0, 0, 1, "--radius-mm", 1000)
        assert "no sigmas" in refused("measure", "deviations", tmp_path / "a.ply", "--at", 0, 0, 1)
