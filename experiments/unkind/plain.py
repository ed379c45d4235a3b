"""The plain pipeline: OpenCV's ChArUco corners and `calibrateCamera`, a blurred centre of gravity, planes by SVD.

Nothing of jaxscan's calibration or stripes is used, only its reader of captures. Every step takes the result of the one
before as exact.
"""

import cv2
import numpy as np

import jaxscan
from experiments.plain import around, gravity_of, trimmed
from experiments.unkind.figures import meet, nearest, pick, sheet_grid
from experiments.unkind.scene import look, rotation
from experiments.unkind.truth import Dimension, Estimate, Rig, Rows, TrueStripes, Truth, clocks, passed, ray_grid


BLUR_PX = 1.0
HALF = 4
LEAST_SIGMAS = 5.0


def centres(light: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centre of gravity around the highest value of every row, and whether there is one [rows]."""
    smooth = cv2.GaussianBlur(light, (0, 0), BLUR_PX)
    noise = 1.4826 * np.median(np.abs(smooth - np.median(smooth)))
    columns, values = around(smooth, smooth.argmax(1), HALF)
    return gravity_of(np.maximum(values, 0.0), columns), smooth.max(1) > LEAST_SIGMAS * max(noise, 0.3)


def stripes_of(capture: jaxscan.Capture) -> Rows:
    """Centres of all records of a capture."""
    found = []
    for k in range(len(capture)):
        on, off = (np.asarray(frame, np.float32) for frame in capture.frames(k))
        found.append(centres(on - off))
    u, valid = (np.stack(part) for part in zip(*found, strict=True))
    return Rows(u, np.full(u.shape, np.nan), valid)


class Solved:
    """Camera, sheet and axis, one after the other."""

    def __init__(self, capture: jaxscan.Capture, found: Rows) -> None:
        """From a capture of boards."""
        board = capture.header.board
        name = getattr(cv2.aruco, board.dictionary)
        size = (board.columns, board.rows)
        lengths = board.square_mm / 1000, board.marker_mm / 1000
        drawn = cv2.aruco.CharucoBoard(size, *lengths, cv2.aruco.getPredefinedDictionary(name))
        detector = cv2.aruco.CharucoDetector(drawn)
        self.records, object_points, image_points = [], [], []
        for k in range(len(capture)):
            q, ids, _, _ = detector.detectBoard(np.asarray(capture.frames(k)[1]))
            if ids is not None and len(ids) >= 12:
                self.records.append(k)
                object_points.append(drawn.getChessboardCorners()[ids.ravel()].astype(np.float32))
                image_points.append(q.reshape(-1, 2).astype(np.float32))
        done = cv2.calibrateCamera(object_points, image_points, capture.image_size, None, None, flags=cv2.CALIB_FIX_K3)
        _, self.matrix, self.bend, turns, shifts = done
        self.poses = [(cv2.Rodrigues(turn)[0], shift.ravel()) for turn, shift in zip(turns, shifts, strict=True)]
        self._fit_sheet(found, np.array(size) * lengths[0])
        self._fit_axis(capture)

    def rays(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Directions [n, 3] of pixels, with z = 1."""
        k = self.matrix
        return look(np.array([k[0, 0], k[1, 1], k[0, 2], k[1, 2], *self.bend.ravel()[:4]]), u, v)

    def meet(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Points of the sheet at pixels [n, 3]; m."""
        way = self.rays(u, v)
        return way * (self.distance / (way @ self.normal))[:, None]

    def _fit_sheet(self, found: Rows, size: np.ndarray) -> None:
        points, self.on_board = [], np.zeros(found.valid.shape, bool)
        for record, (turn, shift) in zip(self.records, self.poses, strict=True):
            rows = np.flatnonzero(found.valid[record])
            way = self.rays(found.u[record, rows], rows)
            lifted = way * ((turn[:, 2] @ shift) / (way @ turn[:, 2]))[:, None]
            xy = ((lifted - shift) @ turn)[:, :2]
            inside = (xy > 0).all(1) & (xy < size).all(1)
            self.on_board[record, rows[inside]] = True
            points.append(lifted[inside])
        middle, self.normal = trimmed(np.concatenate(points), 4)
        self.distance = float(self.normal @ middle)

    def _fit_axis(self, capture: jaxscan.Capture) -> None:
        """From all pairs of views of one placement: the mean turn's axis, and its point by least squares."""
        records = capture.records
        axes, rows, values = [], [], []
        for i, a in enumerate(self.records):
            for j, b in enumerate(self.records):
                turned = (records[b].angle or 0.0) - (records[a].angle or 0.0)
                if records[a].placement is None or records[a].placement != records[b].placement or turned < 0.02:
                    continue
                # T_cama_camb: the camera's motion between the views.
                turn = self.poses[i][0] @ self.poses[j][0].T
                shift = self.poses[i][1] - turn @ self.poses[j][1]
                axes.append(cv2.Rodrigues(turn)[0].ravel())
                # Both are seen from the camera at a; brought to angle 0 below.
                rows.append((turn, shift, records[a].angle or 0.0))
        if not rows:
            # No placement was seen twice: nothing but walls is judged by the axis.
            self.direction, self.point = np.array([0.0, -1.0, 0.0]), np.zeros(3)
            return
        direction = np.sum(axes, 0)
        self.direction = direction / np.linalg.norm(direction)
        # The axis has the same place in the camera's frame at every angle.
        matrix = np.concatenate([np.eye(3) - turn for turn, _, _ in rows])
        values = np.concatenate([shift for _, shift, _ in rows])
        self.point = np.linalg.lstsq(np.vstack([matrix, self.direction]), np.append(values, 0.0), rcond=None)[0]

    def rig(self, truth: Truth) -> Rig:
        """The solved rig as the judge compares it."""
        u, v = ray_grid(truth.size)
        way = self.rays(u.ravel(), v.ravel())
        rays = (way / np.linalg.norm(way, axis=1, keepdims=True)).reshape(*u.shape, 3)
        at_u, at_v, _ = sheet_grid(truth)
        return Rig(rays, self.meet(at_u, at_v), self.direction, self.point)

    def cloud(self, found: Rows, angles: np.ndarray) -> np.ndarray:
        """Points [records, rows, 3] in the camera's frame at angle 0."""
        out = np.zeros((*found.u.shape, 3))
        for k, phi in enumerate(angles):
            turn = rotation(self.direction, float(phi))
            p = self.meet(found.u[k], np.arange(found.u.shape[1], dtype=float))
            out[k] = (p - self.point) @ turn.T + self.point
        return out


def wall_of(truth: Truth, stripes: TrueStripes, found: Rows) -> np.ndarray:
    """Which wall each row's point truly lies on [records, rows]; -1 where none, or near an edge."""
    number = nearest(stripes, found.u)
    rows = np.arange(found.u.shape[1], dtype=float)
    true, good = pick(stripes.u, number), found.valid & (pick(stripes.amplitude, number) > 0)
    good &= ~pick(stripes.edge, number) & (np.abs(true - found.u) < 3.0)
    wall = np.full(found.u.shape, -1)
    for k, turned in enumerate(truth.turned):
        turn = rotation(truth.direction, float(turned))
        p = (meet(truth, true[k], rows) - truth.point) @ turn.T + truth.point
        off = np.abs(p @ truth.wall_normals.T - truth.wall_distances)
        wall[k] = np.where(good[k] & (off.min(1) < 0.003), off.argmin(1), -1)
    return wall


def dimensions(truth: Truth, points: np.ndarray, wall: np.ndarray) -> list[Dimension]:
    """Distances of opposite walls through the origin, along the mean normal."""
    planes = []
    for k in range(len(truth.wall_normals)):
        p = points[wall == k]
        if len(p) < 100:
            planes.append(None)
            continue
        middle, normal = trimmed(p, 3)
        planes.append((normal * np.sign(normal @ truth.wall_normals[k]), middle))
    found = []
    for k, true in enumerate(truth.dimensions):
        one, other = planes[2 * k : 2 * k + 2]
        if one is None or other is None:
            continue
        mean = one[0] - other[0]
        mean /= np.linalg.norm(mean)
        # Along the mean normal through the middle of the walls, from one plane to the other.
        centre = 0.5 * (one[1] + other[1])
        ends = [((middle - centre) @ normal) / (mean @ normal) for normal, middle in (one, other)]
        found.append(Dimension(float(ends[1] - ends[0]), float("nan"), float(true)))
    return found


def estimate(folder: str, truth: Truth, sweep_truth: TrueStripes) -> Estimate:
    """The plain pipeline on both captures of a world."""
    start = clocks()
    boards = jaxscan.open_capture(f"{folder}/boards")
    on_boards = stripes_of(boards)
    solved = Solved(boards, on_boards)
    calibrated = clocks()
    rows = stripes_of(jaxscan.open_capture(f"{folder}/sweep"))
    points = solved.cloud(rows, truth.angles)
    seconds = passed(start, calibrated, clocks())
    seen = on_boards._replace(valid=on_boards.valid & solved.on_board)
    found = dimensions(truth, points, wall_of(truth, sweep_truth, rows))
    return Estimate(solved.rig(truth), seen, seen, rows, rows, found, seconds)
