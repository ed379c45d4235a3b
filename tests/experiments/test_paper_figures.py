"""Tables and figures of the paper from calibrations of the quick set that are kept, without compiling their solves.

`kept/` holds what `python -m experiments.paper table_1 figure_6 --world kind --quick` leaves in its work folder: the
draws, and what `observe_held_out` sees of the boards that no calibration has seen. Those boards are rendered here.
"""

import shutil
from pathlib import Path

import numpy as np
import pytest

import jaxscan
from experiments.paper import figure_5, figure_6
from experiments.paper.__main__ import run_one
from experiments.paper.stage import Stage, load_baseline, world


pytestmark = pytest.mark.more


KEPT = Path(__file__).parent / "kept"


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    folder = tmp_path_factory.mktemp("paper")
    shutil.copytree(KEPT / "draws", folder / "work" / "draws")
    return Stage("kind", world("kind", quick=True), folder / "work", folder / "pictures", quick=True)


@pytest.fixture
def observed(monkeypatch):
    kept = lambda calibration, capture: jaxscan.load_calibration(KEPT / "held_out.json").observations
    monkeypatch.setattr(figure_5, "observe_held_out", kept)
    monkeypatch.setattr(figure_6, "observe_held_out", kept)


@pytest.mark.parametrize("name", ["table_1", "table_2", "figure_5", "figure_6"])
def test_figures_are_those_of_the_baseline(stage, observed, name):
    found = run_one(stage, name)
    assert found["worse"] == []
    assert bool(list(stage.pictures.glob(f"{name}*_kind.png"))) == name.startswith("figure")
    assert all(np.isfinite(one["value"]) for one in found["metrics"])
    keys = {f"{name}.{one['key']}" for one in found["metrics"]}
    assert keys == {key for key in load_baseline("quick kind") if key.startswith(f"{name}.")}
