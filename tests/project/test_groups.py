"""Two stations of a room: registered together, and merged as E57 and a plan.

Two sweeps of 120 steps from (1.5, 1.8) and (1.9, 2.3) m in a room of 3.2 x 3.8 m, seeds 3 and 4. Limits: the distance
of the stations on the plan within 3 mm; what is merged within rounding.
"""

import json
import os

import numpy as np
import pytest

import jaxscan
from tests.conftest import TINY
from tests.opened import states, work


pytestmark = pytest.mark.slow
TEXT = """
[project]
name = "hall"
products = ["cloud"]
[[rig]]
name = "one"
calibration = "calibration.json"
[[captures]]
pattern = "room-*"
rig = "one"
[[group]]
name = "hall"
captures = ["room-a", "room-b"]
merged = ["e57", "plan"]
known = "known.toml"
"""
PLACES = {"a": (1.5, 1.8), "b": (1.9, 2.3)}


@pytest.fixture
def hall(tiny, tmp_path, run):
    """The project, with an empty box's two solutions told apart."""
    for number, (name, (x, y)) in enumerate(PLACES.items()):
        text = TINY.replace("rig_m = [1.5, 1.8, 1.2]", f"rig_m = [{x}, {y}, 1.2]").replace("steps = 60", "steps = 120")
        config = tmp_path / f"{name}.toml"
        config.write_text(text.replace("seed = 3", f"seed = {3 + number}"))
        assert run("simulate", config, "-o", tmp_path / name).code == 0
        os.rename(tmp_path / name / "sweep", tmp_path / f"room-{name}")
    (tmp_path / "calibration.json").write_bytes(tiny.calibration.read_bytes())
    (tmp_path / "known.toml").write_text("[[station]]\nat = [0.5, 0.4, 0.0]\nyaw_deg = 0\n")
    (tmp_path / "project.toml").write_text(TEXT)
    return tmp_path / "project.toml"


def test_stations_are_placed_and_merged(hall):
    rows = {row.key: row for row in work(hall)}
    assert [row.message for row in rows.values() if row.state == "failed"] == []
    assert {one.state for one in states(hall).values()} == {"done"}
    folder = hall.parent / "products" / "groups"
    first, second = json.loads((folder / "hall.stations.json").read_text())["stations"]
    np.testing.assert_array_equal(first["pose"], np.eye(4))
    apart = np.hypot(*np.array(second["pose"])[:2, 3])
    assert apart == pytest.approx(np.hypot(0.4, 0.5), abs=0.003)
    # No floor is seen in such small images, so the height is vague, and that is said.
    height = np.sqrt(np.array(second["covariance"])[2, 2])
    assert abs(second["pose"][2][3]) < 3 * height
    assert ("the place of room-b" in rows["register/hall"].message) == (height > 0.02)

    clouds = [jaxscan.load_cloud(folder / "hall" / f"room-{name}.ply") for name in PLACES]
    points = np.concatenate([np.asarray(cloud.xyz)[cloud.valid] for cloud in clouds])
    joined = jaxscan.load_cloud(folder / "hall.e57")
    np.testing.assert_allclose(np.asarray(joined.xyz)[joined.valid], points, rtol=0, atol=1e-6)
    np.testing.assert_allclose(joined.stations.pose[1], second["pose"], atol=1e-12)
    np.testing.assert_allclose(joined.stations.covariance[1], second["covariance"], rtol=1e-7, atol=1e-18)
    assert (folder / "hall.dxf").stat().st_size > 1000
