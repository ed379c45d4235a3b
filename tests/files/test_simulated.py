"""The folder of a simulation: it appears whole or not at all, and no process touches another's."""

import os
from pathlib import Path

import numpy as np
import pytest

from jaxscan.errors import CaptureError
from jaxscan.files import load_toml
from jaxscan.files.simulated import SimulatedCaptures, new_simulation, write_sweep
from jaxscan.simulation import RenderedRecord, RowTruth, SimulationConfig


CONFIG = Path(__file__).resolve().parents[2] / "configs" / "paper.toml"


def config():
    full = load_toml(CONFIG, SimulationConfig)
    camera = full.camera.model_copy(update={"width": 6, "height": 4})
    boards = full.boards.model_copy(update={"free_views": 0, "placements": 0})
    return full.model_copy(update={"camera": camera, "boards": boards})


def records(count=3):
    """Records of a sweep that nobody rendered."""
    shape = (6, 4) if config().laser[0].stripe_axis == "columns" else (4, 6)
    truth = RowTruth(**{name: np.ones(4) for name in RowTruth._fields})
    truth = truth._replace(xyz=np.ones((4, 3)), valid=np.ones(4, bool))
    for k in range(count):
        yield RenderedRecord(0.1 * k, None, np.full(shape, k, np.uint8), np.zeros(shape, np.uint8), truth)


def write(folder, sweep=None):
    with new_simulation(Path(folder)) as part:
        pairs = write_sweep(config(), part, records() if sweep is None else sweep, every=1000)
    return SimulatedCaptures(Path(folder), 0, pairs)


def test_the_folder_appears_whole(tmp_path):
    made = write(tmp_path / "new" / "made")
    assert os.listdir(tmp_path / "new") == ["made"]
    assert SimulatedCaptures.of(made.folder).sweep_pairs == 3
    assert made.truth.exists() and made.true_cloud.exists()
    (tmp_path / "empty").mkdir()
    assert write(tmp_path / "empty").sweep.is_dir()
    with pytest.raises(CaptureError, match="exists and is not empty"):
        write(tmp_path / "empty")


@pytest.mark.parametrize("problem", [KeyboardInterrupt(), CaptureError("no"), OSError(28, "No space left on device")])
def test_a_failure_leaves_nothing_and_touches_nothing_of_others(tmp_path, problem):
    # The names that an earlier version took, and one that another process holds under any number.
    for name in (f".made.partial-{os.getpid()}", ".part-x"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "work").touch()

    def failing():
        yield from records(2)
        raise problem

    with pytest.raises(KeyboardInterrupt if isinstance(problem, KeyboardInterrupt) else CaptureError):
        write(tmp_path / "made", failing())
    assert sorted(os.listdir(tmp_path)) == [f".made.partial-{os.getpid()}", ".part-x"]
    write(tmp_path / "made")
    assert (tmp_path / f".made.partial-{os.getpid()}" / "work").exists() and (tmp_path / "made").is_dir()
