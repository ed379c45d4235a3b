"""Products of some captures only: those that are asked for there, and those that can be made."""

import pytest

from jaxscan.errors import ConfigError
from jaxscan.files.capture import HEADER_NAME, JOURNAL_NAME
from jaxscan.project import begun_row, digests_of, load_project, steps_of
from jaxscan.project import project as module
from tests.opened import catalogue_of, edit, states


CARRIES = 'carries = "scanner"'
ALL = '["cloud", "mesh", "plan", "panorama"]'
SPLIT = 'pattern = "room-1"\nrig = "one"\nsettings = {{ every = 2 }}\n\n[[captures]]\npattern = "room-2"\n{}rig'


def own(museum, lines):
    """A table of its own for the second room, with more lines."""
    edit(museum, 'pattern = "room-*"\nrig', SPLIT.format(lines))


def all_products(museum):
    edit(museum, '["cloud", "measures", "mesh"]', ALL)


def kinds(file, name):
    return [step.kind for step in steps_of(load_project(file)) if step.key.endswith(f"/{name}")]


def test_captures_with_products_and_formats_of_their_own(museum):
    before, _ = digests_of(steps_of(load_project(museum)))
    own(museum, 'products = ["panorama", "mesh"]\nformats = ["las"]\n')
    steps = {step.key: step for step in steps_of(load_project(museum))}
    assert kinds(museum, "room-1") == ["cloud", "measures", "mesh"]
    assert kinds(museum, "room-2") == ["cloud", "mesh", "panorama"]
    assert steps["cloud/room-2"].outputs == ("clouds/room-2.ply", "clouds/room-2.las")
    after, _ = digests_of(steps.values())
    # Captures without products of their own stay as they are; other formats are another cloud, and another mesh of it.
    assert {key for key in before if after.get(key) == before[key]} == {
        "cloud/room-1",
        "measures/room-1",
        "mesh/room-1",
    }
    edit(museum, 'formats = ["las"]\n', "")
    after, _ = digests_of(steps_of(load_project(museum)))
    assert {key for key in before if after.get(key) != before[key]} == {"measures/room-2"}


def test_a_stale_product_that_is_no_more_asked_for_is_not_made(museum):
    catalogue = catalogue_of(museum)
    mesh = states(museum)["mesh/room-2"]
    catalogue.write([begun_row(mesh)])
    catalogue.close()
    assert "was begun" in states(museum)["mesh/room-2"].why
    own(museum, 'products = ["cloud"]\n')
    assert "mesh/room-2" not in states(museum) and "mesh/room-1" in states(museum)


@pytest.mark.parametrize(
    ("lines", "says"),
    [
        ('products = ["clouds"]\n', "captures[1].products"),
        ("products = []\n", "captures[1].products"),
        ('formats = ["doc"]\n', "captures[1].formats"),
    ],
)
def test_products_that_there_are_not(museum, lines, says):
    own(museum, lines)
    with pytest.raises(ConfigError) as refused:
        load_project(museum)
    assert says in str(refused.value) and "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("carries", "made", "gone"),
    [
        ("object", ["mesh"], "no plan or panorama of room-2"),
        ("linear", ["mesh", "plan"], "no panorama of room-2"),
        ("nothing", [], "no mesh, plan or panorama of room-2"),
    ],
)
def test_what_cannot_be_made_is_left_out(museum, carries, made, gone):
    all_products(museum)
    edit(museum.parent / "room-2" / HEADER_NAME, CARRIES, CARRIES.replace("scanner", carries))
    (note,) = load_project(museum).notes
    assert note.startswith(f'captures "room-*": {gone}: capture.toml says carries = "{carries}", and ')
    assert "\n" not in note
    assert kinds(museum, "room-1") == ["cloud", "mesh", "plan", "panorama"]
    assert kinds(museum, "room-2") == ["cloud", *made]
    own(museum, f"products = {ALL}\n")
    (note,) = load_project(museum).notes
    assert note.startswith(f'captures "room-2": {gone}: ') and kinds(museum, "room-2") == ["cloud", *made]
    wanted = ", ".join(f'"{kind}"' for kind in ["cloud", *made])
    edit(museum, f'pattern = "room-2"\nproducts = {ALL}\n', f'pattern = "room-2"\nproducts = [{wanted}]\n')
    assert load_project(museum).notes == ()


def test_a_header_that_cannot_be_read_is_said_by_the_cloud(museum):
    all_products(museum)
    (museum.parent / "room-2" / HEADER_NAME).write_text("torn")
    (museum.parent / "room-1" / JOURNAL_NAME).unlink()
    assert load_project(museum).notes == () and "plan" in kinds(museum, "room-2")


def test_headers_are_read_only_where_they_matter(museum, monkeypatch):
    def read(address):
        raise AssertionError(address)

    monkeypatch.setattr(module, "header_of", read)
    edit(museum, '["cloud", "measures", "mesh"]', '["cloud", "measures", "report"]')
    assert load_project(museum).notes == ()
