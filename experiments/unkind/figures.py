"""The arithmetic of the judge: an estimate against the truth, and the limits; drawing and reading are elsewhere."""

from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import PchipInterpolator  # type: ignore[import-untyped]

from experiments.report import rms, within
from experiments.unkind.scene import look
from experiments.unkind.truth import Dimension, Rig, Rows, TrueStripes, Truth


AMPLITUDES = ((5, 10), (10, 20), (20, 40), (40, 80), (80, 150), (150, 250))
CLASSES = {"none": (0.0, 0.1), "weak": (0.1, 0.5), "black and white": (0.5, 1.01)}
"""Contrast of the true print within 4 px of the stripe."""
FAR_SIGMAS = 5.0
NEAR_PX = 2.0
"""Largest distance from a true stripe at which a row counts as found, and a point of a board as the stripe's."""
LEAST_POINTS = 50
"""Points from which a class has a figure."""
DEPTH_M = 2.5


def sheet_grid(truth: Truth) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pixels u, v [n] that see the true sheet at a depth of 2.5 m, one in every 10th row, and the points [n, 3]."""
    rows = np.arange(5.0, truth.size[1], 10.0)
    low, high = np.zeros(len(rows)), np.full(len(rows), truth.size[0] - 1.0)
    side = np.sign(meet(truth, low, rows)[:, 2] - DEPTH_M)
    for _ in range(50):
        u = 0.5 * (low + high)
        left = np.sign(meet(truth, u, rows)[:, 2] - DEPTH_M) == side
        low, high = np.where(left, u, low), np.where(left, high, u)
    points = meet(truth, u, rows)
    found = np.abs(points[:, 2] - DEPTH_M) < 1e-3
    return u[found], rows[found], points[found]


def meet(truth: Truth, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Points [n, 3] of the true sheet at pixels, camera's frame; negative depth becomes 1 km."""
    way = look(truth.lens, u, v)
    way = way / np.linalg.norm(way, axis=-1, keepdims=True)
    # rho (b2 tau^2 + b3 tau^3) is homogeneous in p: the same along the ray but for its length.
    g = np.array([0.0, 0.0, 1.0]) - truth.normal * truth.normal[2]
    g /= np.linalg.norm(g)
    a, b = way @ g, way @ np.cross(truth.normal, g)
    tau = np.arctan2(b, a)
    slope = way @ truth.normal - np.hypot(a, b) * (truth.bow[0] * tau**2 + truth.bow[1] * tau**3)
    far = np.where(truth.distance * slope > 0, truth.distance / np.where(slope == 0, 1.0, slope), 1e3)
    return way * np.minimum(far, 1e3)[..., None]


def rig_figures(truth: Truth, rig: Rig, grid: tuple[np.ndarray, np.ndarray]) -> dict[str, float]:
    """Errors of rays, axis and sheet. Rays and axis are compared after the turn that makes the rays agree best."""
    true = look(truth.lens, *grid)
    true = (true / np.linalg.norm(true, axis=-1, keepdims=True)).reshape(-1, 3)
    own = rig.rays.reshape(-1, 3)
    left, _, right = np.linalg.svd(true.T @ own)
    turn = left @ np.diag([1, 1, np.linalg.det(left @ right)]) @ right
    direction, point = turn @ rig.direction, turn @ rig.point
    u, v, points = sheet_grid(truth)
    far = np.linalg.norm(points, axis=1)
    slope = (np.linalg.norm(meet(truth, u + 0.01, v), axis=1) - far) / 0.01
    off = np.linalg.norm(rig.at_row, axis=1) - far
    # The axis is a line: distances of its points are taken across the true one.
    apart = point - truth.point
    apart = apart - truth.direction * (apart @ truth.direction)
    cosine = np.clip(abs(direction @ truth.direction), 0, 1)
    return {
        "rays_px": float(np.mean(truth.lens[:2]) * rms(np.linalg.norm(own @ turn.T - true, axis=1))),
        "axis_deg": float(np.degrees(np.arccos(cosine))),
        "axis_mm": float(1e3 * np.linalg.norm(apart)),
        "sheet_px": rms(off / slope),
        "sheet_mm": 1e3 * rms(off),
    }


def nearest(stripes: TrueStripes, u: np.ndarray) -> np.ndarray:
    """Number of the true crossing nearest to centres [records, rows]; the first where there is none."""
    apart = np.where(stripes.amplitude > 0, np.abs(stripes.u - u[..., None]), np.inf)
    return apart.argmin(-1)


def pick(values: np.ndarray, number: np.ndarray) -> np.ndarray:
    """The values of numbered crossings [records, rows]."""
    return np.take_along_axis(values, number[..., None], -1)[..., 0]


def board_figures(stripes: TrueStripes, found: Rows) -> dict[str, Any]:
    """Points of stripes on boards: errors across the stripe, against the stated sigma, by the print's contrast."""
    number = nearest(stripes, found.u)
    contrast, amplitude = pick(stripes.contrast, number), pick(stripes.amplitude, number)
    on_board = found.valid & np.isfinite(contrast) & (amplitude > 0) & ~pick(stripes.edge, number)
    error = found.u - pick(stripes.u, number)
    for record in range(len(error)):
        at = np.flatnonzero(on_board[record])
        if len(at) > 5:
            error[record] /= np.hypot(1.0, np.polyfit(at, pick(stripes.u, number)[record, at], 1)[0])
    right = on_board & (np.abs(error) < NEAR_PX)
    out: dict[str, Any] = {
        "points": int(right.sum()),
        "far_share": float(1 - right.sum() / max(on_board.sum(), 1)),
        "rms_px": rms(error[right]),
        "stated_px": rms(found.sigma[right]),
        "error_over_stated": rms(error[right] / found.sigma[right]),
        "classes": {},
    }
    for name, (low, high) in CLASSES.items():
        mine = right & (contrast >= low) & (contrast < high)
        enough = mine.sum() >= LEAST_POINTS
        out["classes"][name] = {
            "points": int(mine.sum()),
            "rms_px": rms(error[mine]),
            "error_over_stated": rms(error[mine] / found.sigma[mine]) if enough else float("nan"),
        }
    out["amplitudes"] = {}
    for low, high in AMPLITUDES:
        mine = right & (amplitude >= low) & (amplitude < high)
        out["amplitudes"][f"{low}-{high}"] = {"points": int(mine.sum()), "rms_px": rms(error[mine])}
    means = [error[k][right[k]].mean() for k in range(len(error)) if right[k].sum() >= 20]
    out["mean_of_view_px"] = float(np.abs(means).max()) if means else float("nan")
    return out


def noise_sigma(truth: Truth, background: np.ndarray) -> np.ndarray:
    """Standard deviation of on minus off beside the stripe [DN]."""
    electrons, read, _, _ = truth.noise
    return np.sqrt(2 * (read**2 + 1 / 12 + np.maximum(background, 0) / electrons))


def row_bound(truth: Truth, amplitude: np.ndarray, width: np.ndarray, background: np.ndarray) -> np.ndarray:
    """Cramer-Rao bound of a row's centre [px], with unknown amplitude and width.

    Variance of a pixel of the difference: that of the background, the stripe's own photons, and the square of speckle
    times signal, as if speckle were independent from pixel to pixel. The mean of the variance over eight places of the
    centre within a pixel.
    """
    electrons, _, _, speckle = truth.noise
    total = np.zeros(len(amplitude))
    for phase in (np.arange(8) + 0.5) / 8 - 0.5:
        x = np.arange(-8, 9)[None] - phase
        nodes = np.linspace(-0.4, 0.4, 5)
        d = (x[..., None] + nodes) / width[:, None, None]
        bell = np.exp(-0.5 * d**2)
        shape = bell.mean(-1)
        by_centre = amplitude[:, None] * (bell * d).mean(-1) / width[:, None]
        by_width = amplitude[:, None] * (bell * d * d).mean(-1) / width[:, None]
        signal = amplitude[:, None] * shape
        variance = noise_sigma(truth, background)[:, None] ** 2 + signal / electrons + (speckle * signal) ** 2
        jacobian = np.stack([by_centre, by_width, shape], -1)
        normal = np.einsum("nij,nik->njk", jacobian, jacobian / variance[..., None])
        total += np.linalg.inv(normal)[:, 0, 0]
    return np.sqrt(total / 8)


def sweep_figures(truth: Truth, stripes: TrueStripes, found: Rows) -> dict[str, Any]:
    """Stripes of the sweep on continuous surfaces, and how many of them were found."""
    number = nearest(stripes, found.u)
    amplitude, edge = pick(stripes.amplitude, number), pick(stripes.edge, number)
    error = found.u - pick(stripes.u, number)
    there = found.valid & ~edge
    has_sigma = bool(np.isfinite(found.sigma[there]).all())
    # A point where the truth has nothing is as far off as can be.
    far = there & ((np.abs(error) > FAR_SIGMAS * found.sigma) | (amplitude <= 0))
    if not has_sigma:
        far = there & ((np.abs(error) > 1.0) | (amplitude <= 0))
    good = there & ~far & (amplitude < AMPLITUDES[-1][1])
    parts = (stripes.amplitude, stripes.width, stripes.background)
    bound = row_bound(truth, *(pick(part, number)[good] for part in parts))
    strong, brightest = strong_rows(truth, stripes), stripes.amplitude[..., 0]
    clear = (stripes.surface[..., 0] >= 0) & ~stripes.edge[..., 0]
    close = found.valid & (np.abs(error) < NEAR_PX) & (amplitude > 0)
    out: dict[str, Any] = {
        "points": int(good.sum()),
        "rms_px": rms(error[good]),
        "rms_near_px": rms(error[there & close & (amplitude < AMPLITUDES[-1][1])]),
        "bound_px": rms(bound),
        "over_bound": rms(error[good]) / rms(bound),
        "found_share": float((strong & close).sum() / max(strong.sum(), 1)),
        "far_share": float(far.sum() / max(there.sum(), 1)),
        "false_share": float((there & ~close).sum() / max(there.sum(), 1)),
        "stated_over_true": 1 / rms(error[good] / found.sigma[good]) if has_sigma else float("nan"),
        "classes": {},
    }
    for low, high in AMPLITUDES:
        mine = good & (amplitude >= low) & (amplitude < high)
        of_class = mine[good]
        enough = mine.sum() >= LEAST_POINTS
        due = clear & (brightest >= low) & (brightest < high)
        out["classes"][f"{low}-{high}"] = {
            "points": int(mine.sum()),
            "due": int(due.sum()),
            "found": int((due & close).sum()),
            "rms_px": rms(error[mine]),
            "bound_px": rms(bound[of_class]),
            "stated_over_true": 1 / rms(error[mine] / found.sigma[mine]) if enough and has_sigma else float("nan"),
        }
    return out


def strong_rows(truth: Truth, stripes: TrueStripes) -> np.ndarray:
    """Rows in which the brightest true stripe is over five standard deviations of a pixel [records, rows]."""
    there = stripes.surface[..., 0] >= 0
    return there & (stripes.amplitude[..., 0] > FAR_SIGMAS * noise_sigma(truth, stripes.background[..., 0]))


def step_width(truth: Truth, stripes: TrueStripes, found: Rows, reach: int = 12) -> dict[str, float]:
    """Rows from 10 to 90 % of a level step, of the median over all profiles that cross one.

    Lines through the true centres 4 to 12 rows away give 0 and 100 %.
    """
    curves: list[np.ndarray] = []
    for front, behind in truth.panels:
        surface = stripes.surface[..., 0]
        change = (surface[:, :-1] == behind) & (surface[:, 1:] == front)
        for record, row in zip(*np.nonzero(change), strict=True):
            above, below = np.arange(row - reach, row + 1), np.arange(row + 1, row + reach + 2)
            if above[0] < 0 or below[-1] >= surface.shape[1]:
                continue
            if (surface[record, above] != behind).any() or (surface[record, below] != front).any():
                continue
            rows, u = np.concatenate([above, below]), stripes.u[record, :, 0]
            low, high = (np.polyval(np.polyfit(part, u[part], 1), rows) for part in (above[:-4], below[4:]))
            share = (found.u[record, rows] - low) / (high - low)
            curves.append(np.where(found.valid[record, rows], share, np.nan))
    if len(curves) < 5:
        return {"rows": float("nan"), "profiles": len(curves)}
    with np.errstate(all="ignore"):
        middle = np.nanmedian(curves, axis=0)
    return {"rows": _rise(middle), "profiles": len(curves)}


def _rise(curve: np.ndarray) -> float:
    """Distance between the places where a curve passes 0.1 for the last time and 0.9 for the first time after."""
    if not np.isfinite(curve).all():
        return float("nan")
    # Straight lines between rows would widen a sharp step.
    place = np.linspace(0, len(curve) - 1, 100 * (len(curve) - 1) + 1)
    fine = PchipInterpolator(np.arange(len(curve)), curve)(place)
    middle = len(fine) // 2
    low, high = np.flatnonzero(fine[: middle + 100] < 0.1), np.flatnonzero(fine[middle - 100 :] > 0.9)
    return float(place[middle - 100 + high[0]] - place[low[-1]]) if len(low) and len(high) else float("nan")


def dimension_figures(dimensions: list[Dimension], expected: int) -> dict[str, Any]:
    """Errors of wall-to-wall distances, and how many of those expected lie within two stated sigmas."""
    error = np.array([one.value - one.true for one in dimensions])
    sigma = np.array([one.sigma for one in dimensions])
    return {
        "errors_mm": (1e3 * error).tolist(),
        "sigmas_mm": (1e3 * sigma).tolist(),
        "rms_mm": 1e3 * rms(error),
        "missed": expected - len(error),
        "within_two": float(np.sum(np.abs(error) <= 2 * sigma)) / expected,
    }


FINAL_SEEDS = tuple(range(101, 111))
"""Seeds of both worlds that were used for nothing while building; 1 to 20 were."""


class Limit(NamedTuple):
    """A figure and the bounds it has to keep in every seed."""

    name: str
    path: tuple[str, ...]
    low: float | None = None
    high: float | None = None
    classes: bool = False
    """Whether `path` leads to classes, each of which has the figure `last`."""
    last: str = ""


LIMITS = (
    Limit("points on boards: error / stated", ("boards", "classes"), 0.9, 1.15, True, "error_over_stated"),
    Limit("laser plane at 2.5 m [px]", ("rig", "sheet_px"), high=0.03),
    Limit("sweep: RMS / row-wise bound", ("smooth", "over_bound"), high=0.6),
    Limit("step: width / row-wise width", ("step", "ratio"), high=1.2),
    Limit("rows found", ("smooth", "found_share"), low=0.99),
    Limit("sweep: stated / true", ("smooth", "classes"), 0.9, 1.1, True, "stated_over_true"),
    Limit("farther than 5 sigmas", ("smooth", "far_share"), high=0.001),
)
"""In every seed. Walls have a limit over all seeds: 95 % within two stated sigmas."""
WALLS_WITHIN_TWO = 0.95

RIVALS = (
    ("rays [px]", ("rig", "rays_px"), 1),
    ("axis direction [deg]", ("rig", "axis_deg"), 1),
    ("axis point [mm]", ("rig", "axis_mm"), 1),
    ("laser plane at 2.5 m [px]", ("rig", "sheet_px"), 1),
    ("points on boards, RMS [px]", ("boards", "rms_px"), 1),
    ("sweep, RMS of errors under 2 px [px]", ("smooth", "rms_near_px"), 1),
    ("rows found", ("smooth", "found_share"), -1),
    ("walls, RMS [mm]", ("walls", "rms_mm"), 1),
)
"""Figures in which jaxscan may be worse than the plain pipeline in no seed; -1 where more is better."""


def figure(measured: dict[str, Any], path: tuple[str, ...]) -> Any:
    """A figure by its path, NaN where it was not measured; the ratio of the step's widths is computed."""
    if path == ("step", "ratio"):
        return measured["step"]["smooth"] / measured["step"]["rows"]
    found: Any = measured
    for key in path:
        if key not in found:
            return float("nan")
        found = found[key]
    return found


def values(measured: dict[str, Any], limit: Limit) -> dict[str, float]:
    """The values that a limit is about, by class; one, named "", where it has none. Unknown ones are left out."""
    found = figure(measured, limit.path)
    each = {name: one[limit.last] for name, one in found.items()} if limit.classes else {"": found}
    return {name: value for name, value in each.items() if np.isfinite(value)}


def broken(measured: dict[str, Any], limit: Limit) -> list[str]:
    """The values outside of a limit's bounds, as text."""
    found = values(measured, limit)
    out = {name: value for name, value in found.items() if not within(value, limit.low, limit.high)}
    return [f"{name + ': ' if name else ''}{value:.4g}" for name, value in out.items()]


def worse(measured: dict[str, Any], plain: dict[str, Any]) -> list[str]:
    """Figures in which jaxscan is worse than the plain pipeline, or has none where that has one."""
    found = []
    for name, path, sign in RIVALS:
        own, other = figure(measured, path), figure(plain, path)
        if np.isfinite(other) and not sign * own <= sign * other:
            found.append(f"{name} {own:.4g} against {other:.4g}")
    return found
