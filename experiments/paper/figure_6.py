"""Figure 6: stripe points by the board's pose against the same points by camera and plane.

The paper reports standard deviations of 0.02, 0.11 and 1.13 mm in X, Y and Z. It does not report the distance of its
boards. A difference runs along its ray, so the ratios X : Y : Z give the rays: x = 0.018 and y = 0.097 (root mean
square). With Table II's plane, the stripe crosses the middle of the image there: at 1.3 m. So boards stand there: the
four to which the paper's method fits its plane (1.0 to 1.6 m), and others at 1.3 m that no calibration has seen.

The paper does not say how it found the stripe: its method is run with a centre of gravity and with the highest pixel.
A few rows at the edges of squares, where the print cuts off a part of the stripe, make most of the standard deviation
of the centre of gravity. So a robust one, from the median absolute deviation, is reported too.

Both plain finders see the stripe on white squares alone. Ours is compared at the same rows: row by row, as in a
calibration, and smoothed along the stripe, as in `jaxscan.reconstruct`. A third figure is that of all rows, also those
on ink, where the stripe is many times fainter.
"""

from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np

import jaxscan
from experiments.paper.methods import (
    EXTRACTORS,
    METHODS,
    Extract,
    PaperWay,
    board_pose,
    find_board,
    points_on_board,
    points_on_sheet,
    rigid,
    stripe_on_board,
)
from experiments.paper.products import draws, held_out, observe_held_out
from experiments.paper.stage import Direction, Metric, Stage, plt, save
from experiments.report import rms
from jaxscan.calibration import Quality
from jaxscan.geometry import lit_points
from jaxscan.observation import Observations, StripeViews
from jaxscan.stripes import smooth_profiles


_STEP_PX = 0.01
_FITTED = ("even print", "weak edge", "strong edge")
_CONTRASTS = (*_FITTED, *(f"{name}, not through the print" for name in _FITTED))
"""Names of the contrast classes of `StripeViews` in `Quality.stripe_noise_by_contrast`."""


class Check(NamedTuple):
    """The stripe of one board."""

    record: int
    row: np.ndarray
    """Image rows [points]."""
    difference: np.ndarray
    """By sheet minus by board, camera frame [points, 3], m."""
    predicted: np.ndarray
    """Standard deviation of the difference's Z by the stripe's noise alone [points], m; NaN where not known."""

    def at_rows_of(self, others: list["Check"]) -> "Check":
        """The points of rows at which another method has one too."""
        rows = [other.row for other in others if other.record == self.record]
        kept = np.isin(self.row, np.concatenate(rows)) if rows else np.zeros(len(self.row), bool)
        return Check(self.record, self.row[kept], self.difference[kept], self.predicted[kept])


def paper_own(way: PaperWay) -> list[Check]:
    """By the paper's method, on the boards to which its plane was fitted, with the poses of its calibration."""
    pairs = enumerate(zip(way.pose, way.stripe, strict=True))
    return [_paper_check(way, record, pose, uv) for record, (pose, uv) in pairs if len(uv)]


def paper_held_out(way: PaperWay, capture: jaxscan.Capture, extract: Extract) -> list[Check]:
    """By the paper's method, on boards that no calibration has seen."""
    board, out = capture.board, []
    for index in range(len(capture.records)):
        on, off = capture.frames(index)
        found = find_board(off, board.grid(), board.square)
        if found is not None:
            pose = board_pose(way.matrix, way.k, found)
            uv = stripe_on_board(way.matrix, way.k, pose, board.outline(), extract(on, off))
            out.append(_paper_check(way, index, pose, uv))
    return out


def ours(calibration: jaxscan.Calibration, observations: Observations) -> list[Check]:
    """By our method. The poses are found from corners alone: the sheet does not influence them."""
    scanner, quality = calibration.scanner, calibration.quality
    if scanner is None:
        raise ValueError("The calibration has no scanner.")
    out = []
    corners, stripes = observations.corners, observations.stripes
    shape = _Bow(observations.board.corners(), quality.board_warp_m or (0.0, 0.0))
    for index, view in enumerate(np.asarray(stripes.view)):
        seen = np.asarray(corners.valid[view])
        pose = _pose(shape.corners()[seen], _rays(scanner, np.asarray(corners.q[view])[seen])[0])
        kept = np.asarray(stripes.valid[index])
        uv = np.asarray(stripes.q[index])[kept]

        def by_both(uv: np.ndarray, pose: np.ndarray = pose) -> np.ndarray:
            rays, on_sheet = _rays(scanner, uv)
            return on_sheet - shape.meet(pose, rays)

        difference = by_both(uv)
        slope = (by_both(uv + [_STEP_PX, 0.0]) - difference)[:, 2] / _STEP_PX
        predicted = np.abs(slope) * _stripe_noise(quality, stripes, index)[kept]
        out.append(Check(int(corners.record[view]), np.rint(uv[:, 1]).astype(int), difference, predicted))
    return out


def along_the_stripe(observations: Observations) -> Observations:
    """The same with stripes smoothed over neighbouring rows, as `jaxscan.reconstruct` does before it makes points."""
    stripes = observations.stripes
    q, sigma, valid = (np.array(part) for part in (stripes.q, stripes.sigma, stripes.valid))
    for index in range(len(q)):
        rows = np.rint(q[index, valid[index], 1]).astype(int)
        u, deviation, there = np.zeros((3, 1, observations.height))
        u[0, rows], deviation[0, rows], there[0, rows] = q[index, valid[index], 0], sigma[index, valid[index]], 1
        found = smooth_profiles(u.astype(np.float32), deviation.astype(np.float32), there.astype(bool))
        q[index, valid[index], 0], sigma[index, valid[index]] = found.u[0, rows], found.sigma[0, rows]
    return replace(observations, stripes=replace(stripes, q=q, sigma=sigma))


def _stripe_noise(quality: Quality, stripes: StripeViews, index: int) -> np.ndarray:
    """Standard deviation of a stripe's centres [points], px: the extractor's times the calibration's factor."""
    promised = np.asarray(stripes.sigma[index])
    rest = quality.stripe_noise_over_sigma or 1.0
    factors = np.array([(quality.stripe_noise_by_contrast or {}).get(name, rest) for name in _CONTRASTS])
    return promised * (rest if stripes.contrast is None else factors[np.asarray(stripes.contrast[index])])


def _paper_check(way: PaperWay, record: int, pose: np.ndarray, uv: np.ndarray) -> Check:
    difference = points_on_sheet(way, uv) - points_on_board(way.matrix, way.k, pose, uv)
    return Check(record, uv[:, 1].astype(int), difference, np.full(len(uv), np.nan))


class _Bow:
    """A board with a parabolic bow: kx (1 - x'^2) + ky (1 - y'^2), x' and y' = +-1 at the outer corners."""

    def __init__(self, flat: np.ndarray, warp: tuple[float, float]) -> None:
        low, high = flat[:, :2].min(0), flat[:, :2].max(0)
        self.flat, self.warp, self.middle, self.half = flat, np.array(warp), (low + high) / 2, (high - low) / 2

    def height(self, xy: np.ndarray) -> np.ndarray:
        return (1 - ((xy - self.middle) / self.half) ** 2) @ self.warp

    def corners(self) -> np.ndarray:
        return np.column_stack([self.flat[:, :2], self.height(self.flat[:, :2])])

    def meet(self, pose: np.ndarray, rays: np.ndarray) -> np.ndarray:
        """Where rays [n, 3] meet the board, camera frame."""
        origin, along = -pose[:3, :3].T @ pose[:3, 3], rays @ pose[:3, :3]
        distance = -origin[2] / along[:, 2]
        for _ in range(5):
            distance = (self.height(origin[:2] + distance[:, None] * along[:, :2]) - origin[2]) / along[:, 2]
        return distance[:, None] * rays


def _pose(places: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """T_cam_board [4, 4] of corners [n, 3] that are seen along rays [n, 3]."""
    seen = rays[:, :2] / rays[:, 2:]
    _, turn, shift = cv2.solvePnP(places, seen, np.eye(3), None, flags=cv2.SOLVEPNP_ITERATIVE)
    # The corners of a bowed board are not in a plane: the first pose is refined.
    turn, shift = cv2.solvePnPRefineLM(places, seen, np.eye(3), None, turn, shift)
    return rigid(turn, shift)


def _rays(scanner: jaxscan.Scanner, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit rays [n, 3] of pixels [n, 2], and where they meet the sheet [n, 3], camera frame."""
    return np.asarray(jaxscan.rays(scanner.rig, q)), np.asarray(lit_points(scanner.rig, q, 0)[0])


PAPER = {"x": 0.02, "y": 0.11, "z": 1.13}
"""Standard deviations [mm]."""
OURS_Z = 0.6
"""Limit of our Z [mm]; X and Y in proportion to the paper's."""
CLASS = 2.0
"""Largest factor between the paper's figures and those of its method on the simulator."""
UNSEEN = "boards that no calibration has seen"
BOARDS = {"own": "the calibration's four boards", "held_out": UNSEEN}
WAYS = {"ours": "ours"} | {f"paper_way_{name}": METHODS[name] for name in EXTRACTORS}
_COLOURS = {"ours": "tab:green", "paper_way_gravity": "tab:blue", "paper_way_highest": "tab:orange"}


class Found(NamedTuple):
    """By method: checks of all boards of all draws."""

    own: dict[str, list[Check]]
    held_out: dict[str, list[Check]]
    every_row: list[Check]
    """Ours on boards that no calibration has seen, all rows."""
    smoothed: list[Check]
    """Ours on the same boards, centres smoothed over neighbouring rows as `jaxscan.reconstruct` does."""


def run(stage: Stage) -> list[Metric]:
    """Standard deviations of both methods, on the calibration's boards and on others."""
    found = compare(stage)
    metrics = [
        _metric(stage, way, boards, axis, float(value))
        for boards in BOARDS
        for way, checks in getattr(found, boards).items()
        for axis, value in zip("xyz", deviations(checks), strict=True)
    ]
    for axis, each in zip("xyz", deviations(found.smoothed), strict=True):
        label = f"ours, smoothed along the stripe: standard deviation of {axis.upper()}, {UNSEEN}, white squares"
        limit = None if stage.quick else OURS_Z * PAPER[axis] / PAPER["z"]
        key, tolerance = f"ours_smoothed_{axis}", 0.2 * float(each)
        metrics.append(Metric(key, float(each), "mm", "less", tolerance, PAPER[axis], high=limit, label=label))
    for way, checks in found.held_out.items():
        z = 1e3 * np.concatenate([each.difference[:, 2] for each in checks])
        value = float(1.4826 * np.median(np.abs(z - np.median(z))))
        label = f"{WAYS[way]}: standard deviation of Z by the median absolute deviation, {UNSEEN}, white squares"
        metrics.append(Metric(f"{way}_held_out_z_middle", value, "mm", "near", 0.15 * value, label=label))
    value = float(deviations(found.every_row)[2])
    label = f"ours: standard deviation of Z, {UNSEEN}, white and black squares"
    metrics.append(Metric("ours_every_row_z", value, "mm", "less", 0.15 * value, label=label))
    label = f"ours: rms Z over its prediction by the stripe's noise, {UNSEEN}, white squares"
    ratio = observed_over_predicted(found.held_out["ours"])
    metrics.append(Metric("ours_observed_over_predicted", ratio, "1", "near", 0.1, low=0.8, high=1.2, label=label))
    _picture(stage, found)
    return metrics


def compare(stage: Stage) -> Found:
    """Differences of the first draws, as many as there are captures of boards that no calibration has seen."""
    boards = held_out(stage)
    found = Found({way: [] for way in WAYS}, {way: [] for way in WAYS}, [], [])
    for draw, path in zip(draws(stage), boards.captures, strict=False):
        capture = jaxscan.open_capture(path)
        for name, extract in EXTRACTORS.items():
            way = draw.by(name)
            own, others = paper_own(way), paper_held_out(way, capture, extract)
            found.own[f"paper_way_{name}"] += own
            found.held_out[f"paper_way_{name}"] += others
        calibration = jaxscan.load_calibration(draw.ours)
        assert calibration.observations is not None
        found.own["ours"] += [each.at_rows_of(own) for each in ours(calibration, calibration.observations)]
        observed = observe_held_out(draw.ours, path)
        checks = ours(calibration, observed)
        found.held_out["ours"] += [each.at_rows_of(others) for each in checks]
        found.every_row.extend(checks)
        found.smoothed.extend(each.at_rows_of(others) for each in ours(calibration, along_the_stripe(observed)))
        stage.say(f"draw {draw.number + 1} of figure 6")
    return found


def deviations(checks: list[Check]) -> np.ndarray:
    """Standard deviations of X, Y and Z over all points [mm]."""
    return 1e3 * np.concatenate([each.difference for each in checks]).std(0)


def observed_over_predicted(checks: list[Check]) -> float:
    """Root mean square of Z over its standard deviation by the stripe's noise [1]."""
    return rms(np.concatenate([each.difference[:, 2] / each.predicted for each in checks]))


def _metric(stage: Stage, way: str, boards: str, axis: str, value: float) -> Metric:
    paper, limits = PAPER[axis], {}
    # Small images have four times the error. X and Y depend on the board's place in the image, which is random for the
    # boards of the calibration.
    if not stage.quick and boards == "held_out" and way == "ours":
        limits = {"high": paper * OURS_Z / PAPER["z"]}
    elif not stage.quick and way != "ours" and (boards == "held_out" or axis == "z"):
        limits = {"low": paper / CLASS, "high": paper * CLASS}
    label = f"{WAYS[way]}: standard deviation of {axis.upper()}, {BOARDS[boards]}, white squares"
    direction: Direction = "less" if way == "ours" else "near"
    return Metric(f"{way}_{boards}_{axis}", value, "mm", direction, 0.15 * value, paper, **limits, label=label)


def _picture(stage: Stage, found: Found) -> None:
    figure, (points, histogram, bars) = plt.subplots(1, 3, figsize=(17, 5.6), layout="constrained")
    reach = 3.5 * max(deviations(each)[2] for each in found.held_out.values())
    for way in reversed(WAYS):
        one = found.held_out[way][0]
        points.plot(one.row, 1e3 * one.difference[:, 2], ".", ms=3, color=_COLOURS[way], label=WAYS[way])
        every = 1e3 * np.concatenate([each.difference for each in found.held_out[way]])[:, 2]
        style = {"density": True, "histtype": "step", "lw": 1.6, "color": _COLOURS[way]}
        histogram.hist(every, np.linspace(-reach, reach, 81), label=f"{WAYS[way]}: {every.std():.2f} mm", **style)
    every = 1e3 * np.concatenate([each.difference for each in found.smoothed])[:, 2]
    label = f"ours, smoothed along the stripe: {every.std():.2f} mm"
    histogram.hist(every, np.linspace(-reach, reach, 81), label=label, **style | {"color": "darkgreen", "ls": ":"})
    points.set(xlabel="row of the image [px]", ylabel="Z by plane − Z by board [mm]", ylim=(-reach, reach))
    points.set_title("One board that no calibration has seen, at 1.3 m; gaps: black squares", fontsize=10)
    histogram.set(xlabel="Z by plane − Z by board [mm]", ylabel="share of points per mm")
    histogram.set_ylim(top=1.4 * histogram.get_ylim()[1])
    count = len(found.held_out["ours"])
    histogram.set_title(f"All {count} boards that no calibration has seen: standard deviation of Z", fontsize=10)
    paper = np.array(list(PAPER.values()))
    for number, way in enumerate(WAYS):
        for boards, shade, aside in (("own", 0.4, -0.06), ("held_out", 1.0, 0.06)):
            at, shares = np.arange(3) + (number - 1) * 0.27 + aside, deviations(getattr(found, boards)[way]) / paper
            label = f"{WAYS[way]}, {BOARDS[boards]}"
            bars.bar(at, shares, 0.115, color=_COLOURS[way], alpha=shade, label=label)
    bars.axhspan(1 / CLASS, CLASS, color="0.9", zorder=0, label="within a factor of two of the paper")
    bars.axhline(OURS_Z / PAPER["z"], color="k", ls="--", lw=1, label=f"our limit: {OURS_Z} mm in Z")
    bars.set(yscale="log", ylim=(0.1, 60), ylabel="standard deviation / the paper's [1]")
    bars.set_yticks([0.1, 0.2, 0.5, 1, 2, 5, 10], ["0.1", "0.2", "0.5", "1", "2", "5", "10"])
    bars.set_xticks(range(3), [f"{axis.upper()}\npaper {value} mm" for axis, value in PAPER.items()])
    bars.set_title("Against the paper's figures")
    for axes in (points, histogram, bars):
        axes.legend(fontsize=8, loc="upper right")
        axes.grid(alpha=0.3)
    figure.suptitle(f"Figure 6, {stage.world} world: stripe points by camera + plane against the board's pose")
    save(figure, stage.picture("figure_6"), 130)
