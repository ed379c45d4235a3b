"""Rehearses a calibration on made-up observations of the shapes that a capture will give, so that its code is compiled.

The code depends on the number of records, the board and the rig, which header and journal tell before an image is read.
"""

import contextlib
import hashlib
import threading
from collections.abc import Callable, Hashable, Sequence
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxscan.calibration import CalibrationSettings, calibrate_observations, rounded_sizes
from jaxscan.errors import OutputError
from jaxscan.files.capture import Capture
from jaxscan.files.disk import write_atomically
from jaxscan.geometry import AbstractBoard, Turntable, exponential
from jaxscan.geometry.scanner import UP_VECTORS
from jaxscan.observation import BoardViews, Observations, StripeViews


SOLVE = "solver"
"""Name of the job."""
_NOISE_PX = 0.05
_TILT_RAD = 0.45
# A board fills about half of the image, seen by a lens of this focal length in widths of the image.
_FOCAL, _FILLED = 0.9, 0.5
_POINTS = 512
_LEAST_POINTS = 8

_COMPILERS = ("jaxscan", "jax", "jaxlib", "equinox")

_rehearsed: set[Hashable] = set()
_one_at_a_time = threading.Lock()


def rehearsal(
    captures: Sequence[Capture], board: AbstractBoard, settings: CalibrationSettings, *, stripes: bool
) -> list[tuple[str, Callable[[], Any]]]:
    """The job that compiles the code of a calibration; none where it is compiled: for the second calibration of its
    kind in a process, or with a cache of compiled code on disk. A verdict compiles nothing.

    Args:
        captures: Captures of a board by a still rig or one with a turntable; for others there are no jobs.
        board: That board.
        settings: Settings of the solve.
        stripes: Whether stripes are looked for.
    """
    first, count = captures[0], sum(len(capture) for capture in captures)
    if first.carries == "linear" or count < 3:
        return []
    # The code knows rounded numbers of views and corners, and no size of images.
    sizes = rounded_sizes(count, len(board.corners())), len(first.lasers), first.carries
    key = ("calibration", *sizes, settings.camera, settings.free, settings.only, stripes)
    with _one_at_a_time:
        if key in _rehearsed or _is_kept(key):
            return []
        _rehearsed.add(key)

    def solve() -> None:
        made_up = _observations(captures, board, stripes=stripes)
        calibrate_observations(made_up, settings=replace(settings, judge=False))
        _remember(key)

    return [(SOLVE, solve)]


def _is_kept(kind: Hashable) -> bool:
    """Whether a note beside JAX's compiled code says that the code for a kind of work, told by its `repr`, is there."""
    note = _note(kind)
    return note is not None and note.exists()


def _remember(kind: Hashable) -> None:
    """Write that note; without a cache on disk, nothing."""
    note = _note(kind)
    # A cache that cannot be written to is no fault of the work.
    with contextlib.suppress(OutputError):
        if note is not None:
            text = f"compiled and kept here: {kind!r}\n"
            write_atomically(note, text.encode(), durable=False, error=OutputError, links="replace")


def _note(kind: Hashable) -> Path | None:
    folder = jax.config.values["jax_compilation_cache_dir"]
    if not folder:
        return None
    versions = [f"{name} {metadata.version(name)}" for name in _COMPILERS]
    words = repr((kind, versions, jax.default_backend()))
    return Path(folder) / f"compiled-{hashlib.sha256(words.encode()).hexdigest()[:16]}"


def _observations(captures: Sequence[Capture], board: AbstractBoard, *, stripes: bool) -> Observations:
    """Observations of a made-up pinhole rig, with noise, one view for every record."""
    capture, random = captures[0], np.random.default_rng(0)
    width, height = capture.image_size
    focal, centre = _FOCAL * width, np.array([width - 1, height - 1]) / 2
    points = board.corners()
    middle, size = points.mean(0), float(np.ptp(points[:, :2], axis=0).max())
    depth = max(focal * size / (_FILLED * min(width, height)), 4.0 * size)
    records = [(number, record) for number, one in enumerate(captures) for record in one.records]
    angle = np.array([record.angle or 0.0 for _, record in records])
    keys = [
        (number, record.placement) if record.placement is not None and record.angle is not None else (-1, index)
        for index, (number, record) in enumerate(records)
    ]
    names = {key: index for index, key in enumerate(dict.fromkeys(keys))}
    placement = np.array([names[key] for key in keys], np.int32)
    standing = [_pose(random, middle, depth) for _ in names]
    among = [float(np.mean(angle[placement == number])) for number in range(len(names))]
    poses = np.stack([_turned(capture, angle[i] - among[k], depth) @ standing[k] for i, k in enumerate(placement)])
    # The middle angle is where a board stands in front of the camera; at angle 0 it stands elsewhere.
    place = np.einsum("vij,cj->vci", poses[:, :3, :3], points) + poses[:, None, :3, 3]
    q = focal * place[..., :2] / np.maximum(place[..., 2:], 1e-3) + centre
    q = q + _NOISE_PX * random.standard_normal(q.shape)
    inside = ((q >= 0) & (q <= np.array([width, height]) - 1.0)).all(-1) & (place[..., 2] > 0.1 * depth)
    corners = BoardViews(
        q=q,
        sigma=np.full(q.shape[:2], _NOISE_PX),
        valid=inside,
        angle=angle,
        placement=placement,
        record=np.arange(len(records)),
    )
    lit = [(i, record.lasers[0]) for i, (_, record) in enumerate(records) if stripes and record.on and record.lasers]
    lines = [_stripe(capture, board, poses[i], (laser, depth), random) for i, laser in lit]
    kept = [k for k, (_, valid) in enumerate(lines) if valid.sum() >= _LEAST_POINTS]
    seen = StripeViews(
        q=np.array([lines[k][0] for k in kept]).reshape(len(kept), _POINTS, 2),
        sigma=np.full((len(kept), _POINTS), _NOISE_PX),
        valid=np.array([lines[k][1] for k in kept], bool).reshape(len(kept), _POINTS),
        view=np.array([lit[k][0] for k in kept], np.int32),
        laser=np.array([lit[k][1] for k in kept], np.int32),
        contrast=np.tile(np.arange(_POINTS) % 3, (len(kept), 1)).astype(np.int8),
    )
    names_of_lasers = tuple(line.name for line in capture.lasers)
    return Observations(
        board, corners, seen, width, height, names_of_lasers, capture.up, carries=capture.carries or "scanner"
    )


def _pose(random: np.random.Generator, middle: np.ndarray, depth: float) -> np.ndarray:
    """T_cam_board of a tilted board in front of the camera."""
    a, b, c = random.uniform(-_TILT_RAD, _TILT_RAD, 3)
    pose = np.asarray(exponential(np.array([0.0, 0.0, 0.0, a, b, c])))
    shift = 0.1 * depth * random.uniform(-1.0, 1.0, 3) + np.array([0.0, 0.0, depth])
    pose[:3, 3] = shift - pose[:3, :3] @ middle
    return pose


def _turned(capture: Capture, angle: float, depth: float) -> np.ndarray:
    """T_cam(angle)_cam(0) of a made-up table."""
    turn = np.eye(4)
    if capture.carries == "nothing" or angle == 0.0:
        return turn
    by_object = capture.carries == "object"
    point = np.array([0.0, 0.0, depth if by_object else -0.1])
    axis = Turntable.from_axis(UP_VECTORS[capture.up], point, carries="object" if by_object else "scanner")
    # The camera that turns to the left sees the board turn to the right.
    return np.asarray(exponential((angle if by_object else -angle) * axis.twist()))


def _stripe(
    capture: Capture, board: AbstractBoard, pose: np.ndarray, laser: tuple[int, float], random: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Points [points, 2] of a sheet on a board, and whether they are there [points]."""
    number, depth = laser
    width, height = capture.image_size
    rows = capture.lasers[number].stripe_axis == "rows"
    # A sheet from beside the camera that crosses the optical axis near the boards.
    normal = np.array([1.0, 0.0, -0.3]) if rows else np.array([0.0, 1.0, -0.3])
    level = -0.3 * depth * (1.0 + 0.2 * number)
    along, across = pose[:3, :2].T @ normal, level - normal @ pose[:3, 3]
    q, valid = np.zeros((_POINTS, 2)), np.zeros(_POINTS, bool)
    middle, reach = board.outline().mean(0), np.ptp(board.outline(), axis=0).max() / 2
    length = float(np.linalg.norm(along))
    if length < 1e-6:
        return q, valid
    start = middle + along * (across - along @ middle) / length**2
    ends = start + np.outer([-reach, reach], [-along[1], along[0]]) / length
    if np.abs(start - middle).max() > 0.8 * reach:
        return q, valid
    place = ends @ pose[:3, :2].T + pose[:3, 3]
    seen = _FOCAL * width * place[:, :2] / np.maximum(place[:, 2:], 1e-3) + (np.array([width, height]) - 1.0) / 2
    u, v = seen.T if rows else seen[:, ::-1].T
    order = np.argsort(v)
    lines = np.arange(max(0, np.ceil(v.min())), min(height if rows else width, np.floor(v.max())))
    lines = lines[np.linspace(0, len(lines) - 1, min(len(lines), _POINTS)).round().astype(int)] if len(lines) else lines
    at = np.interp(lines, v[order], u[order]) + _NOISE_PX * random.standard_normal(len(lines))
    q[: len(lines)] = np.stack([at, lines] if rows else [lines, at], -1)
    inside = (q >= 0) & (q <= np.array([width, height]) - 1.0)
    valid[: len(lines)] = inside[: len(lines)].all(-1)
    return q, valid
