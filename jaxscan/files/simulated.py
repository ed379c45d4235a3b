"""A simulated rig's captures in one folder, with the truth beside them."""

import contextlib
import hashlib
import json
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from jaxscan.errors import CaptureError
from jaxscan.files.capture import CaptureHeader, open_capture
from jaxscan.files.clouds import save_cloud
from jaxscan.files.disk import check_name, reported, whole_folder, write_atomically
from jaxscan.files.recording import create_capture
from jaxscan.reconstruction import PointCloud
from jaxscan.simulation import RenderedRecord, SimulationConfig, board_pairs, sweep_angles, true_cloud
from jaxscan.simulation import truth as simulation_truth


Progress = Callable[[int, int], None]
BOARDS, SWEEP, TRUTH, TRUE_CLOUD = "boards", "sweep", "truth.json", "truth.npz"
"""Names in the folder of a simulation."""


class SimulatedCaptures(NamedTuple):
    """The folder that `simulate` wrote."""

    folder: Path
    board_pairs: int
    sweep_pairs: int

    @staticmethod
    def of(folder: Path) -> "SimulatedCaptures":
        """The captures in a folder that `simulate` wrote."""
        pairs = [len(open_capture(folder / name)) if os.path.isdir(folder / name) else 0 for name in (BOARDS, SWEEP)]
        return SimulatedCaptures(folder, *pairs)

    @property
    def boards(self) -> Path:
        """The calibration capture."""
        return self.folder / BOARDS

    @property
    def sweep(self) -> Path:
        """The captured sweep."""
        return self.folder / SWEEP

    @property
    def truth(self) -> Path:
        """The truth of the rig and its room, as JSON."""
        return self.folder / TRUTH

    @property
    def true_cloud(self) -> Path:
        """The cloud that a perfect scanner would find."""
        return self.folder / TRUE_CLOUD


@contextlib.contextmanager
def new_simulation(folder: Path) -> Iterator[Path]:
    """A folder for the captures of a simulation and their truth, which appears when all its files are complete.

    Args:
        folder: Must not exist, or be empty.

    Yields:
        The folder to write to. It gets its name at the end, and is removed after an error.

    Raises:
        CaptureError: If the folder exists and is not empty, or cannot be written.
    """
    target = Path(os.path.abspath(folder))
    if target == Path.cwd():
        raise CaptureError(f"{folder}: is the folder you are in; name one that is to be made.")
    check_name(target, error=CaptureError)
    if os.path.lexists(target) and (not os.path.isdir(target) or os.listdir(target)):
        raise CaptureError(f"{folder}: exists and is not empty; choose another folder, a capture is never overwritten.")
    with reported(f"{folder}: cannot be written", error=CaptureError), whole_folder(target, durable=False) as part:
        yield part


def write_boards(
    config: SimulationConfig, folder: Path, records: Iterator[RenderedRecord], progress: Progress | None = None
) -> int:
    """Write the rendered records of boards as a capture, where the configuration has any.

    Args:
        config: The rig, its surroundings and its boards.
        folder: The one of `new_simulation`.
        records: The records, rendered as they are asked for.
        progress: Called with (pairs done, pairs in all).
    """
    pairs = board_pairs(config)
    if pairs:
        _write_capture(config, "calibration", folder / BOARDS, records, pairs, progress)
    return pairs


def write_sweep(
    config: SimulationConfig,
    folder: Path,
    records: Iterator[RenderedRecord],
    *,
    every: int = 1,
    progress: Progress | None = None,
) -> int:
    """Write the rendered records of a sweep as a capture, and the truth beside it.

    Args:
        config: The rig, its surroundings and its plan.
        folder: The one of `new_simulation`.
        records: The records, rendered as they are asked for.
        every: The sweep has only every n-th step.
        progress: Called with (pairs done, pairs in all).
    """
    steps = len(sweep_angles(config, every=every)) * len(config.laser)
    truths = _write_capture(config, "sweep", folder / SWEEP, records, steps, progress)
    true = {**simulation_truth(config), "configuration": simulation_digest(config)}
    write_atomically(folder / TRUTH, json.dumps(true, indent=2).encode(), error=CaptureError)
    save_cloud(_cloud_of_truth(truths), folder / TRUE_CLOUD)
    return steps


def simulation_digest(config: SimulationConfig) -> str:
    """Digest of a configuration, which identifies its captures: "sha256:<hex>"."""
    return "sha256:" + hashlib.sha256(config.model_dump_json().encode()).hexdigest()


def _write_capture(
    config: SimulationConfig,
    kind: Literal["calibration", "sweep"],
    folder: Path,
    records: Iterator[RenderedRecord],
    planned: int,
    progress: Progress | None,
) -> list[RenderedRecord]:
    """Write records as a capture; returns them without their frames."""
    sensor: dict[str, str | int] = {"pixel_format": config.sensor.pixel_format}
    if config.sensor.bits > 8:
        sensor["bits"] = config.sensor.bits
    if config.sensor.stated:
        sensor["response"] = config.sensor.response
    if config.sensor.stated and config.sensor.jpeg_quality is not None:
        sensor["compression"] = "jpeg"
    header = CaptureHeader.model_validate(
        {
            "kind": kind,
            "camera": config.camera.model_dump(include={"width", "height", "up"}) | sensor,
            "turntable": {"carries": config.turntable.carries},
            "laser": [laser.model_dump(include={"name", "colour", "stripe_axis"}) for laser in config.laser],
            "board": config.boards.table() if kind == "calibration" else None,
            "plan": {"steps": planned},
            "acquisition": {"software": "jaxscan simulate"},
        }
    )
    bare = []
    # A simulation can be run again, so it does not wait for the disk.
    with create_capture(folder, header, durable=False, digests=True) as writer:
        for record in records:
            writer.append(
                angle_deg=float(np.rad2deg(record.angle)),
                on=record.on,
                off=record.off,
                placement=record.placement,
                lasers=[config.laser[record.laser_index].name],
            )
            bare.append(record._replace(on=np.empty(0, np.uint8), off=np.empty(0, np.uint8)))
            if progress is not None:
                progress(len(bare), planned)
        writer.seal()
    return bare


def _cloud_of_truth(records: Sequence[RenderedRecord]) -> PointCloud:
    """The cloud of a perfect scanner; `intensity` is the stripe's true peak [DN]."""
    xyz, valid, angle = true_cloud(records)
    grid = valid.shape
    return PointCloud(
        xyz=xyz.astype(np.float32),
        rgb=np.zeros((*grid, 3), np.uint8),
        intensity=np.stack([record.truth.amplitude for record in records]).astype(np.float32),
        normals=np.zeros((*grid, 3), np.float32),
        sigma_random=np.zeros(grid, np.float32),
        sigma_systematic=np.zeros(grid, np.float32),
        valid=valid,
        record=np.arange(len(valid), dtype=np.int32),
        laser=np.array([record.laser_index for record in records], np.int32),
        angle=angle,
    )
