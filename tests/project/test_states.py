"""Steps done in this process, and what becomes stale by what."""

import contextlib
import json
import shutil
import sqlite3
from pathlib import Path

import numpy as np
import pytest

import jaxscan
from jaxscan.errors import ConfigError
from jaxscan.files.capture import CACHE_NAME, JOURNAL_NAME
from jaxscan.project import begun_row, failed_row, steps
from jaxscan.project import work as doing
from jaxscan.project.work import WORK
from tests.museum import make_museum
from tests.opened import catalogue_of, edit, states, work


@pytest.fixture(scope="module")
def finished(tiny, tmp_path_factory):
    """A project whose clouds are made. Copy, do not change."""
    file = make_museum(tiny, tmp_path_factory.mktemp("finished"))
    edit(file, '["cloud", "measures", "mesh"]', '["cloud"]')
    assert all(row.state == "done" for row in work(file))
    return file


@pytest.fixture
def clouds(finished, tmp_path):
    return shutil.copytree(finished.parent, tmp_path / "clouds") / finished.name


def in_state(file, state):
    return {key for key, one in states(file).items() if one.state == state}


@pytest.mark.more
def test_a_project_from_nothing_to_done_and_stale_by_every_cause(museum, tiny, monkeypatch):
    assert in_state(museum, "missing") == set(states(museum))
    rows = work(museum)
    assert [row.message for row in rows if row.state == "failed"] == []
    assert in_state(museum, "done") == set(states(museum))
    assert work(museum) == []
    products = museum.parent / "products"
    # As the verb makes it, to the last bit; and nothing is written into captures.
    scanner = jaxscan.load_scanner(tiny.calibration)
    sweep = jaxscan.open_capture(tiny.sweep).every(2)
    cloud = jaxscan.colour_cloud(jaxscan.reconstruct_capture(sweep, scanner, cache=False).cloud, sweep, scanner)
    made = jaxscan.load_cloud(products / "clouds" / "room-1.npz")
    for name, field in vars(cloud).items():
        if field is not None:
            np.testing.assert_array_equal(field, getattr(made, name), err_msg=name)
    assert not (museum.parent / "room-1" / CACHE_NAME).exists()
    assert not list(products.glob(".part-*"))
    measures = json.loads((products / "measures" / "room-1.json").read_text())
    assert measures["points"] == int(np.asarray(cloud.valid).sum())

    # A file of a product that is gone: only its step is done again.
    (products / "meshes" / "room-1.glb").unlink()
    assert {key: one.why for key, one in states(museum).items() if one.state == "stale"} == {
        "mesh/room-1": "room-1.glb is gone"
    }
    assert [row.key for row in work(museum)] == ["mesh/room-1"]

    # A capture that changed: all that is made of it.
    with open(museum.parent / "room-2" / JOURNAL_NAME, "a") as journal:
        journal.write("\n")
    stale = {key: one.why for key, one in states(museum).items() if one.state == "stale"}
    assert set(stale) == {"cloud/room-2", "measures/room-2", "mesh/room-2"}
    assert stale["cloud/room-2"] == "changed: capture" and stale["mesh/room-2"] == "changed: cloud/room-2"

    # Settings, and back again: as it was.
    edit(museum, "every = 2", "every = 3")
    assert states(museum)["cloud/room-1"].why == "changed: settings"
    edit(museum, "every = 3", "every = 2")
    assert states(museum)["cloud/room-1"].state == "done"

    # The code that makes meshes: clouds stay.
    code = steps.code_digest
    monkeypatch.setattr(steps, "code_digest", lambda kind: "other" if kind == "mesh" else code(kind))
    assert in_state(museum, "stale") >= {"mesh/room-1"} and states(museum)["cloud/room-1"].state == "done"
    assert states(museum)["mesh/room-1"].why == f"changed: the code, which was version {jaxscan.__version__}"


def test_a_failed_capture_says_its_line_and_stops_no_other(museum):
    shutil.rmtree(museum.parent / "room-1" / "on", ignore_errors=True)
    for image in (museum.parent / "room-1").glob("*.zst"):
        image.unlink()
    edit(museum, '["cloud", "measures", "mesh"]', '["cloud"]')
    rows = {row.key: row for row in work(museum)}
    assert rows["cloud/room-1"].state == "failed" and "room-1" in rows["cloud/room-1"].message
    assert "\n" not in rows["cloud/room-1"].message and rows["cloud/room-1"].details == ""
    assert rows["cloud/room-2"].state == "done"
    found = states(museum)
    assert found["cloud/room-1"].state == "failed" and found["cloud/room-1"].why == rows["cloud/room-1"].message
    assert not (museum.parent / "products" / "clouds" / "room-1.ply").exists()


def test_a_defect_is_kept_with_its_place(museum, monkeypatch):
    def broken(workspace):
        raise ZeroDivisionError("of the test")

    monkeypatch.setattr(doing, "WORK", {**doing.WORK, "cloud": broken})
    edit(museum, '["cloud", "measures", "mesh"]', '["cloud"]')
    row = work(museum)[0]
    assert row.message == "unexpected ZeroDivisionError: of the test" and "broken" in row.details
    kept = {one.key: one for one in catalogue_of(museum).rows()}
    assert kept[row.key] == row


@pytest.mark.more
def test_one_row_of_each_step_however_often_it_is_written(clouds):
    catalogue = catalogue_of(clouds)
    rows = catalogue.rows()
    catalogue.write(rows)
    catalogue.write([rows[0]._replace(message="again")])
    assert sorted(row.message for row in catalogue.rows() if row.key == rows[0].key) == ["again"]
    assert len(catalogue.rows()) == len(rows) == 2


def test_what_is_done_shows_its_notes(clouds, run):
    catalogue = catalogue_of(clouds)
    rows = catalogue.rows()
    catalogue.write([rows[0]._replace(message="A note of the test.")])
    catalogue.close()
    assert "A note of the test." in run("project", "status", clouds).out
    assert states(clouds)[rows[0].key].state == "done"


def test_a_catalogue_that_cannot_be_written_is_one_line(museum):
    catalogue = catalogue_of(museum)
    row = failed_row(states(museum)["cloud/room-1"], "a line")
    with contextlib.closing(sqlite3.connect(museum.parent / "products" / "catalogue.sqlite")) as database:
        database.execute("ALTER TABLE jaxscan_products DROP COLUMN host")
        database.commit()
    with pytest.raises(ConfigError, match="cannot be written") as caught:
        catalogue.write([row])
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("statement", "says"),
    [
        ('UPDATE jaxscan_products SET outputs = \'[["../../x", 1, ""]]\'', "a row is damaged"),
        ("UPDATE jaxscan_products SET parts = 'none'", "a row is damaged"),
        ("UPDATE jaxscan_products SET parts = '[]'", "a row is damaged"),
        ('UPDATE jaxscan_products SET outputs = \'[["a\\u0000b", 1, ""]]\'', "a row is damaged"),
        ("UPDATE jaxscan_products SET message = x'00ff'", "a row is damaged"),
        ("UPDATE jaxscan_products SET state = 'strange'", "a row is damaged"),
        ("ALTER TABLE jaxscan_products DROP COLUMN host", "cannot be read"),
    ],
)
def test_a_catalogue_of_a_stranger_is_one_line(museum, run, statement, says):
    catalogue = catalogue_of(museum)
    row = failed_row(states(museum)["cloud/room-1"], "a line")
    catalogue.write([row])
    catalogue.close()
    with contextlib.closing(sqlite3.connect(museum.parent / "products" / "catalogue.sqlite")) as database:
        database.execute(statement)
        database.commit()
    ran = run("project", "status", museum)
    assert ran.code == 1 and says in ran.err and ran.err.count("\n") == 1


def test_names_of_folders_that_an_address_would_take_for_more(museum):
    strange = museum.parent / "a?b#c%20d"
    strange.mkdir()
    edit(museum, 'name = "museum"', 'name = "museum"\noutput = "a?b#c%20d"')
    catalogue = catalogue_of(museum)
    assert catalogue.rows() == [] and (strange / "catalogue.sqlite").exists()


def test_a_step_that_was_begun_is_not_done(clouds):
    catalogue = catalogue_of(clouds)
    # Other settings are begun, may have written files, and are taken back.
    edit(clouds, "every = 2", "every = 3")
    catalogue.write([begun_row(states(clouds)["cloud/room-1"])])
    edit(clouds, "every = 3", "every = 2")
    found = states(clouds)
    assert found["cloud/room-1"].state == "stale" and "did not come to its end" in found["cloud/room-1"].why
    assert found["cloud/room-2"].state == "done"
    catalogue.close()


def test_names_that_are_no_text_reach_the_catalogue(museum):
    catalogue = catalogue_of(museum)
    row = failed_row(states(museum)["cloud/room-1"], "caf\udce9: is not there")
    catalogue.write([row])
    assert catalogue.rows()[0].message == "caf\\udce9: is not there"
    catalogue.close()


def test_every_room_whose_code_counts_is_there():
    root = Path(jaxscan.__file__).parent
    for kind, rooms in steps.CODE_OF.items():
        for room in rooms:
            assert (root / room).is_dir() or (root / f"{room}.py").is_file(), (kind, room)
    assert set(steps.CODE_OF) == set(WORK)
