"""The whole plain method on a capture: boards, lines on them, sheets; and sweeps."""

import time
from typing import Any

import cv2
import numpy as np

from experiments.real_sets.figures import BoardLine, Solved, board_figures, table_figures
from experiments.real_sets.pictures import Pictures
from experiments.real_sets.plain.boards import Lens, calibrate, find, grid, held_out, pose_of
from experiments.real_sets.plain.stripes import Plane, board_plane, centres, consensus, signal, straight_line
from experiments.real_sets.plain.table import Table, fit_table, markers


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


def table_of(pictures: Pictures, lens: Lens) -> Table:
    """The turntable, from the markers on it."""
    found = [(k, markers(pictures.grey(pictures.records[k]))) for k in range(0, len(pictures.records), EVERY)]
    kept = [(k, q) for k, q in found if q is not None]
    return fit_table(np.array([k for k, _ in kept]), np.array([q for _, q in kept]), lens)


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
