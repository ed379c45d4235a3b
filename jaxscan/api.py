"""The public verbs: what joins the core and the edges."""

import functools
import hashlib
import itertools
import json
import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple, cast

import numpy as np

from jaxscan.calibration import (
    BoardStripe,
    BoardViews,
    Calibration,
    CalibrationSettings,
    Observations,
    calibrate_camera,
    calibrate_observations,
    select_board_stripes,
    stack_stripes,
)
from jaxscan.errors import CalibrationError, CaptureError
from jaxscan.files.atomic import write_atomically
from jaxscan.files.calibration import load_calibration as load_calibration
from jaxscan.files.calibration import load_scanner as load_scanner
from jaxscan.files.calibration import save_calibration as save_calibration
from jaxscan.files.capture import Capture as Capture
from jaxscan.files.capture import CaptureHeader, Record, create_capture
from jaxscan.files.capture import open_capture as open_capture
from jaxscan.files.clouds import load_cloud as load_cloud
from jaxscan.files.clouds import save_cloud as save_cloud
from jaxscan.files.config import load_toml
from jaxscan.geometry import AbstractBoard, Charuco
from jaxscan.geometry import Scanner as Scanner
from jaxscan.geometry import fit_axis as fit_axis
from jaxscan.geometry import fit_plane as fit_plane
from jaxscan.geometry.turntable import Carries
from jaxscan.measurement import compare_clouds as compare_clouds
from jaxscan.measurement import measure_distance as measure_distance
from jaxscan.measurement import measure_plane as measure_plane
from jaxscan.measurement import measure_room as measure_room
from jaxscan.reconstruction import PointCloud as PointCloud
from jaxscan.reconstruction import ReconstructSettings as ReconstructSettings
from jaxscan.reconstruction import Sweep as Sweep
from jaxscan.reconstruction import reconstruct as reconstruct
from jaxscan.simulation import RenderedRecord, RowTruth, SimulationConfig, render_boards, render_sweep, sweep_angles
from jaxscan.simulation import truth as simulation_truth
from jaxscan.stripes import LaserLine as LaserLine
from jaxscan.stripes import NoiseModel as NoiseModel
from jaxscan.stripes import Stripes as Stripes
from jaxscan.stripes import StripeSettings as StripeSettings
from jaxscan.stripes import extract_stripes as extract_stripes


if TYPE_CHECKING:
    from jaxscan.vision.boards import FoundCorners


Progress = Callable[[int, int], None]

BATCH_RECORDS = 8
"""Board records looked at together: enough for all cores, little against any memory."""
TEXTURE_PX = 60
"""Pixels per square of the picture from which boards are rendered."""


def calibrate(
    captures: Capture | Sequence[Capture],
    *,
    settings: CalibrationSettings | None = None,
    only_camera: bool = False,
    progress: Progress | None = None,
) -> Calibration:
    """Calibrate a rig from captures of a board: corners, stripes, one joint least squares.

    Args:
        captures: Calibration captures of the same board, camera and rig.
        settings: Of the solve.
        only_camera: Intrinsics alone; lasers and turntable are left out of the result.
        progress: Called with (records done, records in all).

    Returns:
        The calibration, with its covariance, quality and observations.

    Raises:
        CaptureError: If a capture is not a calibration capture, or they do not belong together.
        CalibrationError: If something cannot be determined; the message says what to capture.
    """
    captures = [captures] if isinstance(captures, Capture) else list(captures)
    if not captures:
        raise CaptureError("No capture was given; a calibration needs at least one capture of a board.")
    if not only_camera and not captures[0].lines:
        raise CalibrationError(
            f"{captures[0].path}: lists no [[laser]], so there is no laser plane to be found: capture the board with "
            "the laser on and off, or calibrate the camera alone (`--only camera`, `only_camera=True`)."
        )
    observations = observe_boards(captures, with_stripes=not only_camera, progress=progress)
    solve = calibrate_camera if only_camera else calibrate_observations
    result = solve(observations, settings=settings or CalibrationSettings())
    provenance = {
        **result.provenance,
        "captures": [{"name": capture.path.name, "digest": capture.digest()} for capture in captures],
        "versions": {name: metadata.version(name) for name in ("jaxscan", "jax", "optimistix", "numpy")},
    }
    return Calibration(**{**vars(result), "provenance": provenance})


def observe_boards(
    captures: Sequence[Capture], *, with_stripes: bool = True, progress: Progress | None = None
) -> Observations:
    """Find the board's corners, and the stripes on it, in calibration captures.

    Corners are looked for in the laser-off image where there is one. Views with the same
    placement share a board pose; a view of unknown table angle is a placement of its own.

    Args:
        captures: Calibration captures of the same board, camera and rig.
        with_stripes: Look for stripes too; they are not needed for a camera alone.
        progress: Called with (records done, records in all).

    Returns:
        What `calibrate` solves from.

    Raises:
        CaptureError: If a capture is not a calibration capture, or they do not belong together.
        CalibrationError: If the board is found in no image.
    """
    board = _common_board(captures)
    total = sum(len(capture) for capture in captures)
    views: list[_View] = []
    done = 0
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for number, capture in enumerate(captures):
            for start in range(0, len(capture), BATCH_RECORDS):
                indices = range(start, min(start + BATCH_RECORDS, len(capture)))
                looked = list(pool.map(functools.partial(_look_for_board, number, capture, board), indices))
                seen = _with_stripes(looked, capture, board) if with_stripes else looked
                # Frames go as soon as they are read: a capture may be larger than the memory.
                views += [view._replace(on=None, off=None) for view in seen]
                done += len(indices)
                if progress is not None:
                    progress(done, total)
    found = [view for view in views if view.corners is not None]
    if not found:
        raise CalibrationError(
            f"The board ({_describe(board)}) was found in none of {total} records: check the [board] table of "
            "capture.toml (columns and rows count inner corners for a chessboard, squares for ChArUco), and that the "
            "board is sharp, well lit and wholly in the image."
        )
    return _observations(found, captures[0], board)


class _View(NamedTuple):
    """One record on its way to an observation."""

    capture: int
    record: Record
    on: np.ndarray | None
    off: np.ndarray | None
    corners: "FoundCorners | None"
    stripe: BoardStripe | None = None


def _common_board(captures: Sequence[Capture]) -> AbstractBoard:
    """The board of all captures, which must show one board to one rig."""
    first = captures[0]
    for capture in captures:
        if capture.board is None:
            raise CaptureError(f"{capture.path}: is a sweep; a calibration needs captures of a board.")
        for what in ("camera", "laser", "turntable", "board"):
            if getattr(capture.header, what) != getattr(first.header, what):
                raise CaptureError(
                    f"{capture.path}: its [{what}] differs from that of {first.path}; "
                    "captures calibrated together must show the same board to the same rig."
                )
    return cast(AbstractBoard, first.board)


def _look_for_board(number: int, capture: Capture, board: AbstractBoard, index: int) -> _View:
    # Here, so that `import jaxscan` does not load OpenCV.
    from jaxscan.vision.boards import find_corners
    from jaxscan.vision.grey import to_grey

    on, off = capture.frames(index)
    image = on if off is None else off
    corners = None if image is None else find_corners(to_grey(image, capture.pixel_format), board)
    return _View(number, capture.records[index], on, off, corners)


def _with_stripes(views: list[_View], capture: Capture, board: AbstractBoard) -> list[_View]:
    """The views of one batch with the stripes that lie on their boards."""
    lit = [i for i, view in enumerate(views) if view.corners is not None and view.on is not None]
    for laser, line in enumerate(capture.lines):
        for with_off in (True, False):
            group = [i for i in lit if views[i].record.laser == laser and (views[i].off is not None) == with_off]
            if not group:
                continue
            # Padded to the batch's size, so that the extraction compiles once.
            padded = [group[min(k, len(group) - 1)] for k in range(BATCH_RECORDS)]
            on = np.stack([cast(np.ndarray, views[i].on) for i in padded])
            off = np.stack([cast(np.ndarray, views[i].off) for i in padded]) if with_off else None
            stripes = extract_stripes(on, off, pixel_format=capture.pixel_format, response=capture.response, line=line)
            for row, i in enumerate(group):
                views[i] = views[i]._replace(stripe=_board_stripe(stripes, row, views[i], capture, board))
    return views


def _board_stripe(stripes: Stripes, row: int, view: _View, capture: Capture, board: AbstractBoard) -> BoardStripe:
    from jaxscan.vision.grey import to_grey

    corners, line = cast("FoundCorners", view.corners), capture.lines[cast(int, view.record.laser)]
    u, sigma, valid, width = (
        np.asarray(field)[row] for field in (stripes.u, stripes.sigma, stripes.valid, stripes.width)
    )
    return select_board_stripes(
        u,
        sigma,
        valid,
        corners=corners.q,
        corners_valid=corners.valid,
        board=board,
        off=None if view.off is None else to_grey(view.off, capture.pixel_format),
        width=np.where(valid, width, 1.0),
        stripe_axis=line.stripe_axis,
    )


def _observations(views: list[_View], first: Capture, board: AbstractBoard) -> Observations:
    """The padded grids that the solve reads."""
    corners = [cast("FoundCorners", view.corners) for view in views]
    # A view that shares its placement with no other, or whose angle is unknown, stands alone.
    keys = [
        (view.capture, "alone", view.record.i)
        if view.record.placement is None or view.record.angle is None
        else (view.capture, "placement", view.record.placement)
        for view in views
    ]
    number = {key: index for index, key in enumerate(dict.fromkeys(keys))}
    stripes = [
        (view.stripe, index, cast(int, view.record.laser))
        for index, view in enumerate(views)
        if view.stripe is not None
    ]
    width, height = first.image_size
    return Observations(
        board=board,
        corners=BoardViews(
            q=np.stack([found.q for found in corners]),
            sigma=np.stack([found.sigma for found in corners]),
            valid=np.stack([found.valid for found in corners]),
            angle=np.array([view.record.angle or 0.0 for view in views]),
            placement=np.array([number[key] for key in keys], np.int32),
            record=np.array([view.record.i for view in views], np.int32),
        ),
        stripes=stack_stripes(stripes),
        width=width,
        height=height,
        laser_names=tuple(line.name for line in first.lines),
        up=first.header.camera.up,
        carries=cast(Carries, first.carries or "scanner"),
    )


def _describe(board: AbstractBoard) -> str:
    columns, rows = board.grid()
    kind = "ChArUco" if isinstance(board, Charuco) else "chessboard"
    return f"{kind}, {columns} x {rows} inner corners, {1e3 * board.square:g} mm"


class SimulatedCaptures(NamedTuple):
    """What `simulate` wrote."""

    folder: Path
    board_pairs: int
    sweep_pairs: int

    @staticmethod
    def of(folder: Path) -> "SimulatedCaptures":
        """Those in a folder that `simulate` made."""
        pairs = [len(open_capture(folder / name)) if (folder / name).is_dir() else 0 for name in ("boards", "sweep")]
        return SimulatedCaptures(folder, *pairs)

    @property
    def boards(self) -> Path:
        """The calibration capture."""
        return self.folder / "boards"

    @property
    def sweep(self) -> Path:
        """The captured sweep."""
        return self.folder / "sweep"

    @property
    def truth(self) -> Path:
        """What is true of the rig and its room, as JSON."""
        return self.folder / "truth.json"

    @property
    def true_cloud(self) -> Path:
        """The cloud that a perfect scanner would find."""
        return self.folder / "truth.npz"


def simulate(
    config: SimulationConfig,
    folder: str | Path,
    *,
    every: int = 1,
    seed: int | None = None,
    progress: Progress | None = None,
) -> SimulatedCaptures:
    """Render a simulated rig into captures, with the truth beside them.

    The folder appears when everything in it is whole.

    Args:
        config: The rig, its surroundings, its boards and its plan.
        folder: Must not exist, or be empty.
        every: Only every n-th step of the sweep.
        seed: Of noise and board poses, instead of the configuration's.
        progress: Called with (pairs done, pairs in all).

    Returns:
        Where everything was written, and how many pairs.

    Raises:
        CaptureError: If the folder exists and is not empty, or cannot be written.
        DependencyError: If Open3D or a system library that it needs is missing.
    """
    # Here, so that `import jaxscan` loads neither OpenCV nor the simulator.
    from jaxscan.vision.boards import board_texture

    folder = Path(folder)
    target = Path(os.path.abspath(folder))
    if target == Path.cwd():
        raise CaptureError(f"{folder}: is the folder you are in; name one that is to be made.")
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise CaptureError(f"{folder}: exists and is not empty; choose another folder, a capture is never overwritten.")
    spec = config.boards
    boards = spec.free_views + spec.placements * spec.angles
    steps = len(sweep_angles(config, every=every)) * len(config.laser)
    total = steps + boards * len(config.laser)
    partial = target.with_name(f".{target.name}.partial-{os.getpid()}")
    made = SimulatedCaptures(partial, boards * len(config.laser), steps)
    done = itertools.count(1)

    def count(records: Iterator[RenderedRecord]) -> Iterator[RenderedRecord]:
        for record in records:
            yield record
            if progress is not None:
                progress(next(done), total)

    try:
        partial.mkdir(parents=True)
        texture = board_texture(spec.board(), TEXTURE_PX)
        if boards:
            _write_capture(config, "calibration", made.boards, count(render_boards(config, texture, seed=seed)))
        truths = _write_capture(config, "sweep", made.sweep, count(render_sweep(config, every=every, seed=seed)))
        true = {**simulation_truth(config), "configuration": simulation_digest(config)}
        write_atomically(made.truth, json.dumps(true, indent=2).encode(), error=CaptureError)
        save_cloud(_cloud_of_truth(truths), made.true_cloud)
        if folder.exists():
            target.rmdir()
        partial.rename(target)
    except OSError as problem:
        raise CaptureError(f"{folder}: cannot be written: {problem.strerror or problem}.") from problem
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return made._replace(folder=folder)


def load_simulation(path: str | Path) -> SimulationConfig:
    """A simulated rig from a TOML file; see configs/.

    Args:
        path: The file.

    Returns:
        The configuration, checked.

    Raises:
        ConfigError: With the key that is unknown, missing or wrong.
    """
    return load_toml(Path(path), SimulationConfig)


def simulation_digest(config: SimulationConfig) -> str:
    """Digest of a configuration, by which its captures are known again: "sha256:<hex>"."""
    return "sha256:" + hashlib.sha256(config.model_dump_json().encode()).hexdigest()


def _write_capture(
    config: SimulationConfig, kind: Literal["calibration", "sweep"], folder: Path, records: Iterator[RenderedRecord]
) -> list[RenderedRecord]:
    """Write records as a capture; what is returned has no frames."""
    camera = {**config.camera.model_dump(include={"width", "height", "up"})}
    camera |= {"pixel_format": config.sensor.pixel_format, "response": config.sensor.response}
    board = config.boards.model_dump(include={"type", "columns", "rows", "square_mm"})
    if config.boards.type == "charuco":
        board |= config.boards.model_dump(include={"marker_mm", "dictionary"})
    header = CaptureHeader.model_validate(
        {
            "kind": kind,
            "camera": camera,
            "turntable": {"carries": config.turntable.carries},
            "laser": [laser.model_dump(include={"name", "colour", "stripe_axis"}) for laser in config.laser],
            "board": board if kind == "calibration" else None,
            "acquisition": {"software": "jaxscan simulate"},
        }
    )
    bare = []
    # A rendering can be made again, so it does not wait for the disk.
    with create_capture(folder, header, durable=False) as writer:
        for record in records:
            writer.append(
                angle_deg=float(np.rad2deg(record.angle)),
                on=record.on,
                off=record.off,
                placement=record.placement,
                lasers=[config.laser[record.laser_index].name],
            )
            bare.append(record._replace(on=np.empty(0, np.uint8), off=np.empty(0, np.uint8)))
    return bare


def _cloud_of_truth(records: Sequence[RenderedRecord]) -> PointCloud:
    """The cloud of a perfect scanner; `intensity` is the stripe's true peak [DN]."""
    truths: list[RowTruth] = [record.truth for record in records]
    grid = (len(truths), len(truths[0].u))
    return PointCloud(
        xyz=np.stack([t.xyz for t in truths]).astype(np.float32),
        rgb=np.zeros((*grid, 3), np.uint8),
        intensity=np.stack([t.amplitude for t in truths]).astype(np.float32),
        normals=np.zeros((*grid, 3), np.float32),
        sigma_random=np.zeros(grid, np.float32),
        sigma_systematic=np.zeros(grid, np.float32),
        valid=np.stack([t.valid for t in truths]),
        record=np.arange(len(truths), dtype=np.int32),
        laser=np.array([record.laser_index for record in records], np.int32),
        angle=np.array([record.angle for record in records]),
    )
