"""Poses as robots and trackers write them: each notation against SciPy's rotations, and lines that are none."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxscan.files.importing.plan import read_pose


TURN = Rotation.from_euler("ZYX", [110.0, -35.0, 20.0], degrees=True)
PLACE = [0.4, -0.7, 1.25]
X, Y, Z, W = TURN.as_quat()
ROWS = np.column_stack([TURN.as_matrix(), PLACE])
WRITTEN = {
    "tum": [1305031102.1753, *PLACE, X, Y, Z, W],
    "wxyz": [*PLACE, W, X, Y, Z],
    "matrix": [*ROWS.ravel(), 0, 0, 0, 1],
    "rotvec": [*PLACE, *TURN.as_rotvec()],
    "rpy": [*PLACE, 20.0, -35.0, 110.0],
    "rpy-rad": [*PLACE, *np.radians([20.0, -35.0, 110.0])],
    "abc": [*PLACE, 110.0, -35.0, 20.0],
}


BY_COLUMNS = np.reshape(WRITTEN["matrix"], (4, 4)).T.ravel()


def words(numbers):
    return [f"{number:.10g}" for number in numbers]


@pytest.mark.parametrize("notation", WRITTEN)
def test_every_notation(notation):
    found = np.reshape(read_pose(words(WRITTEN[notation]), notation, "m"), (3, 4))
    np.testing.assert_allclose(found, ROWS, atol=1e-8)


def test_counts_that_tell_the_notation():
    for numbers in (WRITTEN["tum"], WRITTEN["matrix"], WRITTEN["matrix"][:12], BY_COLUMNS):
        np.testing.assert_allclose(np.reshape(read_pose(words(numbers), None, "m"), (3, 4)), ROWS, atol=1e-8)
    # A quaternion and its opposite are one rotation, and lengths may be millimetres.
    numbers = [*(1000 * np.array(PLACE)), -X, -Y, -Z, -W]
    np.testing.assert_allclose(np.reshape(read_pose(words(numbers), "tum", "mm"), (3, 4)), ROWS, atol=1e-8)


def test_three_digits_make_a_rotation():
    found = np.reshape(read_pose([f"{number:.3f}" for number in ROWS.ravel()], None, "m"), (3, 4))
    np.testing.assert_allclose(found, ROWS, atol=2e-3)
    np.testing.assert_allclose(found[:, :3] @ found[:, :3].T, np.eye(3), atol=1e-12)


MIRRORED = np.column_stack([TURN.as_matrix() * [1, 1, -1], PLACE]).ravel()


@pytest.mark.parametrize(
    ("numbers", "notation", "said"),
    [
        (WRITTEN["rpy"], None, "rotvec .*rpy .*rpy-rad .*abc"),
        (WRITTEN["wxyz"], None, "tum .*wxyz"),
        (PLACE, None, "expected the 8 numbers of TUM"),
        (WRITTEN["rpy"], "matrix", "expected 12 or 16 numbers"),
        ([*PLACE, 0, 0, 0, 0], "tum", "no rigid motion"),
        ([*PLACE, 0, 0, 0, 2], "tum", "no rigid motion"),
        (MIRRORED, None, "no rigid motion"),
        ([*PLACE[:2], np.nan, 0, 0, 0], "rpy", "expected 6 numbers"),
        ([*PLACE[:2], np.inf, 0, 0, 0], "rpy", "expected 6 numbers"),
        ([*PLACE[:2], 1e300, 0, 0, 1e300], "rotvec", "no rigid motion of less than 10 km"),
        ([1e5, 0, 0, 0, 0, 0], "rpy", "no rigid motion of less than 10 km"),
    ],
)
def test_lines_that_are_no_poses(numbers, notation, said):
    with pytest.raises(ValueError, match=said):
        read_pose(words(numbers), notation, "m")


@pytest.mark.parametrize("line", ["a b c d e f", "1 2 3 4 5 -", "1_0 ' ' x 0 0 0"])
def test_words_that_are_no_numbers(line):
    with pytest.raises(ValueError, match="expected 6 numbers"):
        read_pose(line.split()[:6], "rpy", "m")
