"""The table of docs/programs.md: what of a cloud arrives in the programs that users open next."""

import contextlib
import itertools
import os
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from jaxscan.errors import CloudError
from jaxscan.files.clouds import WRITERS, in_metres, load_cloud, read_cloud, save_cloud, shifted
from jaxscan.reconstruction import SMOOTHED, join_clouds

from ..files.clouds import make_cloud
from ..files.test_joined_clouds import COVARIANCE, SECOND
from .programs import PROGRAMS
from .writers import WRITERS as OTHERS
from .writers import given


pytestmark = pytest.mark.rig


BACK = ("reads", "points", "colours", "normals", "intensity")
PAGE = Path(__file__).parents[2] / "docs" / "programs.md"
CELLS = ("opens", "points", "colours", "normals", "sigmas", "grid", "pose", "frame")
EPSG = 25832
REQUIRED = "JAXSCAN_REQUIRE_PROGRAMS"


@contextlib.contextmanager
def required():
    """A program that is missing is a failure where all of them are required, and a skip elsewhere."""
    try:
        yield
    except pytest.skip.Exception as skipped:
        if os.environ.get(REQUIRED):
            pytest.fail(f"{REQUIRED} is set, but: {skipped}")
        raise


def rows(columns=CELLS):
    """(program, format, cells) of every row of the table with these columns."""
    lines = [line.strip("| \n").split(" | ") for line in PAGE.read_text().splitlines() if line.startswith("| ")]
    start = next(k for k, line in enumerate(lines) if tuple(line) == ("program", "format", *columns))
    table = itertools.takewhile(lambda line: line[0] != "program", lines[start + 1 :])
    return [(line[0], line[1], line[2:]) for line in table if line[0] in PROGRAMS]


@pytest.fixture(scope="module")
def clouds():
    """Two stations: in the room, and each in its own frame."""
    parts = [make_cloud(), make_cloud(seed=1)]
    return join_clouds(parts, [np.eye(4), SECOND], [np.zeros((6, 6)), COVARIANCE]), parts


def cells_of(program, path, folder, clouds):
    """What arrives, in the words of the table."""
    joined, parts = clouds
    try:
        opened = PROGRAMS[program](path, folder)
    except Exception:  # Each program has its own error for a format that it does not know.
        return ["no"] * len(CELLS)
    expected = joined.points()
    apart = np.concatenate([part.xyz[part.valid] for part in parts])
    # Steps of LAS are 0.1 mm, text has micrometres; points of the cloud are decimetres apart.
    near, placed = 1.1e-4, True
    distance, index = cKDTree(opened.xyz).query(expected.xyz)
    if distance.max() > near:
        placed = False
        distance, index = cKDTree(opened.xyz).query(apart)
    whole = len(opened.xyz) == len(expected.xyz) and distance.max() <= near
    if not whole:
        return ["yes", *["no"] * (len(CELLS) - 1)]

    def arrives(values, wanted, tolerance):
        return values is not None and np.abs(np.asarray(values, float)[index] - wanted).max() <= tolerance

    columns = opened.columns
    sigma = arrives(columns.get("sigma_random"), expected.sigma_random, 1e-7)
    grid = arrives(columns.get("row"), expected.row, 0) and "step" in columns
    found = (
        True,
        True,
        arrives(opened.rgb, expected.rgb, 0),
        # Some programs pack a normal into 2 bytes.
        arrives(opened.normals, expected.normals, 0.02),
        sigma,
        grid,
        placed,
        opened.epsg == EPSG,
    )
    return ["yes" if one else "no" for one in found]


@pytest.mark.parametrize(("program", "suffix", "cells"), rows(), ids=lambda one: one if isinstance(one, str) else "")
def test_the_table_tells_what_arrives(tmp_path, clouds, program, suffix, cells):
    with required():
        path = tmp_path / f"room.{suffix.lower()}"
        save_cloud(clouds[0], path, epsg=EPSG)
        found = cells_of(program, path, tmp_path, clouds)
    assert dict(zip(CELLS, found, strict=True)) == dict(zip(CELLS, cells, strict=True))


def test_the_table_has_every_program_and_format():
    listed = rows()
    assert {program for program, _, _ in listed} == set(PROGRAMS)
    # NPZ is NumPy's.
    assert {f".{suffix.lower()}" for _, suffix, _ in listed} == set(WRITERS) - {".npz"}


def cells_back(program, path, folder):
    """What of a cloud that the program wrote with its own code is read, in the words of the table."""
    cloud = given()
    OTHERS[program](path, cloud, folder)
    stored = read_cloud(path)
    found, notes = in_metres(stored)
    # Nothing is read without saying what as.
    assert notes[0].startswith("x, y, z")
    points = found.points()
    distance, index = cKDTree(points.xyz).query(cloud.xyz)
    whole = len(points.xyz) == len(cloud.xyz) and distance.max() <= 1.1e-4
    level = points.intensity[index] / max(points.intensity.max(), 1e-9) * cloud.intensity.max()
    arrived = (
        True,
        whole,
        whole and np.array_equal(points.rgb[index], cloud.rgb),
        # MeshLab packs a normal into text of six digits, CloudCompare into 2 bytes.
        whole and np.abs(points.normals[index] - cloud.normals).max() <= 0.02,
        # In the numbers of the format; of laspy thousandths.
        whole and np.abs(level - cloud.intensity).max() <= 1e-3,
    )
    # What does not arrive is known to be missing, and not made up.
    for name, there in zip(("rgb", "normals", "intensity"), arrived[2:], strict=True):
        assert (name in found.lacks) == (not there), name
    return ["yes" if one else "no" for one in arrived]


@pytest.mark.parametrize(
    ("program", "suffix", "cells"), rows(BACK), ids=lambda one: one if isinstance(one, str) else ""
)
def test_the_table_tells_what_comes_back(tmp_path, program, suffix, cells):
    with required():
        found = cells_back(program, tmp_path / f"room.{suffix.lower()}", tmp_path)
    assert dict(zip(BACK, found, strict=True)) == dict(zip(BACK, cells, strict=True))


@pytest.mark.parametrize(("program", "suffix", "cells"), rows(), ids=lambda one: one if isinstance(one, str) else "")
def test_a_format_that_is_not_in_the_table_of_writers_is_not_written(tmp_path, program, suffix, cells):
    """Programs choose another format, raise, or write nothing; what they write under a wrong name is refused."""
    if (program, suffix) in {(one, kind) for one, kind, _ in rows(BACK)}:
        return
    path = tmp_path / f"room.{suffix.lower()}"
    try:
        OTHERS[program](path, given(), tmp_path)
    except Exception:  # Each program has its own error for a format that it does not know.
        return
    if path.exists():
        with pytest.raises(CloudError):
            read_cloud(path)


def test_what_cloudcompare_saves_is_read_back_on_its_grid(tmp_path):
    cloud = make_cloud(smoothed=True)
    save_cloud(cloud, tmp_path / "room.ply")
    with required():
        PROGRAMS["CloudCompare"](tmp_path / "room.ply", tmp_path)
    back = load_cloud(tmp_path / "cloudcompare.ply")
    profiles, lines = back.valid.shape
    # Profiles and lines after the last point are known by nobody.
    assert np.array_equal(back.valid, cloud.valid[:profiles, :lines]) and not cloud.valid[profiles:].any()
    seen = cloud.valid[:profiles].any(1)
    np.testing.assert_allclose(back.angle[seen], cloud.angle[:profiles][seen], rtol=1e-7)
    assert np.array_equal(back.laser[seen], cloud.laser[:profiles][seen])
    for name in ("xyz", "rgb", "sigma_random", "sigma_systematic", "intensity", *SMOOTHED):
        assert np.array_equal(getattr(back, name)[back.valid], getattr(cloud, name)[cloud.valid]), name


def test_no_line_of_a_header_is_too_long_for_meshlab(tmp_path):
    """Coordinates of a map and a turn have the most digits; MeshLab refuses lines of more than 509 bytes."""
    joined = join_clouds([make_cloud()] * 2, [np.eye(4), SECOND], [COVARIANCE] * 2)
    save_cloud(shifted(joined, (-356000.123456789, 5400000.123456789, 1 / 3)), tmp_path / "a.ply", epsg=EPSG)
    head = (tmp_path / "a.ply").read_bytes().split(b"end_header")[0]
    assert max(map(len, head.splitlines())) < 509
