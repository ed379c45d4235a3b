"""A project's folder may come from a stranger: no verb writes or makes anything outside of it."""

import contextlib
import hashlib
import os
import sqlite3
from pathlib import Path

import numpy as np
import pytest

from jaxscan.errors import CaptureError, ConfigError
from jaxscan.files.capture import save_stripes
from jaxscan.files.disk import open_to_write, refuse_links, remove_stale
from jaxscan.project import claimed, load_project
from jaxscan.project.catalogue import Catalogue
from jaxscan.project.steps import Step
from jaxscan.project.work import StepWorkspace, publish
from tests.opened import edit, work


LETTER = "dear reader\n"
NAMES = (".batch.lock", "project.json", "catalogue.sqlite", "catalogue.sqlite-journal", "clouds", "stripes")


@pytest.fixture
def outside(tmp_path_factory):
    """A folder of the user with a letter in it."""
    folder = tmp_path_factory.mktemp("outside")
    (folder / "letter").write_text(LETTER)
    (folder / "letters").mkdir()
    return folder


def fingerprint(folder):
    """Every name below a folder, with the digest of its content and the time of its last change."""
    return {
        str(path.relative_to(folder)): (
            path.is_dir() or hashlib.sha256(path.read_bytes()).hexdigest(),
            os.lstat(path).st_mtime_ns,
        )
        for path in (folder, *folder.rglob("*"))
    }


@pytest.mark.parametrize("verb", [("batch",), ("project", "status"), ("project", "compare")], ids=" ".join)
@pytest.mark.parametrize("there", [True, False], ids=["a link", "a dangling link"])
@pytest.mark.parametrize("name", NAMES[:4])
def test_no_verb_follows_a_link_among_the_products(museum, outside, run, verb, name, there):
    (museum.parent / "products").mkdir()
    if name.endswith("-journal"):
        (museum.parent / "products" / "catalogue.sqlite").touch()
    (museum.parent / "products" / name).symlink_to(outside / ("letter" if there else "made"))
    before = fingerprint(outside)
    ran = run(*verb, *[museum] * (2 if verb[-1] == "compare" else 1))
    assert fingerprint(outside) == before
    if verb == ("batch",) and name != "project.json":
        assert ran.code == 1 and ran.err.count("\n") == 1 and "found a link" in ran.err


@pytest.mark.more
@pytest.mark.parametrize("name", NAMES[4:])
def test_no_step_writes_through_a_link(museum, outside, name):
    (museum.parent / "products").mkdir()
    (museum.parent / "products" / name).symlink_to(outside / "letters")
    before = fingerprint(outside)
    rows = work(museum)
    assert fingerprint(outside) == before
    assert "found a link" in next(row for row in rows if row.state == "failed").message


def test_a_product_that_is_a_link_is_not_read(museum, outside):
    (museum.parent / "products" / "clouds").mkdir(parents=True)
    link = museum.parent / "products" / "clouds" / "room-1.ply"
    link.symlink_to(outside / "letter")
    with pytest.raises(OSError, match="found a link"):
        refuse_links(museum.parent / "products", link)


@pytest.mark.parametrize("text", [LETTER, "1 on vm\nmore", "x" * 10_000])
def test_what_is_no_lock_of_a_batch_is_not_overwritten(museum, text):
    lock = museum.parent / "products" / ".batch.lock"
    lock.parent.mkdir()
    lock.write_text(text)
    with pytest.raises(ConfigError, match="no lock of a program"), claimed(load_project(museum)):
        pass
    assert lock.read_text() == text


def test_status_makes_nothing(museum, run):
    (museum.parent / "products").mkdir()
    before = fingerprint(museum.parent)
    assert run("project", "status", museum).code == 0
    assert fingerprint(museum.parent) == before


def test_a_journal_that_names_another_file_is_refused(tmp_path):
    """SQLite would take it back and then remove the file that it names."""
    Catalogue(tmp_path / "catalogue.sqlite", "rooms").close()
    (tmp_path / "catalogue.sqlite-journal").write_bytes(b"/home/letter" + bytes.fromhex("d9d505f920a163d7"))
    with pytest.raises(ConfigError, match="names another file"):
        Catalogue(tmp_path / "catalogue.sqlite", "rooms")


@pytest.mark.parametrize("link", [False, True], ids=["a path", "a link"])
def test_products_outside_need_the_users_word(museum, outside, run, link):
    if link:
        (museum.parent / "products").symlink_to(outside / "letters")
    else:
        edit(museum, 'name = "museum"', 'name = "museum"\noutput = "../' + f'{outside.name}/letters"')
    before = fingerprint(outside)
    ran = run("batch", museum)
    assert ran.code == 1 and ran.err.count("\n") == 1 and f"--output {outside}/letters" in ran.err
    with pytest.raises(ConfigError, match="is not the folder"), claimed(load_project(museum), museum.parent):
        pass
    assert fingerprint(outside) == before
    with claimed(load_project(museum), outside / "letters"):
        pass
    # From now on it is this project's.
    with claimed(load_project(museum)):
        pass


@pytest.mark.parametrize(
    ("kind", "statement"),
    [
        ("trigger", "CREATE TRIGGER t AFTER INSERT ON jaxscan_products BEGIN DELETE FROM jaxscan_products; END"),
        ("view", "CREATE VIEW v AS SELECT * FROM jaxscan_products"),
        ("virtual table", "CREATE VIRTUAL TABLE v USING fts5(x)"),
    ],
)
@pytest.mark.parametrize("write", [True, False])
def test_a_catalogue_that_runs_statements_of_its_own_is_refused(tmp_path, kind, statement, write):
    path = tmp_path / "catalogue.sqlite"
    Catalogue(path, "rooms").close()
    with contextlib.closing(sqlite3.connect(path)) as connection:
        connection.execute(statement)
        connection.commit()
    before = path.read_bytes()
    with pytest.raises(ConfigError, match=f"found a {kind}"):
        Catalogue(path, "rooms", write=write)
    assert path.read_bytes() == before


@pytest.mark.parametrize("there", [True, False], ids=["a link", "a dangling link"])
@pytest.mark.parametrize("place", ["reports/room-1.html", "tiles/hall/0_0.ply", "stripes/room-1.npz"])
def test_a_product_takes_the_place_of_a_link(tmp_path, outside, place, there):
    """Of a file that is a link, the link is replaced; what it leads to stays."""
    output, made = tmp_path / "products", tmp_path / "products" / "work"
    (made / "made" / place).parent.mkdir(parents=True)
    (made / "made" / place).write_text("made")
    (output / place).parent.mkdir(parents=True)
    (output / place).symlink_to(outside / ("letter" if there else "new"))
    before = fingerprint(outside)
    step = Step("report/room-1", "report", (), {}, {}, (place,), {})
    publish(StepWorkspace(step, output, made, lambda done, total: None))
    assert fingerprint(outside) == before
    assert not (output / place).is_symlink() and (output / place).read_text() == "made"


@pytest.mark.parametrize("place", ["reports/room-1.html", "tiles/hall/0_0.ply"])
def test_a_folder_of_products_that_is_a_link_is_refused(tmp_path, outside, place):
    output, made = tmp_path / "products", tmp_path / "products" / "work"
    (made / "made" / place).parent.mkdir(parents=True)
    (made / "made" / place).write_text("made")
    (output / Path(place).parts[0]).symlink_to(outside / "letters")
    before = fingerprint(outside)
    step = Step("report/room-1", "report", (), {}, {}, (place,), {})
    with pytest.raises(CaptureError, match="found a link"):
        publish(StepWorkspace(step, output, made, lambda done, total: None))
    assert fingerprint(outside) == before


@pytest.mark.parametrize("name", [".part-0123456789ab", ".part-0123456789ab.ply"])
def test_what_looks_like_a_left_file_and_is_a_link_removes_nothing(tmp_path, outside, name):
    (tmp_path / name).symlink_to(outside / ("letters" if name.endswith("ab") else "letter"))
    (outside / "letters" / "second").write_text(LETTER)
    before = fingerprint(outside)
    remove_stale(tmp_path)
    assert fingerprint(outside) == before


def test_stripes_are_not_kept_through_a_link(tmp_path, outside):
    (tmp_path / "room.npz").symlink_to(outside / "letter")
    before = fingerprint(outside)
    save_stripes(tmp_path / "room.npz", {"v": np.zeros(3)}, {})
    assert fingerprint(outside) == before and not (tmp_path / "room.npz").is_symlink()


@pytest.mark.timeout(20)
def test_a_pipe_is_no_file_to_write_to(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for how in ("change", "append"):
        with pytest.raises(OSError, match="device or pipe"):
            open_to_write(tmp_path / "pipe", how)
