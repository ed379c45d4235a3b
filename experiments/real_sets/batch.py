"""Captures of other makers as one project: begun, made, made again, and with another setting.

    python -m experiments.real_sets.batch DESK LINES FOLDER

DESK and LINES are copies of the repositories of `srv_toy` and `zhaocongyang` (see `sets`), or bare git snapshots of
them; FOLDER is new. The desk scanner is calibrated by its boards and the markers on its table; its two sweeps follow.
The pairs of the fixed light plane are boards and, once more, the profiles of a scanner that stands still. All is done
by the verbs of `jaxscan`, some minutes on two cores; the figures are printed.
"""

import json
import re
import tomllib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tomli_w

import jaxscan
from experiments.plain import Lens, grid, pose_of, spread
from experiments.real_sets.measure import (
    Pictures,
    TableFrame,
    points_of,
    read_solved,
    table_figures,
    table_from,
    write_rig,
)
from experiments.real_sets.sets import BY_NAME, Source, convert
from experiments.report import command_line, verb


COVERED_M = {"table": 0.0, "toy": BY_NAME["srv_toy"].inner_m}
BOX_M = 0.09
"""The box under the toy is nearer to the axis."""
NEAR_BOARD_M = 0.005
"""Points farther from a board are of things behind it."""


def run(*words: str | Path) -> None:
    """One verb of `jaxscan`, its output, and how long it took; its failure is no end, for batches fail in part."""
    ran = verb(*words)
    print(f"jaxscan {' '.join(map(str, words[:2]))}: exit code {ran.code}, {ran.wall_s:.0f} s")
    lines = (ran.out + ran.problem).splitlines()
    print("\n".join(line for line in lines if not line.startswith("note: ")), flush=True)


def capture(name: str, source: Source, folder: Path, **header: Any) -> Path:
    """A capture of a set, with more in its header; tables that are None are left out."""
    convert(BY_NAME[name], source, folder)
    path = folder / "capture.toml"
    tables = tomllib.loads(path.read_text()) | header
    path.write_text(tomli_w.dumps({key: value for key, value in tables.items() if value is not None}))
    return folder


def calibrate_desk(folder: Path) -> TableFrame:
    """The rig of the desk scanner: camera and sheet by its boards, the axis by the markers on the table.

    The markers give the place of the axis in their own scale, and need not be as large as their authors say: the
    table on which they lie is where the laser sees it.
    """
    boards, sweep = folder / "captures" / "boards", folder / "captures" / "table"
    first = folder.with_name(f"{folder.name}.first.json")
    run("calibrate", boards, "-o", first)
    solved = read_solved(first, Pictures(boards))
    table = table_from(sweep, solved.lens)
    by_hand, cloud = first.with_suffix(".hand.json"), first.with_suffix(".ply")
    write_rig(by_hand, Pictures(sweep).size, solved.lens, solved.sheets[0], table)
    run("reconstruct", sweep, "-c", by_hand, "-o", cloud, "--max-range", "2", "--no-cache")
    frame = TableFrame(table)
    seen = table_figures(points_of(cloud), frame.height, frame.normal, 0.0)
    scale = 1.0 - 1e-3 * seen["height_mm"] / abs(table.plane.distance)
    print(f"the table is {seen['height_mm']:.2f} mm above its markers, whose scale is thus {scale:.4f}")
    table = table._replace(
        point=scale * table.point, plane=table.plane._replace(distance=float(scale * table.plane.distance))
    )
    axis = [f"{value:.6f}" for value in (*table.point, *table.direction)]
    (folder / "calibrations").mkdir()
    run("calibrate", boards, "-o", folder / "calibrations" / "desk.json", "--axis", *axis)
    return TableFrame(table)


def boards_figures(cloud_path: Path, calibration: Path, folder: Path) -> dict[str, float]:
    """Distances of profiles from the boards that they are on, whose poses are found by OpenCV, along the ray."""
    cloud, pictures = jaxscan.load_cloud(cloud_path), Pictures(folder)
    xyz, valid, sigma = (np.asarray(one) for one in (cloud.xyz, cloud.valid, cloud.sigma_random))
    camera = json.loads(calibration.read_text())["camera"]
    matrix = np.array([[camera["fx"], 0, camera["cx"]], [0, camera["fy"], camera["cy"]], [0, 0, 1.0]])
    lens = Lens(matrix, np.array([camera["distortion"].get(key, 0.0) for key in ("k1", "k2", "p1", "p2", "k3")]))
    board = pictures.header["board"]
    corners, off, scaled = grid(board), [], []
    for k, profile in enumerate(xyz):
        picture = cv2.imread(str(folder / "off" / f"{k:06d}.jpg"), cv2.IMREAD_GRAYSCALE)
        seen, q = cv2.findCirclesGrid(picture, (board["columns"], board["rows"]))
        if not seen:
            continue
        pose = pose_of(lens, corners, q.reshape(-1, 2))
        turn = cv2.Rodrigues(pose[:3])[0]
        points, own = profile[valid[k]].astype(np.float64), sigma[k][valid[k]]
        local = (points - pose[3:]) @ turn
        inside = (local[:, :2] > corners.min(0)[:2]) & (local[:, :2] < corners.max(0)[:2])
        on = inside.all(1) & (np.abs(local[:, 2]) < NEAR_BOARD_M)
        ray = points[on] / np.linalg.norm(points[on], axis=1)[:, None]
        along = local[on, 2] / np.abs(ray @ turn[:, 2])
        off.append(along - np.median(along))
        scaled.append(off[-1] / own[on])
    return {
        "boards": len(off),
        "points": int(sum(map(len, off))),
        "spread_mm": 1e3 * spread(np.concatenate(off)),
        "spread_over_sigma": spread(np.concatenate(scaled)),
    }


def box_figures(xyz: np.ndarray, height: float) -> list[tuple[float, float, float]]:
    """The upright faces of the box under the toy: angle [deg], distance from the axis and spread about it [mm]."""
    random = np.random.default_rng(0)
    above, radius = xyz[:, 2] - height, np.hypot(xyz[:, 0], xyz[:, 1])
    left, found = xyz[(radius < BOX_M) & (above > 0.015) & (above < 0.04)][:, :2], []
    for _ in range(4):
        pairs = random.integers(len(left), size=(300, 2))
        along = left[pairs[:, 1]] - left[pairs[:, 0]]
        normals = np.stack([-along[:, 1], along[:, 0]], 1) / np.maximum(np.linalg.norm(along, axis=1), 1e-9)[:, None]
        counts = [
            int((np.abs((left - left[one]) @ normal) < 0.0015).sum()) * (np.linalg.norm(way) > 0.02)
            for (one, _), normal, way in zip(pairs, normals, along, strict=True)
        ]
        best = int(np.argmax(counts))
        near = left[np.abs((left - left[pairs[best, 0]]) @ normals[best]) < 0.0015]
        normal = np.linalg.svd(near - near.mean(0), full_matrices=False)[2][1]
        off = (left - near.mean(0)) @ normal
        face = np.abs(off) < 0.004
        angle = float(np.degrees(np.arctan2(normal[1], normal[0])) % 180.0)
        found.append((angle, 1e3 * abs(float(near.mean(0) @ normal)), 1e3 * spread(off[face])))
        left = left[~face]
    return found


def figures(folder: Path, frame: TableFrame) -> None:
    """Prints how flat the flat things in the clouds are."""
    products = folder / "products"
    for name, inner in COVERED_M.items():
        cloud = products / "clouds" / f"{name}.ply"
        if cloud.exists():
            xyz = points_of(cloud)
            print(name, json.dumps(table_figures(xyz, frame.height, frame.normal, inner)))
            faces = box_figures(xyz, frame.height) if inner else []
            for angle, away, scatter in faces:
                print(f"face of the box: at {angle:.1f} degrees, {away:.1f} mm from the axis, spread {scatter:.2f} mm")
    cloud, calibrations = products / "clouds" / "profiles.ply", list((products / "calibrations").glob("*.json"))
    if cloud.exists() and calibrations:
        found = boards_figures(cloud, calibrations[0], folder / "captures" / "pairs")
        print("profiles", json.dumps(found), flush=True)


def main() -> int:
    """Lay out the folder, and go through a project's life."""
    parser = command_line(__doc__)
    for name in ("desk", "lines", "folder"):
        parser.add_argument(name, type=Path)
    options = parser.parse_args()
    desk, lines, folder = Source(options.desk), Source(options.lines), options.folder.resolve()
    captures, turning = folder / "captures", {"carries": "object"}
    capture("srv_laser_1707", desk, captures / "boards", turntable=turning)
    capture("srv_table", desk, captures / "table")
    capture("srv_toy", desk, captures / "toy")
    still = {"carries": "nothing"}
    capture("zhaocongyang", lines, captures / "pairs", turntable=still)
    capture("zhaocongyang", lines, captures / "profiles", kind="sweep", turntable=still, board=None)
    frame = calibrate_desk(folder)
    run("project", "init", folder)
    project = folder / "project.toml"
    # All of them for all captures: what cannot be made is left out.
    text = re.sub(r'(rig = ".*"\n)products = .*\n', r"\1", project.read_text())
    text = text.replace('"measures"]', '"measures", "mesh", "report"]')
    project.write_text(text.replace('formats = ["ply"]', 'formats = ["ply", "e57", "laz", "xyz"]'))
    print(project.read_text())
    run("batch", project, "--workers", "2")
    figures(folder, frame)
    run("batch", project, "--workers", "2")
    # The wall behind the table does not turn with it, and would be a ring around the axis.
    text = project.read_text()
    own = 'toy"\nrig = "rig-2"\n'
    assert own in text
    project.write_text(text.replace(own, own + "settings = { max_range_m = 0.5 }\n"))
    run("project", "status", project)
    run("batch", project, "--workers", "2")
    figures(folder, frame)
    run("project", "compare", project, project)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
