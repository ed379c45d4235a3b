"""Projects on the command line: begun from what lies in a folder, and refused in one line before any work."""

import json
import os
import shutil
import sys

import pytest

from jaxscan.cli.view import with_projects
from jaxscan.project import load_project
from tests.museum import museum  # noqa: F401
from tests.opened import edit, work


TABLE = '[turntable]\ncarries = "scanner"\n'


@pytest.fixture
def folder(tiny, tmp_path):
    """Two sweeps and a capture of boards, in folders of their own."""
    for name in ("room-1", "room-2"):
        shutil.copytree(tiny.sweep, tmp_path / "sweeps" / name)
    shutil.copytree(tiny.boards, tmp_path / "boards")
    return tmp_path


def test_a_project_of_what_lies_there(folder, run):
    ran = run("project", "init", folder, "--json", "-")
    assert ran.code == 0 and json.loads(ran.out)["captures"] == ["room-1", "room-2"]
    project = load_project(folder / "project.toml")
    assert project.wanted.rig[0].boards == ("boards",) and project.wanted.captures[0].pattern == "sweeps/*"
    assert "jaxscan batch" in ran.err
    ran = run("project", "init", folder)
    assert ran.code == 1 and "exists, and may be yours" in ran.err


@pytest.mark.parametrize("name", ["a [1]*?", 'quote " and \\', "\U0001f3db hall", "line\nbreak", "gone\x7f"])
def test_whatever_folders_are_called(folder, run, name):
    shutil.move(folder / "sweeps", folder / name)
    shutil.move(folder / "boards", folder / name / "boards")
    ran = run("project", "init", folder)
    if any(ord(letter) < 32 or ord(letter) == 127 for letter in name):
        assert ran.code == 1 and ran.err.count("\n") == 1 and not (folder / "project.toml").exists()
        return
    assert ran.code == 0, ran.err
    project = load_project(folder / "project.toml")
    assert [capture.name for capture in project.captures] == ["room-1", "room-2"]
    assert project.wanted.rig[0].boards == (f"{name}/boards",)


@pytest.mark.skipif(sys.platform == "darwin", reason="names of files are text there")
def test_a_name_that_is_no_text(folder, run):
    os.rename(os.fsencode(folder / "boards"), os.fsencode(folder) + b"/boards-\xff")
    ran = run("project", "init", folder)
    assert ran.code == 1 and "is no text in UTF-8" in ran.err and ran.err.count("\n") == 1


def test_what_cannot_be_a_project_leaves_no_file(folder, run):
    shutil.copytree(folder / "sweeps" / "room-1", folder / "autumn" / "room-1")
    ran = run("project", "init", folder)
    assert ran.code == 1 and '"room-1" is found twice' in ran.err and ran.err.count("\n") == 1
    assert not (folder / "project.toml").exists()
    (folder / "autumn" / "room-1").rename(folder / "autumn" / "room-3")
    assert run("project", "init", folder).code == 0


def test_the_calibration_that_lies_there_is_taken(folder, tiny, run):
    shutil.copy(tiny.calibration, folder / "calibration.json")
    assert run("project", "init", folder).code == 0
    assert load_project(folder / "project.toml").wanted.rig[0].calibration == "calibration.json"
    (folder / "project.toml").unlink()
    shutil.copy(tiny.calibration, folder / "another.json")
    ran = run("project", "init", folder)
    assert ran.code == 1 and "2 calibrations fit the rig" in ran.err and ran.err.count("\n") == 1


def test_a_calibration_of_another_motion_is_not_taken(folder, tiny, run):
    shutil.copy(tiny.calibration, folder / "calibration.json")
    for sweep in (folder / "sweeps").iterdir():
        edit(sweep / "capture.toml", TABLE, TABLE.replace("scanner", "object"))
    ran = run("project", "init", folder)
    assert ran.code == 1 and 'calibration.json has another carries = "scanner"; boards has another turntable' in ran.err


def test_a_folder_without_what_is_needed(folder, tmp_path_factory, run):
    empty = tmp_path_factory.mktemp("empty")
    ran = run("project", "init", empty)
    assert ran.code == 1 and "found no sweep" in ran.err
    shutil.rmtree(folder / "boards")
    ran = run("project", "init", folder)
    assert ran.code == 1 and "neither a calibration nor captures of a board" in ran.err


def unsealed(capture):
    """A capture without the lines of its journal that would say what is changed."""
    journal = capture / "frames.jsonl"
    lines = [line for line in journal.read_text().splitlines(keepends=True) if "i" in json.loads(line)]
    journal.write_text("".join(lines))
    return capture


def test_boards_that_leave_open_what_a_sweep_says(folder, run):
    """Imported boards have no table, and perhaps other files and another way of looking for the laser."""
    header = unsealed(folder / "boards") / "capture.toml"
    edit(header, "[camera]", '[camera]\ncompression = "jpeg"')
    for sweep in (folder / "sweeps").iterdir():
        edit(sweep / "capture.toml", TABLE, TABLE.replace("scanner", "object"))
    edit(header, TABLE, "")
    ran = run("project", "init", folder)
    assert ran.code == 0, ran.err
    assert load_project(folder / "project.toml").wanted.rig[0].boards == ("boards",) and "note:" not in ran.out
    (folder / "project.toml").unlink()
    shutil.copytree(folder / "boards", folder / "others")
    edit(folder / "others" / "capture.toml", 'compression = "jpeg"', 'compression = "video"')
    ran = run("project", "init", folder)
    assert ran.code == 1 and "2 kinds of boards may be of the rig of sweeps/room-1 (boards and others)" in ran.err
    shutil.rmtree(folder / "others")
    edit(header, "[camera]", TABLE.replace("scanner", "linear") + "[camera]")
    ran = run("project", "init", folder)
    assert ran.code == 1 and "for the rig of sweeps/room-1; boards has another turntable" in ran.err


def test_boards_without_an_axis_are_said_before_the_batch(folder, run):
    journal = unsealed(folder / "boards") / "frames.jsonl"
    lines = [json.loads(line) | {"angle_deg": 0.0} for line in journal.read_text().splitlines()]
    journal.write_text("".join(json.dumps(line) + "\n" for line in lines))
    ran = run("project", "init", folder, "--json", "-")
    assert ran.code == 0, ran.err
    axis, known = json.loads(ran.out)["notes"]
    assert axis.startswith("boards: no axis: no board placement was seen from two table angles")
    assert "jaxscan calibrate boards" in known


def test_status_computes_and_writes_nothing(museum, run):  # noqa: F811
    ran = run("project", "status", museum, "--json", "-")
    assert ran.code == 0
    result = json.loads(ran.out)
    assert result["counts"] == {"done": 0, "stale": 0, "failed": 0, "missing": 6}
    assert not (museum.parent / "products").exists()


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('pattern = "room-*"', 'pattern = "hall-*"', 'the pattern "hall-*" finds no capture'),
        ('name = "museum"', "", "name: missing"),
        ('pattern = "room-*"', 'pattern = "s3://bucket/room-*"', "copy it to a disk first, such as with aws s3 sync"),
        ('name = "museum"', 'name = "museum"\noutput = "room-2/out"', "is in the capture room-2"),
        ('name = "museum"', 'name = "museum"\ncatalogue = "nonsense"', "catalogue: unknown"),
        ('calibration = "calibration.json"', 'calibration = "none.json"', "none.json"),
        ('calibration = "calibration.json"', 'calibration = "c\\u0000.json"', "calibration"),
        ('pattern = "room-*"', 'pattern = "room\\u0000"', "pattern"),
        ("settings = { every = 2 }", "settings = { every = 0 }", "every"),
        ("[[captures]]", '[[group]]\nname = "g"\ncaptures = ["room-1", "room-9"]\n[[captures]]', 'no capture "room-9"'),
    ],
)
@pytest.mark.parametrize("verb", [("batch",), ("project", "status")], ids=" ".join)
def test_what_cannot_be_meant_is_one_line_before_any_work(museum, run, verb, old, new, says):  # noqa: F811
    text = museum.read_text()
    assert old in text
    museum.write_text(text.replace(old, new))
    ran = run(*verb, museum)
    assert ran.code == 1 and says in ran.err and ran.err.count("\n") == 1, ran.err


def test_two_rigs_of_one_name_and_no_days(museum, run):  # noqa: F811
    museum.write_text(museum.read_text() + '\n[[rig]]\nname = "one"\ncalibration = "calibration.json"\n')
    ran = run("batch", museum)
    assert ran.code == 1 and ran.err.count("\n") == 1 and "calibration" in ran.err


@pytest.mark.more
def test_a_project_is_viewed_by_its_clouds(museum, run):  # noqa: F811
    ran = run("view", museum)
    assert ran.code == 1 and "has no cloud yet: jaxscan batch" in ran.err
    edit(museum, '["cloud", "measures", "mesh"]', '["cloud"]')
    work(museum)
    (museum.parent / "products" / "clouds" / "room-2.npz").unlink()
    clouds = museum.parent / "products" / "clouds"
    expected = (clouds / "room-1.ply", clouds / "room-2.ply", museum.parent / "other.ply")
    found, notes = with_projects((museum, museum.parent / "other.ply"))
    assert found == expected and notes == ["cloud/room-2: stale: room-2.npz is gone"]


def test_products_of_a_table_that_carries_things(folder, run):
    """The desk scanner's captures ask for no measures of rooms; a rig that stands still has clouds alone."""
    for name, carries in (("room-2", "object"), ("boards", "object")):
        edit(unsealed_all(folder, name) / "capture.toml", TABLE, TABLE.replace("scanner", carries))
    shutil.copytree(folder / "boards", folder / "others")
    edit(folder / "others" / "capture.toml", "object", "scanner")
    ran = run("project", "init", folder)
    assert ran.code == 0, ran.err
    project = load_project(folder / "project.toml")
    assert {one.name: one.products for one in project.captures} == {
        "room-1": ("cloud", "measures"),
        "room-2": ("cloud", "mesh"),
    }
    assert project.notes == () and "note:" not in ran.out


def unsealed_all(folder, name):
    """The capture of a name, which may be changed."""
    return unsealed(next(folder.glob(f"**/{name}")))


def test_what_is_left_out_is_said(museum, run):  # noqa: F811
    edit(museum.parent / "room-2" / "capture.toml", TABLE, TABLE.replace("scanner", "object"))
    edit(museum, '"mesh"]', '"plan"]')
    ran = run("project", "status", museum, "--json", "-")
    result = json.loads(ran.out)
    assert result["counts"]["missing"] == 5 and "note: " + result["left_out"][0] in ran.err
    assert result["left_out"][0].startswith(
        'captures "room-*": no plan of room-2: capture.toml says carries = "object"'
    )
    assert not (museum.parent / "products").exists()
