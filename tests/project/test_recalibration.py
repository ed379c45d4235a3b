"""A rig whose sweeps refine its calibration, one room after the other.

Two sweeps of the tiny room, seeds 3 and 5, and a copy of the first.
"""

import os
import shutil

import numpy as np
import pytest

import jaxscan
from jaxscan.project import load_project, steps_of
from tests.conftest import TINY
from tests.opened import edit, states, work


GROUPS = """
[[group]]
name = "hall"
captures = ["room-2", "room-3"]

[[group]]
name = "door"
captures = ["room-2", "room-3"]
"""


@pytest.fixture
def rig(museum):
    edit(museum, 'calibration = "calibration.json"', 'calibration = "calibration.json"\nrecalibrate = true')
    edit(museum, '["cloud", "measures", "mesh"]', '["cloud"]')
    return museum


def test_rooms_come_one_after_the_other_and_each_sweep_once(rig):
    shutil.copytree(rig.parent / "room-2", rig.parent / "room-3")
    rig.write_text(rig.read_text() + GROUPS)
    steps = {step.key: step for step in steps_of(load_project(rig))}
    first, both = steps["recalibration/one/room-1"], steps["recalibration/one/group/hall"]
    assert list(steps)[:2] == [first.key, both.key] and "recalibration/one/group/door" not in steps
    assert first.inputs == () and first.sources["calibration"].endswith("calibration.json")
    assert both.inputs == (first.key,) and both.products == {"calibration": first.outputs[0]}
    for name in ("room-1", "room-2", "room-3"):
        assert steps[f"cloud/{name}"].products == {"calibration": both.outputs[0]}
    # What registers a group adds its own sweeps, so it must not begin with what they told already.
    for name in ("hall", "door"):
        assert steps[f"register/{name}"].products == {"calibration": first.outputs[0]}


@pytest.mark.slow
def test_each_room_adds_what_it_tells(rig, tmp_path, run):
    (tmp_path / "other.toml").write_text(TINY.replace("seed = 3", "seed = 5"))
    assert run("simulate", tmp_path / "other.toml", "-o", tmp_path / "other").code == 0
    shutil.move(rig.parent / "room-2", rig.parent / "room-3")
    os.rename(tmp_path / "other" / "sweep", rig.parent / "room-2")
    # A sweep that cannot be used, after the others.
    shutil.copytree(rig.parent / "room-1", rig.parent / "room-4")
    for image in (rig.parent / "room-4" / "on").iterdir():
        image.write_bytes(b"no image")
    rows = {row.key: row for row in work(rig)}
    assert [key for key, row in rows.items() if row.state == "failed"] == ["cloud/room-4"]
    places = [rig.parent / "calibration.json"]
    places += [rig.parent / "products" / "calibrations" / "one" / f"room-{number}.json" for number in (1, 2, 3, 4)]
    given, one, two, three, four = (jaxscan.load_calibration(place) for place in places)
    sigmas = [np.sqrt(np.trace(np.asarray(found.scanner.covariance))) for found in (given, one, two)]
    assert sigmas[0] > sigmas[1] > sigmas[2]
    assert len(two.provenance["earlier"]) == len(one.provenance["earlier"]) + 1
    for number, found, why in ((3, three, "was already used"), (4, four, "room-4")):
        message = rows[f"recalibration/one/room-{number}"].message
        assert "The calibration is as it was: " in message and why in message
        assert found.provenance == two.provenance
    assert [key for key, found in states(rig).items() if found.state != "done"] == ["cloud/room-4"]
