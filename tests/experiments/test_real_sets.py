"""The comparison on strangers' captures: its converter, its plain method, and the figures that it reads of jaxscan."""

import subprocess

import numpy as np
import pytest

from experiments.plain import (
    Lens,
    Plane,
    angle_deg,
    board_plane,
    calibrate,
    centres,
    consensus,
    grid,
    pose_of,
    straight_line,
)
from experiments.real_sets.sets import BY_NAME, Source


def test_pictures_of_a_folder_and_of_its_git_snapshot_are_the_same(tmp_path):
    work = tmp_path / "work"
    (work / "images").mkdir(parents=True)
    for k in (10, 9, 1):
        (work / "images" / f"{k}_right.jpg").write_bytes(bytes([k]))
    git = ["git", "-c", "user.name=a", "-c", "user.email=a@b", "-C", str(work)]
    subprocess.run([*git, "init", "-q"], check=True)
    subprocess.run([*git, "add", "-A"], check=True)
    subprocess.run([*git, "commit", "-qm", "pictures"], check=True)
    folder, snapshot = Source(work), Source(work / ".git")
    records = BY_NAME["hjamal"].records(folder)
    assert [one["on"] for one in records] == [f"images/{k}_right.jpg" for k in (1, 9, 10)]
    assert records == BY_NAME["hjamal"].records(snapshot)
    assert snapshot.read("images/9_right.jpg") == folder.read("images/9_right.jpg") == bytes([9])


LENS = Lens(np.array([[800.0, 0.0, 320.0], [0.0, 800.0, 240.0], [0.0, 0.0, 1.0]]), np.array([0.1, -0.2, 0.0, 0.0, 0.0]))
BOARD = {"type": "chessboard", "columns": 8, "rows": 6, "square_mm": 40.0}
POSES = [
    np.array([0.4 * np.cos(k), 0.4 * np.sin(k), 0.1 * k, -0.15 + 0.01 * k, -0.1, 0.8 + 0.03 * k]) for k in range(8)
]


def test_the_plain_camera_and_pose_are_those_of_perfect_corners():
    points = grid(BOARD)
    views = [LENS.project(points, pose) for pose in POSES]
    lens, shape = calibrate(views, points, (640, 480), "flat")
    np.testing.assert_array_equal(shape, points)
    # Single precision inside OpenCV.
    np.testing.assert_allclose(lens.matrix, LENS.matrix, atol=0.05)
    np.testing.assert_allclose(pose_of(LENS, points, views[3]), POSES[3], atol=1e-7)


def test_the_plain_centroid_and_line_ignore_a_brighter_spot():
    rows, columns = np.mgrid[:200, :300]
    light = 80.0 * np.exp(-0.5 * ((columns - 100.3 - 0.2 * rows) / 1.5) ** 2)
    light += 200.0 * np.exp(-0.5 * (((columns - 250) / 2) ** 2 + ((rows - 60) / 5) ** 2))
    q = centres(light.astype(np.float32), "rows")
    assert len(q) == 200
    kept = q[straight_line(q, LENS)]
    assert not ((kept[:, 1] > 50) & (kept[:, 1] < 70) & (kept[:, 0] > 200)).any()
    # Half of the peak and more is a symmetric window up to a pixel's rounding.
    assert np.abs(kept[:, 0] - 100.3 - 0.2 * kept[:, 1]).max() < 0.2
    assert len(kept) > 150


def test_the_plain_sheet_is_that_of_most_views():
    sheet = Plane(np.array([0.9, -0.1, np.sqrt(0.18)]), 0.3)
    other = Plane(np.array([0.0, 0.6, 0.8]), 0.6)
    lines = []
    for k, pose in enumerate(POSES):
        board = board_plane(pose)
        along = np.cross(board.normal, (other if k in (1, 4) else sheet).normal)
        both = np.stack([board.normal, (other if k in (1, 4) else sheet).normal, along])
        start = np.linalg.solve(both, [board.distance, (other if k in (1, 4) else sheet).distance, 0.0])
        lines.append(start + np.linspace(-0.1, 0.1, 60)[:, None] * along)
    found, agree = consensus(lines)
    assert list(np.flatnonzero(~agree)) == [1, 4]
    assert angle_deg(found.normal, sheet.normal) < 1e-6
    assert found.distance == pytest.approx(sheet.distance, abs=1e-9)
