"""Poses of a hand as robots and trackers write them: one line of numbers each."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from jaxscan.geometry import exponential, from_quaternion, is_pose, nearest_rotation, rigid
from jaxscan.geometry.motion_kinds import PoseFormat, PoseUnit


_ROUNDED = 0.01
"""Numbers of three digits make rotations and quaternions that are off by this."""


class _Layout(NamedTuple):
    """What the numbers of a line are."""

    counts: tuple[int, ...]
    numbers: str
    read: Callable[[np.ndarray], np.ndarray]
    """A matrix of rotation and place, 3 x 4, not checked."""


def _of_quaternion(numbers: np.ndarray) -> np.ndarray:
    """From x y z and a quaternion, w first."""
    length = np.linalg.norm(numbers[3:])
    # A quaternion of another length makes no rotation, and is refused with those.
    turn = from_quaternion(numbers[3:]) if length > 0 else np.zeros((3, 3))
    return np.column_stack([turn if abs(length - 1) < _ROUNDED else length * turn, numbers[:3]])


def _of_matrix(numbers: np.ndarray) -> np.ndarray:
    matrix = numbers.reshape(-1, 4)
    if len(matrix) == 3:
        return matrix
    ends = lambda rows: np.abs(rows[3] - [0.0, 0.0, 0.0, 1.0]).max() < _ROUNDED
    # Some programs write column after column: the zeros tell, but for a pose without a translation.
    rows = matrix if ends(matrix) else matrix.T
    return rows[:3] if ends(rows) else np.zeros((3, 4))


def _of_vector(numbers: np.ndarray) -> np.ndarray:
    turn = exponential(np.concatenate([np.zeros(3), numbers[3:]]))[:3, :3]
    return np.column_stack([turn, numbers[:3]])


def _of_angles(numbers: np.ndarray, unit: float = np.radians(1.0)) -> np.ndarray:
    """From x y z and angles about the fixed axes x, then y, then z."""
    x, y, z = exponential(np.pad(np.diag(unit * numbers[3:]), ((0, 0), (3, 0))))[:, :3, :3]
    return np.column_stack([z @ y @ x, numbers[:3]])


_LAYOUTS: dict[str, _Layout] = {
    # The time before them says nothing here.
    "tum": _Layout((7, 8), "[time] x y z qx qy qz qw", lambda n: _of_quaternion(n[-7:][[0, 1, 2, 6, 3, 4, 5]])),
    "wxyz": _Layout((7,), "x y z qw qx qy qz", _of_quaternion),
    "matrix": _Layout(
        (12, 16), "the rows of a 3 x 4 or 4 x 4 matrix, one after another (or the columns of a 4 x 4 one)", _of_matrix
    ),
    "rotvec": _Layout((6,), "x y z and a rotation vector in radians", _of_vector),
    "rpy": _Layout((6,), "x y z and degrees about the fixed axes x, then y, then z", _of_angles),
    "rpy-rad": _Layout((6,), "x y z and radians about the fixed axes x, then y, then z", lambda n: _of_angles(n, 1.0)),
    "abc": _Layout(
        (6,), "x y z and degrees about z, then the new y, then the new x", lambda n: _of_angles(n[[0, 1, 2, 5, 4, 3]])
    ),
}
_BY_COUNT: dict[int, PoseFormat] = {8: "tum", 12: "matrix", 16: "matrix"}
"""Counts of numbers that tell the format. Seven are a quaternion with w last or first, six have angles of any kind."""


def read_pose(words: Sequence[str], pose_format: PoseFormat | None, unit: PoseUnit) -> tuple[float, ...]:
    """The pose of one line.

    Args:
        words: Its numbers.
        pose_format: Their meaning; None: by their count, where that tells it.
        unit: Unit of lengths.

    Returns:
        T_base_hand: Twelve numbers, row after row [m].

    Raises:
        ValueError: If they are no pose, with the expectation.
    """
    chosen = pose_format or _BY_COUNT.get(len(words))
    if chosen is None:
        fitting = [f"{name} ({one.numbers})" for name, one in _LAYOUTS.items() if len(words) in one.counts]
        raise ValueError(
            f"expected one of --pose-format {', '.join(fitting)}"
            if fitting
            else "expected the 8 numbers of TUM, 12 or 16 of a matrix, or 6 or 7 with --pose-format"
        )
    layout = _LAYOUTS[chosen]
    try:
        numbers = np.array([float(word) for word in words])
    except ValueError:
        numbers = np.zeros(0)
    if len(numbers) not in layout.counts or not np.isfinite(numbers).all():
        counts = " or ".join(map(str, layout.counts))
        raise ValueError(f"expected {counts} numbers, {layout.numbers} (--pose-format {chosen})")
    pose = layout.read(np.clip(numbers, -1e12, 1e12))
    turn, place = pose[:, :3], pose[:, 3] / (1000.0 if unit == "mm" else 1.0)
    proper = np.abs(turn @ turn.T - np.eye(3)).max() < _ROUNDED and np.linalg.det(turn) > 0
    found = np.asarray(rigid(nearest_rotation(turn), place)) if proper else np.zeros((4, 4))
    if not is_pose(found):
        raise ValueError(
            f"found no rigid motion of less than 10 km, expected {layout.numbers} (--pose-format {chosen})"
        )
    return tuple(found[:3].ravel().tolist())


def describe_poses(poses: Sequence[tuple[float, ...]], unit: PoseUnit) -> str:
    """How far they go, so that a wrong unit shows."""
    given = np.reshape(poses, (-1, 3, 4))
    far = float(np.linalg.norm(np.ptp(given[:, :, 3], axis=0)))
    cosine = (np.trace(given[0, :, :3].T @ given[:, :, :3], axis1=1, axis2=2) - 1) / 2
    turned = float(np.degrees(np.arccos(np.clip(cosine, -1, 1))).max())
    doubt = "; if that is too far by a thousand: --pose-unit mm" if unit == "m" and far > 10 else ""
    return f"within a box of {far:.4g} m, turned by up to {turned:.3g} degrees{doubt}"
