"""Two projects compared: what counts as a change, of one capture and of two."""

import json
import shutil

import numpy as np
import pytest

from jaxscan.errors import ConfigError
from jaxscan.project import compare_projects, load_project
from tests.museum import make_museum
from tests.opened import edit, work


def moved_by(file, metres):
    """Change a stored length, as another version of the code would have."""
    path = file.parent / "products" / "measures" / "room-1.json"
    about = json.loads(path.read_text())
    about["lengths"]["length"]["value_m"] += metres
    path.write_text(json.dumps(about))


@pytest.fixture(scope="module")
def finished(tiny, tmp_path_factory):
    """A project that is done. Copy, do not change."""
    file = make_museum(tiny, tmp_path_factory.mktemp("finished"))
    edit(file, '["cloud", "measures", "mesh"]', '["cloud", "measures"]')
    # Fewer profiles show no walls.
    edit(file, "every = 2", "every = 1")
    assert all(row.state == "done" for row in work(file))
    return file


@pytest.fixture
def two(finished, tmp_path):
    """Two copies of it."""
    return [shutil.copytree(finished.parent, tmp_path / name) / finished.name for name in ("first", "second")]


@pytest.mark.more
def test_one_capture_and_two_versions(two, run):
    first, second = two
    same = compare_projects(load_project(first), load_project(second))
    assert len(same.lengths) == 6 and not same.moved
    assert all(one.same_capture and one.difference_m == 0 for one in same.lengths)
    assert run("project", "compare", first, second).code == 0
    # A hundredth of a millimetre is below the noise of the length, and noticed all the same.
    noise = same.lengths[0].noise_m
    assert 1e-5 < noise
    moved_by(second, 1e-5)
    ran = run("project", "compare", first, second, "--json", "-")
    assert ran.code == 1 and "1 of 6 lengths have changed, room-1 length most: by +0.010 mm" in ran.err
    lengths = json.loads(ran.out)["lengths"]
    assert [one["moved"] for one in lengths].count(True) == 1


@pytest.mark.more
def test_a_length_that_is_lost_is_a_change(two, run):
    first, second = two
    path = second.parent / "products" / "measures" / "room-2.json"
    about = json.loads(path.read_text())
    del about["lengths"]["height"]
    path.write_text(json.dumps(about))
    ran = run("project", "compare", first, second)
    assert ran.code == 1 and "1 length is lost: room-2 height." in ran.err and ran.err.count("\n") == 1
    # One more than before is told, and nothing is wrong.
    ran = run("project", "compare", second, first, "--json", "-")
    found = json.loads(ran.out)
    assert ran.code == 0 and found["gained"] == ["room-2 height"] and found["lost"] == []


def test_objects_have_no_lengths(two):
    """As of sweeps of things on a table: the names are alike, and there is nothing to compare."""
    for file in two:
        for path in (file.parent / "products" / "measures").iterdir():
            path.write_text(json.dumps(json.loads(path.read_text()) | {"lengths": {}}))
    first, second = map(load_project, two)
    with pytest.raises(ConfigError, match=r"neither has a length of room-1 and 1 more, for lengths are those of rooms"):
        compare_projects(first, second)


@pytest.mark.more
def test_two_epochs(two):
    first, second = two
    for name in ("room-1", "room-2"):
        with open(second.parent / name / "frames.jsonl", "a") as journal:
            journal.write("\n")
    assert all(row.state == "done" for row in work(second))
    sigma = next(one for one in compare_projects(load_project(first), load_project(second)).lengths).sigma_m
    for factor, moved in ((2.9, False), (3.1, True)):
        moved_by(second, factor * sigma)
        found = compare_projects(load_project(first), load_project(second))
        assert not any(one.same_capture for one in found.lengths)
        assert bool(found.moved) == moved
        moved_by(second, -factor * sigma)
    one = found.lengths[0]
    both = [json.loads((file.parent / "products" / "measures" / f"{one.capture}.json").read_text()) for file in two]
    sigmas = [about["lengths"][one.name]["sigma_m"] for about in both]
    assert one.sigma_m == pytest.approx(np.hypot(*sigmas), rel=1e-9)


@pytest.mark.more
def test_what_failed_when_it_was_made_anew_is_lost(two, run):
    first, second = two
    for image in (second.parent / "room-1").glob("on/*"):
        image.unlink()
    edit(second, "every = 1", "every = 2")
    assert [row.state for row in work(second)].count("failed") >= 1
    ran = run("project", "compare", first, second)
    assert ran.code == 1 and "room-1 length" in ran.err and "lost" in ran.err and ran.err.count("\n") == 1


def test_measures_that_are_stale_are_named(two, run):
    first, second = two
    edit(second, "every = 1", "every = 2")
    ran = run("project", "compare", first, second)
    assert ran.code == 0 and f"stale in {second}, so compared as they were made: room-1, room-2" in ran.out


def test_projects_that_cannot_be_compared(two):
    first, second = two
    (second.parent / "products" / "measures" / "room-1.json").write_text("{}")
    with pytest.raises(ConfigError, match="holds no measures"):
        compare_projects(load_project(first), load_project(second))
    edit(second, 'name = "museum"', 'name = "museum"\noutput = "elsewhere"')
    with pytest.raises(ConfigError, match="has no measures yet"):
        compare_projects(load_project(first), load_project(second))
    assert not (second.parent / "elsewhere").exists()
