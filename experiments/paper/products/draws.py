"""Calibrations of the same images by both methods, once for each draw of noise."""

import shutil
from pathlib import Path
from typing import NamedTuple

import numpy as np

import jaxscan
from experiments.paper.methods import horus
from experiments.paper.methods.equations import linear_plane, points_on_board, total_plane
from experiments.paper.methods.paper_way import Extract, PaperWay, calibrate_paper_way, stripe_on_board
from experiments.paper.methods.plain_stripes import gravity, highest
from experiments.paper.rendering.boards import expect, expect_each, our_plan, paper_plan, write_capture, write_captures
from experiments.paper.stage import Stage
from jaxscan.calibration import CalibrationSettings
from jaxscan.files import Capture


SETTINGS = CalibrationSettings(judge=False)
"""The tests of the models take longer than the solve, and no draw uses them."""
_OURS = 1000
"""First seed of the captures of our protocol."""


class Draw(NamedTuple):
    """One draw of noise of the paper's 23 views."""

    number: int
    paper: PaperWay
    """By the paper's method, stripes by their centre of gravity."""
    ours: Path
    """Of the same images: the calibration by `jaxscan.calibrate`."""
    highest: PaperWay
    """By the paper's method, stripes by their highest pixel."""

    def by(self, finder: str) -> PaperWay:
        """By the paper's method with a stripe finder of `EXTRACTORS`."""
        return {"gravity": self.paper, "highest": self.highest}[finder]


def draws(stage: Stage) -> list[Draw]:
    """`stage.draws` draws of noise; made once, then loaded. Those that a method cannot calibrate are left out."""
    missing = [number for number in range(stage.draws) if not _is_there(stage, number)]
    if missing:
        plan = paper_plan(stage)
        records = expect(stage, plan)
        stage.say(f"rendered the paper's {len(records)} views")
        for number in missing:
            folder = _emptied(stage.product(f"draws/capture_{number}"))
            capture = jaxscan.open_capture(write_capture(stage, records, plan, number, folder))
            try:
                _calibrate(stage, capture, number)
                stage.say(f"draw {number + 1} of {stage.draws}")
            except (ValueError, jaxscan.JaxscanError) as problem:
                # Tables say how many draws they have.
                _failed_path(stage, number).write_text(f"{problem}\n")
                stage.say(f"draw {number + 1} of {stage.draws} failed: {problem}")
            shutil.rmtree(folder)
    found = [number for number in range(stage.draws) if not _failed_path(stage, number).exists()]
    return [_load(stage, number) for number in found]


def _calibrate(stage: Stage, capture: Capture, number: int) -> None:
    way = calibrate_paper_way(capture, gravity)
    save_paper_way(way, _paper_path(stage, number, "gravity"))
    save_paper_way(with_stripes(way, capture, highest), _paper_path(stage, number, "highest"))
    # Last: a draw with this file is complete.
    jaxscan.save_calibration(jaxscan.calibrate(capture, settings=SETTINGS), _ours_path(stage, number))


def our_calibrations(stage: Stage, count: int = 3) -> list[Path]:
    """Calibrations by our own protocol, each with its own noise; made once. A quick stage has one only.

    Returns:
        Paths for `jaxscan.load_scanner` or `jaxscan.load_calibration`.
    """
    count = 1 if stage.quick else count
    paths = [stage.product(f"draws/our_protocol_{number}.json") for number in range(count)]
    missing = [
        number for number, path in enumerate(paths) if not path.exists() or not horus_path(stage, number).exists()
    ]
    if missing:
        plan = our_plan(stage)
        folders = {_OURS + number: _emptied(stage.product(f"draws/our_capture_{number}")) for number in missing}
        # View by view: 66 of them without noise are too many to keep.
        write_captures(stage, expect_each(stage, plan), plan, folders)
        stage.say(f"rendered the {len(plan.lit)} views of our protocol")
        for number, folder in zip(missing, folders.values(), strict=True):
            calibration = jaxscan.calibrate(jaxscan.open_capture(folder), settings=SETTINGS)
            jaxscan.save_calibration(calibration, paths[number])
            horus.save(horus.calibrate(jaxscan.open_capture(folder)), horus_path(stage, number))
            shutil.rmtree(folder)
        stage.say(f"{len(missing)} calibrations by our protocol")
    return paths


def horus_path(stage: Stage, number: int) -> Path:
    """Where `our_calibrations` leaves a desk scanner's calibration of the same images, for `horus.load`."""
    return stage.product(f"draws/horus_{number}.npz")


def with_stripes(way: PaperWay, capture: Capture, extract: Extract) -> PaperWay:
    """The paper's calibration of the same capture with another stripe finder: camera and poses do not depend on it."""
    outline, stripe, lifted = capture.board.outline(), list(way.stripe), []
    for index, uv in enumerate(way.stripe):
        if len(uv):
            found = extract(*capture.frames(index))
            stripe[index] = stripe_on_board(way.matrix, way.k, way.pose[index], outline, found)
            lifted.append(points_on_board(way.matrix, way.k, way.pose[index], stripe[index]))
    every = np.concatenate(lifted)
    return way._replace(stripe=stripe, linear=linear_plane(every), total=total_plane(every))


def save_paper_way(way: PaperWay, path: Path) -> None:
    """Write a calibration by the paper's method, an npz file."""
    fields = way._asdict()
    stripe = fields.pop("stripe")
    counts = np.array([len(view) for view in stripe])
    np.savez_compressed(path, counts=counts, stripe=np.concatenate([*stripe, np.zeros((0, 2))]), **fields)


def load_paper_way(path: Path) -> PaperWay:
    """Read a file of `save_paper_way`."""
    with np.load(path) as file:
        fields = dict(file)
    counts, stripe = fields.pop("counts"), fields.pop("stripe")
    numbers = {name: float(fields.pop(name)) for name in ("k", "pair_angle")}
    return PaperWay(**fields, **numbers, stripe=np.split(stripe, np.cumsum(counts)[:-1]))


def _paper_path(stage: Stage, number: int, name: str) -> Path:
    return stage.product(f"draws/paper_{name}_{number:02}.npz")


def _ours_path(stage: Stage, number: int) -> Path:
    return stage.product(f"draws/ours_{number:02}.json")


def _is_there(stage: Stage, number: int) -> bool:
    return _ours_path(stage, number).exists() or _failed_path(stage, number).exists()


def _failed_path(stage: Stage, number: int) -> Path:
    return stage.product(f"draws/failed_{number:02}.txt")


def _load(stage: Stage, number: int) -> Draw:
    mean, top = (load_paper_way(_paper_path(stage, number, name)) for name in ("gravity", "highest"))
    return Draw(number, mean, _ours_path(stage, number), top)


def _emptied(folder: Path) -> Path:
    shutil.rmtree(folder, ignore_errors=True)
    return folder
