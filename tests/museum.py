"""A project of two sweeps with a calibration."""

import shutil

import pytest


PROJECT = """
[project]
name = "museum"
products = ["cloud", "measures", "mesh"]
formats = ["ply", "npz"]

[[rig]]
name = "one"
calibration = "calibration.json"

[[captures]]
pattern = "room-*"
rig = "one"
settings = { every = 2 }
"""


def make_museum(tiny, folder):
    """The file of a project in a folder, whose two captures are copies of the tiny sweep."""
    for path in tiny.calibration.parent.glob(f"{tiny.calibration.stem}.*"):
        shutil.copy(path, folder / path.name)
    for name in ("room-1", "room-2"):
        shutil.copytree(tiny.sweep, folder / name, ignore=shutil.ignore_patterns("stripes.npz"))
    file = folder / "project.toml"
    file.write_text(PROJECT)
    return file


@pytest.fixture
def museum(tiny, tmp_path):
    return make_museum(tiny, tmp_path)
