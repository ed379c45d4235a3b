"""First laser sheets: the plane that the lines on most boards agree with."""

import math
from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np

from jaxscan.calibration.first_values import seed_plane
from jaxscan.calibration.problem import Prepared, prepare
from jaxscan.errors import CalibrationError
from jaxscan.geometry import AbstractCamera, LaserSheet
from jaxscan.observation import Observations, StripeViews


# Points of a line that are compared with a plane, spread evenly, and the share of them that must lie near it.
_SAMPLES = 9
_NEAR_SHARE = 0.75
# Distance in the image within which a line agrees with a plane [share of the image's diagonal]; more where the lines
# that agree are as far off themselves.
_TOLERANCE = 0.0025
_WIDENED = 3.0
# Planes that are tried, each through two lines; the best of them are fitted to all lines that agree.
_TRIALS = 600
_REFINED = 20
_ROUNDS = 4
_AT_A_TIME = 100
# A plane so close to the camera's centre [share of the boards' distance] shows no depth: any line that stands still
# in the image makes one.
_MIN_DISTANCE = 0.005
# Lines that are not their view's likeliest count less, so that of two planes the likelier one wins.
_LESS_LIKELY = 0.9
# Two lines make a plane; where so many views have a line, it takes more to believe it.
_MANY_VIEWS = 4
_MIN_AGREED = 3
# Chance that a line which is not the laser's agrees with a plane, several times as large as that of random lines; and
# the chance that is left to false lines alone of making a sheet.
_BY_CHANCE = 1e-3
_BELIEVED = 0.05


class Lifted(NamedTuple):
    """Stripe points in space, camera frame."""

    points: np.ndarray
    """[stripes, points, 3], m; 0 on stripes without a point."""
    valid: np.ndarray
    """bool [stripes, points]: seen, and on a board before the camera."""
    camera: AbstractCamera
    pose: np.ndarray
    """T_cam_board of every stripe [stripes, 4, 4]."""
    q: np.ndarray
    """[stripes, points, 2], px."""

    def slopes(self, rows: np.ndarray, places: np.ndarray) -> np.ndarray:
        """Derivatives of some points by the pixel, on their boards [rows, places, 3, 2], m per px.

        Args:
            rows: Some stripes [rows].
            places: Points of each [rows, places].
        """
        at, pose = (rows[:, None], places), self.pose[rows]
        steps = [_meet(self.camera, pose, self.q[at] + np.array(step))[0] for step in ((1.0, 0.0), (0.0, 1.0))]
        return np.stack([step - self.points[at] for step in steps], -1)


def lift_stripes(data: Prepared, camera: AbstractCamera, poses: np.ndarray) -> Lifted:
    """Stripe points where their rays meet the flat boards.

    Source: the paper, equations (5)-(7).
    """
    pose, lit = poses[data.stripe_view], np.any(data.stripe_valid, axis=1)
    points, ahead = np.zeros((*data.stripe_valid.shape, 3)), np.zeros(data.stripe_valid.shape, bool)
    points[lit], ahead[lit] = _meet(camera, pose[lit], data.stripe_q[lit])
    return Lifted(points, data.stripe_valid & ahead, camera, pose, data.stripe_q)


def _meet(camera: AbstractCamera, pose: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where rays of pixels [stripes, points, 2] meet boards [stripes, 4, 4], and whether they do."""
    ray = np.asarray(jax.tree.map(np.asarray, camera).unproject(q))
    normal = pose[:, None, :3, 2]
    level = np.einsum("si,si->s", pose[:, :3, 2], pose[:, :3, 3])[:, None]
    along = np.sum(normal * ray, axis=-1)
    range_m = level / np.where(along == 0, 1.0, along)
    return range_m[..., None] * ray, (along != 0) & (range_m > 0)


class _Lines(NamedTuple):
    """The lines of one laser on boards, each as a few of its points in space."""

    row: np.ndarray
    """Their rows among all lines [lines]."""
    owner: np.ndarray
    """The stripe that each line may be, as its row of `Observations.stripes` [lines]; in order."""
    points: np.ndarray
    """[lines, samples, 3], m, camera frame."""
    slopes: np.ndarray
    """Derivatives of the points by the pixel, on their boards [lines, samples, 3, 2], m per px."""

    @staticmethod
    def of(rows: np.ndarray, owner: np.ndarray, lifted: Lifted) -> "_Lines":
        """Some rows of all lines."""
        rows = rows[np.argsort(owner[rows], kind="stable")]
        seen = [np.flatnonzero(lifted.valid[row]) for row in rows]
        place = [points[np.linspace(0, len(points) - 1, _SAMPLES).round().astype(np.intp)] for points in seen]
        places = np.array(place, np.intp).reshape(-1, _SAMPLES)
        return _Lines(rows, owner[rows], lifted.points[rows[:, None], places], lifted.slopes(rows, places))

    def starts(self) -> np.ndarray:
        """The first line of every owner."""
        return np.flatnonzero(np.diff(self.owner, prepend=-1))

    def distance(self, planes: np.ndarray) -> np.ndarray:
        """How far most of each line lies from its place on planes [n, 4], in the image [n, lines], px."""
        offset = np.einsum("lsi,ni->nls", self.points, planes[:, :3]) - planes[:, 3, None, None]
        by_pixel = np.linalg.norm(np.einsum("lsij,ni->nlsj", self.slopes, planes[:, :3]), axis=-1)
        return np.quantile(np.abs(offset) / np.maximum(by_pixel, 1e-12), _NEAR_SHARE, axis=-1)

    def agree(self, plane: np.ndarray, tolerance: float) -> np.ndarray:
        """The nearest line of each owner, where it is within the tolerance [px] of a plane [4]."""
        distance = self.distance(plane[None])[0]
        nearest = np.array([np.argmin(part) for part in np.split(distance, self.starts()[1:])]) + self.starts()
        return nearest[distance[nearest] <= tolerance]


def seed_sheets(
    observations: Observations, data: Prepared, camera: AbstractCamera, poses: np.ndarray
) -> tuple[list[LaserSheet], Observations]:
    """The sheet of each laser on which the lines of most views lie, and the observations with these lines alone.

    On a real board the brightest line is not always the laser's. A line on a board is a line in space, and two
    make a plane; of many such planes that one is taken with which the lines of most views agree. A stripe whose
    view shows no line on it keeps its row, without a valid point.

    Raises:
        CalibrationError: If the lines of a laser agree on no plane, or determine none.

    Source: the paper, equations (5)-(8); M. A. Fischler, R. C. Bolles, Random sample consensus, Communications of
    the ACM 24, 1981.
    """
    every, owner = _every_line(observations)
    if observations.other_lines is not None:
        data = prepare(replace(observations, stripes=every))
    lifted = lift_stripes(data, camera, poses)
    count = len(np.asarray(observations.stripes.view))
    taken, sheets = np.full(count, -1), []
    for laser, name in enumerate(observations.laser_names):
        rows = np.flatnonzero((data.stripe_laser == laser) & lifted.valid.any(1))
        agreed = _agreed(_Lines.of(rows, owner, lifted), lifted, data.size, name)
        sheets.append(seed_plane(lifted.points[agreed][lifted.valid[agreed]], name))
        taken[owner[agreed]] = agreed
    return sheets, replace(observations, stripes=_take(observations.stripes, every, taken), other_lines=None)


def _every_line(observations: Observations) -> tuple[StripeViews, np.ndarray]:
    """The stripes and then the other lines, and the row of the stripe that each may be."""
    stripes, others = observations.stripes, observations.other_lines
    if others is None:
        return stripes, np.arange(len(np.asarray(stripes.view)))
    key = lambda lines: list(zip(np.asarray(lines.view).tolist(), np.asarray(lines.laser).tolist(), strict=True))
    of = {stripe: row for row, stripe in enumerate(key(stripes))}
    owner = np.array([*range(len(of)), *(of[line] for line in key(others))], np.intp)
    return jax.tree.map(lambda *both: np.concatenate([np.asarray(part) for part in both]), stripes, others), owner


def _take(stripes: StripeViews, every: StripeViews, taken: np.ndarray) -> StripeViews:
    """The stripes, each replaced by the line that is taken for it, and without points where none is (-1)."""
    there = taken >= 0
    taken = np.where(there, taken, np.arange(len(taken)))
    valid = np.asarray(every.valid)[taken] & there[:, None]
    points = jax.tree.map(lambda values: np.asarray(values)[taken], every)
    return replace(points, valid=valid, view=stripes.view, laser=stripes.laser)


def _agreed(lines: _Lines, lifted: Lifted, size: tuple[int, int], name: str) -> np.ndarray:
    """Rows of the lines on one plane, at most one of each stripe; the likeliest of each where there is no plane."""
    tolerance = _TOLERANCE * float(np.hypot(*size))
    plane, agreed = _consensus(lines, tolerance), np.sort(lines.row[lines.starts()])
    for _ in range(_ROUNDS):
        if plane is None:
            break
        near = lines.agree(plane, tolerance)
        tolerance = max(tolerance, _WIDENED * float(np.median(lines.distance(plane[None])[0, near])))
        now = np.sort(lines.row[lines.agree(plane, tolerance)])
        if np.array_equal(now, agreed):
            break
        agreed = now
        sheet = seed_plane(lifted.points[agreed][lifted.valid[agreed]], name)
        plane = np.append(sheet.normal, sheet.distance)
    views = len(lines.starts())
    if views >= _MANY_VIEWS and len(agreed) < _least_agreed(views):
        raise CalibrationError(
            f"The lines of laser {name!r} on {views} boards lie on no common plane: check that nothing "
            "else shines or moves between the laser-off and the laser-on image, and capture the boards again."
        )
    return agreed


def _least_agreed(views: int) -> int:
    """Lines that agree on a plane by more than chance, which lets others come to lie on the plane of any two."""
    by_chance = lambda more: math.comb(views, 2) * math.comb(views - 2, more) * _BY_CHANCE**more
    return next((2 + more for more in range(_MIN_AGREED - 2, views - 1) if by_chance(more) < _BELIEVED), views)


def _consensus(lines: _Lines, tolerance: float) -> np.ndarray | None:
    """The plane [4], normal and distance, that the lines of most stripes lie on; None where no two make one."""
    starts, weight = lines.starts(), np.where(lines.row == lines.owner, 1.0, _LESS_LIKELY)
    pairs = _pairs(lines.owner)
    planes = _planes(lines.points[pairs].reshape(len(pairs), 2 * _SAMPLES, 3))
    reach = np.median(np.linalg.norm(lines.points, axis=-1)) if len(pairs) else 0.0
    planes = planes[np.abs(planes[:, 3]) > _MIN_DISTANCE * reach]

    def scores(planes: np.ndarray) -> np.ndarray:
        parts = np.split(planes, range(_AT_A_TIME, len(planes), _AT_A_TIME))
        distance = np.concatenate([lines.distance(part) for part in parts])
        votes = weight * np.maximum(1.0 - np.square(distance / tolerance), 0.0)
        return np.maximum.reduceat(votes, starts, axis=1).sum(1)

    score = scores(planes) if len(planes) else np.zeros(0)
    if not (score > 0).any():
        return None
    best = np.argsort(-score, kind="stable")[:_REFINED]
    fitted = []
    for plane in planes[best]:
        near = lines.agree(plane, tolerance)
        fitted += [_planes(lines.points[near].reshape(1, -1, 3))[0]] if len(near) > 1 else []
    tried = np.array([*planes[best], *fitted])
    return tried[np.argmax(scores(tried))]


def _pairs(owner: np.ndarray) -> np.ndarray:
    """Pairs of lines of different stripes [pairs, 2]: all, or as many as are tried."""
    count = len(owner)
    if count * (count - 1) // 2 <= _TRIALS:
        pairs = np.stack(np.triu_indices(count, 1), 1)
    else:
        pairs = np.random.default_rng(0).integers(0, count, (_TRIALS, 2))
    return pairs[owner[pairs[:, 0]] != owner[pairs[:, 1]]]


def _planes(points: np.ndarray) -> np.ndarray:
    """Least squares planes [n, 4], normal and distance, of sets of points [n, points, 3]."""
    centre = points.mean(1)
    away = points - centre[:, None]
    normal = np.linalg.eigh(np.swapaxes(away, 1, 2) @ away)[1][:, :, 0]
    return np.column_stack([normal, np.sum(normal * centre, axis=1)])
