"""Figures of a calibration and of a cloud, the same for every method: by the command line, and by the plain one."""

import dataclasses
import json
import time
import tomllib
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from scipy.optimize import least_squares  # type: ignore[import-untyped]

import jaxscan
from experiments.plain import (
    Lens,
    Plane,
    angle_deg,
    board_plane,
    calibrate,
    centres,
    consensus,
    find,
    grid,
    held_out,
    plane_of,
    pose_of,
    residuals,
    signal,
    spread,
    straight_line,
)
from experiments.report import rms, verb
from jaxscan.calibration import calibrate_camera
from jaxscan.observation import Observations


RIM = 0.115
"""Radius of the table that counts [m]."""
NEAR_TABLE = 0.015
"""The table's surface is looked for so near to its markers [m]: the camera was moved between calibration and sweep."""
ON_TABLE = 0.006
"""A point so near to the surface is on the table [m]."""
ON_BED = 0.001
"""A point so near to the bed of a printer is on it [m]."""
ABOVE = 0.2
"""Height of the part of the scene that counts [m]."""


class BoardLine(NamedTuple):
    """The line on one board: pixels [n, 2], row of the view, number of the laser."""

    q: np.ndarray
    view: int
    laser: int


class Solved(NamedTuple):
    """The result of one method for a capture of boards."""

    lens: Lens
    shape: np.ndarray
    """Corners of the board as the method takes them [n, 3]; m."""
    corners: list[np.ndarray]
    """Corners of each view [n, 2]; px, not finite where not found."""
    lines: list[BoardLine]
    sheets: list[Plane]


def board_figures(solved: Solved, halves: list[Solved] | None) -> dict[str, Any]:
    """Corners and lines against the calibration, and against the calibration of the other half of the views.

    Args:
        halves: From the even and from the odd views, or None. Only their lens, shape and sheets are used.
    """
    own = [_residual(solved.lens, solved.shape, q) for q in solved.corners]
    matrix = solved.lens.matrix
    found: dict[str, Any] = {
        "views": len(solved.corners),
        "f_px": [float(matrix[0, 0]), float(matrix[1, 1])],
        "corner_rms_px": rms(np.concatenate(own)),
        "shape_mm": _off_plane(solved.shape),
    }
    if halves is not None:
        other = [_residual(halves[1 - k % 2].lens, halves[1 - k % 2].shape, q) for k, q in enumerate(solved.corners)]
        found["held_out_px"] = rms(np.concatenate(other))
    found["sheets"] = [_sheet_figures(solved, halves, laser) for laser in range(len(solved.sheets))]
    return found


def _residual(lens: Lens, shape: np.ndarray, q: np.ndarray) -> np.ndarray:
    seen = np.isfinite(q).all(1)
    return residuals(lens, shape[seen], [q[seen]])[0]


def _off_plane(shape: np.ndarray) -> float:
    """RMS of the board's corners from their best plane; mm."""
    return 1e3 * rms(plane_of(shape).off(shape))


def _sheet_figures(solved: Solved, halves: list[Solved] | None, laser: int) -> dict[str, Any]:
    sheet, lines = solved.sheets[laser], [line for line in solved.lines if line.laser == laser and len(line.q)]
    off, beyond = [], []
    for line in lines:
        off.append(sheet.off(_lift(solved.lens, solved.shape, solved.corners[line.view], line)))
        other = None if halves is None else halves[1 - line.view % 2]
        if other is not None and laser < len(other.sheets):
            points = _lift(other.lens, other.shape, solved.corners[line.view], line)
            beyond.append(other.sheets[laser].off(points))
    found: dict[str, Any] = {
        "normal": [float(x) for x in sheet.normal],
        "distance_mm": 1e3 * float(sheet.distance),
        "lines": len(lines),
        "points": int(sum(len(line.q) for line in lines)),
        "spread_mm": 1e3 * around_zero(np.concatenate(off)) if off else None,
    }
    if beyond:
        found["held_out_mm"] = 1e3 * around_zero(np.concatenate(beyond))
        found["halves_deg"] = angle_deg(*(half.sheets[laser].normal for half in halves or ()))
    return found


def around_zero(distances: np.ndarray) -> float:
    """1.4826 times the median of the sizes: a standard deviation, whatever a few points do."""
    return float(1.4826 * np.median(np.abs(distances)))


def _lift(lens: Lens, shape: np.ndarray, q: np.ndarray, line: BoardLine) -> np.ndarray:
    """Points [n, 3] of a line on its board; m. The board's best plane is used, its shape only for the pose."""
    seen = np.isfinite(q).all(1)
    pose = pose_of(lens, shape[seen], q[seen])
    rotation, flat = cv2.Rodrigues(pose[:3])[0], plane_of(shape)
    normal = rotation @ flat.normal
    plane = Plane(normal, float(normal @ (rotation @ shape.mean(0) + pose[3:])))
    return plane.meet(lens.straight(line.q))


def table_figures(xyz: np.ndarray, height: float, normal: np.ndarray, inner: float) -> dict[str, Any]:
    """Points of a sweep of the turntable: all of the scene, and those on the table's surface.

    Args:
        xyz: Points [n, 3] in the table's coordinates: origin on the axis, z along it, up; m.
        height: Height of the markers above the origin [m].
        normal: Normal of the plane of the markers [3].
        inner: Radius of the part of the table that is covered [m].
    """
    above, radius = xyz[:, 2] - height, np.hypot(xyz[:, 0], xyz[:, 1])
    scene = (radius < RIM + 0.01) & (above > -NEAR_TABLE) & (above < ABOVE)
    rim = xyz[(radius >= inner) & (radius < RIM) & (np.abs(above) < NEAR_TABLE)]
    found: dict[str, Any] = {"points": len(xyz), "scene": int(scene.sum()), "on_table": 0}
    if len(rim) < 50:
        return found
    # The height that most points share.
    heights = np.sort(rim[:, 2])
    counts = np.searchsorted(heights, heights + 0.002) - np.arange(len(heights))
    surface = Plane(np.array([0.0, 0.0, 1.0]), float(heights[counts.argmax()] + 0.001))
    for _ in range(5):
        on = np.abs(surface.off(rim)) < ON_TABLE
        surface = plane_of(rim[on])
    off = surface.off(rim[on])
    return found | {
        "on_table": int(on.sum()),
        "spread_mm": 1e3 * spread(off),
        "rms_mm": 1e3 * rms(off),
        "tilt_deg": angle_deg(surface.normal, normal),
        "height_mm": 1e3 * (float(np.median(rim[on][:, 2])) - height),
    }


RADIUS = 0.09
"""Nominal distance of the markers' centres from the axis [m]."""
CENTRES = {5: (RADIUS, 0.0), 42: (-RADIUS, 0.0), 27: (0.0, RADIUS), 18: (0.0, -RADIUS)}
SIDE = 0.03
"""Side of a marker [m]."""


class Table(NamedTuple):
    """A turntable in the coordinates of the camera, which stands still."""

    direction: np.ndarray
    """Direction of the axis, from the table's plane towards the camera's side."""
    point: np.ndarray
    """Where the axis meets the table's plane [m]."""
    plane: Plane
    """The table's surface."""


def markers(grey: np.ndarray) -> np.ndarray | None:
    """The 16 corners [16, 2] of the four markers in the order of `CENTRES`, or None."""
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50), settings)
    found, names, _ = detector.detectMarkers(grey)
    seen = {} if names is None else {int(name): q.reshape(4, 2) for name, q in zip(names.ravel(), found, strict=True)}
    return np.concatenate([seen[name] for name in CENTRES]) if set(CENTRES) <= set(seen) else None


def fit_table(corners: np.ndarray, lens: Lens) -> Table:
    """The table from corners of markers at many steps.

    Args:
        corners: Corners of the markers [pictures, 16, 2]; px.
    """
    square = 0.5 * SIDE * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])
    nominal = np.concatenate([square + np.array([*centre, 0.0]) for centre in CENTRES.values()])
    poses = np.array([pose_of(lens, nominal, q) for q in corners])
    turns = np.array([cv2.Rodrigues(pose[:3])[0] for pose in poses])
    axis = turns[:, :, 2].mean(0)
    axis /= np.linalg.norm(axis)
    first = turns[0, :, 0] - axis * (axis @ turns[0, :, 0])
    angles = np.unwrap(np.arctan2(turns[:, :, 0] @ np.cross(axis, first), turns[:, :, 0] @ first))
    start = nominal @ turns[0].T + poses[0, 3:]
    one, two = np.linalg.svd(axis[None])[2][1:]

    def parts(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        direction = axis + x[0] * one + x[1] * two
        centre = poses[:, 3:].mean(0) + x[2] * one + x[3] * two
        return direction / np.linalg.norm(direction), centre, x[4:52].reshape(16, 3), np.concatenate([[0.0], x[52:]])

    def error(x: np.ndarray) -> np.ndarray:
        direction, centre, points, turned = parts(x)
        arms = points - centre
        along = np.outer(arms @ direction, direction)
        across, side = arms - along, np.cross(direction, arms)
        cosine, sine = np.cos(turned)[:, None, None], np.sin(turned)[:, None, None]
        moved = centre + along + cosine * across + sine * side
        seen = lens.project(moved.reshape(-1, 3), np.zeros(6)).reshape(corners.shape)
        # All lengths may grow together: the mean side is held.
        return np.append((seen - corners).ravel(), 1e6 * (_sides(points).mean() - SIDE))

    first_guess = np.concatenate([np.zeros(4), start.ravel(), angles[1:] - angles[0]])
    x = least_squares(error, first_guess, method="lm").x
    direction, centre, points, _ = parts(x)
    plane = plane_of(points)
    point = centre + direction * ((plane.distance - centre @ plane.normal) / (direction @ plane.normal))
    return Table(direction, point, plane)


def _sides(points: np.ndarray) -> np.ndarray:
    square = points.reshape(4, 4, 3)
    return np.linalg.norm(square - np.roll(square, 1, axis=1), axis=2)


class Pictures:
    """Header, records and pictures of a capture."""

    def __init__(self, folder: Path) -> None:
        """Read header and journal."""
        self.folder = folder
        self.header: dict[str, Any] = tomllib.loads((folder / "capture.toml").read_text())
        lines = (folder / "frames.jsonl").read_text().splitlines()
        self.records: list[dict[str, Any]] = [json.loads(line) for line in lines]
        camera = self.header["camera"]
        self.size = (int(camera["width"]), int(camera["height"]))

    @property
    def lasers(self) -> list[dict[str, Any]]:
        """The tables of the lasers."""
        return list(self.header.get("laser", []))

    def rgb(self, path: str) -> np.ndarray:
        """uint8 [rows, columns, 3]."""
        return cv2.cvtColor(cv2.imread(str(self.folder / path), cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)

    def grey(self, record: dict[str, Any]) -> np.ndarray:
        """The picture of a record that shows its board best: with the laser off, if there is one."""
        return cv2.imread(str(self.folder / (record["off"] or record["on"])), cv2.IMREAD_GRAYSCALE)


MARGIN = 0.9
"""How far the board is taken to reach beyond its outermost corners [squares]."""
LEAST_VIEWS = 10
"""With fewer views a free board is no longer determined."""
LEAST_LINE = 20
"""Points that make a line."""
EVERY = 12
"""Every so many steps of the sweep, the markers are looked for."""


class PlainBoards:
    """Corners and lines of a capture of boards, found once, and the solves of all or some of the views."""

    def __init__(self, pictures: Pictures, kind: str, known: Lens | None = None) -> None:
        """Find corners; `kind` is "flat" or "fisheye", and a known lens is not calibrated."""
        self.pictures, self.kind, self.points = pictures, kind, grid(pictures.header["board"])
        self.known = known
        board = pictures.header["board"]
        found = [(record, find(pictures.grey(record), board)) for record in pictures.records]
        self.records = [record for record, q in found if q is not None]
        self.corners = [q for _, q in found if q is not None]

    def solve(self, first: int = 0, every: int = 1, lines: list[BoardLine] | None = None) -> Solved:
        """From every so many views."""
        views = self.corners[first::every]
        lens, shape = self.known, self.points
        if lens is None:
            lens, shape = calibrate(views, self.points, self.pictures.size, self.kind)
        lines = self._lines(lens) if lines is None else lines
        sheets, agreeing = [], []
        for laser in range(len(self.pictures.lasers)):
            own = [line for line in lines if line.laser == laser and (line.view - first) % every == 0]
            lifted = [self._plane(lens, line.view).meet(lens.straight(line.q)) for line in own]
            if len(lifted) >= 2:
                sheet, agree = consensus(lifted)
                sheets.append(sheet)
                agreeing += [line for line, is_one in zip(own, agree, strict=True) if is_one]
        return Solved(lens, shape, self.corners, agreeing, sheets)

    def _plane(self, lens: Lens, view: int) -> Plane:
        return board_plane(pose_of(lens, self.points, self.corners[view]))

    def _lines(self, lens: Lens) -> list[BoardLine]:
        found = []
        names = [laser.get("name", "laser") for laser in self.pictures.lasers]
        for view, record in enumerate(self.records):
            if not names or record["on"] is None:
                continue
            for name in record.get("lasers", names):
                q = self._line(lens, view, self.pictures.lasers[names.index(name)])
                if len(q) >= LEAST_LINE:
                    found.append(BoardLine(q, view, names.index(name)))
        return found

    def _line(self, lens: Lens, view: int, laser: dict[str, Any]) -> np.ndarray:
        record, pitch = self.records[view], self.points[1, 0]
        low, high = self.points[:, :2].min(0) - MARGIN * pitch, self.points[:, :2].max(0) + MARGIN * pitch
        edge = np.array([[low[0], low[1], 0], [high[0], low[1], 0], [high[0], high[1], 0], [low[0], high[1], 0]])
        corners = lens.project(edge, pose_of(lens, self.points, self.corners[view])).round().astype(int)
        inside = cv2.fillConvexPoly(np.zeros(self.pictures.size[::-1], np.uint8), corners, 1) > 0
        light = _light(self.pictures, record, laser)
        q = centres(light, laser.get("stripe_axis", "rows"), inside)
        return q[straight_line(q, lens)]


def _light(pictures: Pictures, record: dict[str, Any], laser: dict[str, Any]) -> np.ndarray:
    off = None if record["off"] is None else pictures.rgb(record["off"])
    return signal(pictures.rgb(record["on"]), off, laser.get("colour", "red"))


def boards(pictures: Pictures, kind: str, known: Lens | None = None) -> tuple[dict[str, Any], Solved]:
    """Figures of the plain method on a capture of boards, and its calibration."""
    start = time.perf_counter()
    plain = PlainBoards(pictures, kind, known)
    whole = plain.solve()
    halves = [plain.solve(first, 2, whole.lines) for first in (0, 1)] if len(plain.corners) >= 6 else None
    figures = board_figures(whole, halves) | {"seconds": time.perf_counter() - start, "records": len(pictures.records)}
    if kind == "flat" and len(plain.corners) >= LEAST_VIEWS:
        figures["held_out_free_px"] = held_out(plain.corners, plain.points, pictures.size, "free")
        lens, shape = calibrate(plain.corners, plain.points, pictures.size, "free")
        free = board_figures(Solved(lens, shape, plain.corners, [], []), None)
        figures |= {"free_shape_mm": free["shape_mm"], "free_f_px": free["f_px"], "free_rms_px": free["corner_rms_px"]}
    return figures, whole


def table_from(folder: Path, lens: Lens) -> Table:
    """The turntable of a capture, by the markers on it, seen through a lens."""
    pictures = Pictures(folder)
    seen = [markers(pictures.grey(record)) for record in pictures.records[::EVERY]]
    return fit_table(np.array([q for q in seen if q is not None]), lens)


class TableFrame:
    """Coordinates fixed to the table as it stood at step 0: origin on the axis nearest the camera, z along it, up."""

    def __init__(self, table: Table) -> None:
        """From the axis in the camera's coordinates."""
        self.up = table.direction
        self.origin = table.point - self.up * (self.up @ table.point)
        x = np.array([0.0, 0.0, 1.0]) - self.up * self.up[2]
        x /= np.linalg.norm(x)
        self.rotation = np.stack([x, np.cross(self.up, x), self.up])
        self.height = float(self.up @ table.point)
        self.normal = self.rotation @ table.plane.normal

    def bring(self, points: np.ndarray, turned: float) -> np.ndarray:
        """Points [n, 3] in the camera's coordinates, seen while the table was turned by this angle [rad]."""
        x, y, z = self.rotation @ (points - self.origin).T
        cosine, sine = np.cos(turned), np.sin(turned)
        return np.stack([cosine * x + sine * y, cosine * y - sine * x, z], axis=1)


def sweep(pictures: Pictures, lens: Lens, sheet: Plane, table: Table, inner: float) -> dict[str, Any]:
    """Figures of the plain method on a sweep; `inner` is the radius of the part of the table that is covered [m]."""
    start, frame, laser = time.perf_counter(), TableFrame(table), pictures.lasers[0]
    points = []
    for record in pictures.records:
        light = _light(pictures, record, laser)
        q = centres(light, laser.get("stripe_axis", "rows"))
        # A user does not know the table's own step: the nominal angle is used, by every method.
        points.append(frame.bring(sheet.meet(lens.straight(q)), np.radians(record["angle_deg"])))
    figures = table_figures(np.concatenate(points), frame.height, frame.normal, inner)
    return figures | {"seconds": time.perf_counter() - start, "records": len(pictures.records)}


RADIAL_TANGENTIAL = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
"""OpenCV's order of the coefficients."""


def calibrate_by_verb(capture: Path, output: Path, options: tuple[str, ...]) -> dict[str, Any]:
    """One run of `jaxscan calibrate`: the first sentence that its user reads, and figures if it wrote a calibration."""
    for old in output.parent.glob(f"{output.stem}.*"):
        old.unlink()
    summary = output.with_suffix(".summary")
    ran = verb("calibrate", capture, "-o", output, "--json", summary, *options)
    short = lambda text: text.replace(str(capture), capture.name).replace(str(output), output.name)
    plan = [line for line in ran.out.splitlines() if line.startswith("solving for ")]
    summary_of = json.loads(summary.read_text()) if summary.exists() else {}
    verdict = summary_of.get("verdict", {})
    sentence = f"{verdict['headline']}. {verdict['explanation']}" if verdict else ran.last_words()
    found: dict[str, Any] = {
        "options": " ".join(options).replace(str(output.parent), "").replace("/", ""),
        "plan": plan[0] if plan else "",
        "exit_code": ran.code,
        "seconds": ran.wall_s,
        "sentence": short(sentence),
        "notes": [short(note) for note in ran.notes()],
        "error": short(ran.last_words()),
    }
    if not output.exists():
        return found
    quality = summary_of.get("quality", {})
    kept = ("corner_noise_over_sigma", "stripe_noise_over_sigma", "corners_rejected", "corners", "stripe_points")
    found |= {key: quality.get(key) for key in (*kept, "stripe_rms_px", "converged")}
    board = quality.get("board") or {}
    found |= {"free": board.get("free"), "held_out_own_px": board.get("held_out_rms_px")}
    whole = read_solved(output, Pictures(capture))
    if whole is not None:
        found |= board_figures(whole, _halves(output, Pictures(capture)))
    return found


def _halves(path: Path, pictures: Pictures) -> list[Solved] | None:
    """The same solve from the observations of its even and of its odd views; None where one has no solution."""
    whole = jaxscan.load_calibration(path)
    assert whole.observations is not None
    settings = jaxscan.CalibrationSettings(camera=whole.camera.model)
    solve = calibrate_camera if whole.scanner is None else jaxscan.calibrate_observations
    found = []
    for first in (0, 1):
        views = np.arange(first, len(np.asarray(whole.observations.corners.record)), 2)
        place = path.with_name(f"{path.stem}_half.{first}.json")
        try:
            jaxscan.save_calibration(solve(_some_views(whole.observations, views), settings=settings), place)
        except jaxscan.JaxscanError:
            return None
        found.append(read_solved(place, pictures))
    return found  # type: ignore[return-value]


def _some_views(whole: Observations, views: np.ndarray) -> Observations:
    """Observations of some views [k], in that order; each is a placement of its own."""
    corners, stripes = whole.corners, whole.stripes
    chosen = {one.name: np.asarray(getattr(corners, one.name))[views] for one in dataclasses.fields(corners)}
    row = np.full(len(np.asarray(corners.record)), -1)
    row[views] = np.arange(len(views))
    kept = row[np.asarray(stripes.view)] >= 0
    lines = {one.name: getattr(stripes, one.name) for one in dataclasses.fields(stripes)}
    lines = {name: None if field is None else np.asarray(field)[kept] for name, field in lines.items()}
    return dataclasses.replace(
        whole,
        corners=type(corners)(**chosen | {"placement": np.arange(len(views), dtype=np.int32)}),
        stripes=type(stripes)(**lines | {"view": row[lines["view"]].astype(np.int32)}),
    )


def read_solved(path: Path, pictures: Pictures) -> Solved | None:
    """A calibration file of jaxscan for NumPy and OpenCV; None where OpenCV lacks its lens."""
    tables = json.loads(path.read_text())
    camera = tables["camera"]
    if camera["model"] not in ("pinhole", "fisheye"):
        return None
    matrix = np.array(
        [[camera["fx"], camera.get("skew", 0.0), camera["cx"]], [0.0, camera["fy"], camera["cy"]], [0.0, 0.0, 1.0]]
    )
    lens = camera["distortion"]
    names = ("k1", "k2", "k3", "k4") if camera["model"] == "fisheye" else RADIAL_TANGENTIAL
    values = np.array([lens.get(name) or 0.0 for name in names])
    if camera["model"] == "pinhole" and not values[5:].any():
        values = values[:5]
    with np.load(path.with_suffix(".npz")) as arrays:
        kept = {key: arrays[key] for key in arrays.files}
    q = np.where(kept["corners.valid"][..., None], kept["corners.q"], np.nan)
    lines = [
        BoardLine(kept["stripes.q"][k][kept["stripes.valid"][k]], int(view), int(laser))
        for k, (view, laser) in enumerate(zip(kept["stripes.view"], kept["stripes.laser"], strict=True))
    ]
    sheets = [Plane(np.array(one["normal"]), float(one["distance_m"])) for one in tables.get("lasers", [])]
    shape = board_shape(tables, pictures)
    return Solved(Lens(matrix, values, camera["model"] == "fisheye"), shape, list(q), lines, sheets)


def board_shape(tables: dict[str, Any], pictures: Pictures) -> np.ndarray:
    """Corners of the board as calibrated [n, 3]; m. A flat board where the file says nothing else."""
    flat, found = grid(pictures.header["board"]), tables["quality"].get("board") or {}
    if "height_m" not in found:
        return flat
    return flat + np.column_stack([np.array(found["shift_m"]), np.array(found["height_m"])])


def write_rig(path: Path, size: tuple[int, int], lens: Lens, sheet: Plane, table: Table) -> None:
    """A calibration as a user writes it by hand: lens, sheet and axis."""
    values = dict(zip(RADIAL_TANGENTIAL, [float(x) for x in np.ravel(lens.distortion)], strict=False))
    matrix = lens.matrix
    pixels = {"fx": matrix[0, 0], "fy": matrix[1, 1], "cx": matrix[0, 2], "cy": matrix[1, 2]}
    tables = {
        "format": "jaxscan-calibration/1",
        "camera": {
            "model": "pinhole",
            "width": size[0],
            "height": size[1],
            **{name: float(value) for name, value in pixels.items()},
            "distortion": values,
        },
        "lasers": [{"normal": sheet.normal.tolist(), "distance_m": float(sheet.distance)}],
        "turntable": {
            "carries": "object",
            "direction": table.direction.tolist(),
            "point_m": table.point.tolist(),
        },
    }
    path.write_text(json.dumps(tables, indent=1))


def reconstruct(capture: Path, rig: Path, table: Table, inner: float) -> dict[str, Any]:
    """One run of `jaxscan reconstruct`, and the figures of its cloud."""
    found, cloud = _reconstruct(capture, rig)
    frame = TableFrame(table)
    return found if cloud is None else found | table_figures(cloud, frame.height, frame.normal, inner)


def _reconstruct(capture: Path, rig: Path) -> tuple[dict[str, Any], np.ndarray | None]:
    cloud = rig.with_name(f"{rig.stem}_{capture.name}.ply")
    cloud.unlink(missing_ok=True)
    ran = verb("reconstruct", capture, "-c", rig, "-o", cloud, "--no-cache", "--max-range", "2")
    short = lambda text: text.replace(str(capture), capture.name)
    found: dict[str, Any] = {
        "exit_code": ran.code,
        "seconds": ran.wall_s,
        "notes": [short(note) for note in ran.notes()],
        "error": short(ran.last_words()),
    }
    return found, points_of(cloud) if cloud.exists() else None


def stage_sweep(pictures: Pictures, rig: dict[str, Any]) -> dict[str, Any]:
    """Figures of the plain method on a sweep of a linear stage, by a calibration as `write_rig` writes it."""
    start, laser, camera = time.perf_counter(), pictures.lasers[0], rig["camera"]
    lens = Lens(np.array([[camera["fx"], 0, camera["cx"]], [0, camera["fy"], camera["cy"]], [0, 0, 1]]), np.zeros(5))
    sheet = Plane(np.array(rig["lasers"][0]["normal"]), rig["lasers"][0]["distance_m"])
    along, points = np.array(rig["turntable"]["direction"]), []
    for record in pictures.records:
        q = centres(_light(pictures, record, laser), laser.get("stripe_axis", "rows"))
        points.append(sheet.meet(lens.straight(q)) + along * record["position_m"])
    figures = bed_figures(np.concatenate(points))
    return figures | {"seconds": time.perf_counter() - start, "records": len(pictures.records)}


def bed_figures(xyz: np.ndarray) -> dict[str, Any]:
    """How well the points [n, 3] keep to the smooth surface that most of them share, the bed below the camera.

    Neither lens nor sheet are known, so a cubic surface is taken off: what is left are errors of single points.
    """
    depths = np.sort(xyz[:, 2])
    counts = np.searchsorted(depths, depths + ON_BED) - np.arange(len(depths))
    off = xyz[:, 2] - (depths[counts.argmax()] + ON_BED / 2)
    x, y = (xyz[:, :2] / np.abs(xyz[:, :2]).max(0)).T
    terms = np.stack([x**i * y**j for i in range(4) for j in range(4 - i)], axis=1)
    for near in (4.0, 2.0, 1.0, 1.0, 1.0):
        on = np.abs(off) < near * ON_BED
        off = xyz[:, 2] - terms @ np.linalg.lstsq(terms[on], xyz[on, 2], rcond=None)[0]
    on = np.abs(off) < ON_BED
    off = off[on]
    return {"points": len(xyz), "on_table": int(on.sum()), "spread_mm": 1e3 * spread(off), "rms_mm": 1e3 * rms(off)}


def reconstruct_stage(capture: Path, rig: Path) -> dict[str, Any]:
    """One run of `jaxscan reconstruct` of a sweep of a linear stage, and the figures of its cloud."""
    found, cloud = _reconstruct(capture, rig)
    return found if cloud is None else found | bed_figures(cloud)


def points_of(path: Path) -> np.ndarray:
    """All points [n, 3] of a cloud; m."""
    cloud = jaxscan.load_cloud(path)
    return np.asarray(cloud.xyz, np.float64)[np.asarray(cloud.valid)]
