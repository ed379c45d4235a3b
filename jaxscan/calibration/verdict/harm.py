r"""The error that the structure in the residuals does to a rig, as steps of its parameters.

Steps are like standard deviations along independent directions: a covariance that has $\sum_k s_k s_k^T$ added
covers each of them at one sigma. With the sizes $-m$ of the terms that a model lacks, the shared unknowns are off by
$\delta = (J^T J)^{-1} J^T E m$ ("imitation"), and the missing shape itself remains beside it. Of lens and sheet the two
are added first, since they cancel in part; the shape that their parameters can follow becomes a step of these, and the
rest a step of those that act alike.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from jaxscan.calibration.chi_squared import chance_of
from jaxscan.calibration.settings import CalibrationSettings
from jaxscan.calibration.solve.adjustment import Adjustment
from jaxscan.calibration.solve.problem import layout_of
from jaxscan.calibration.verdict.cross_validation import put_back_lines
from jaxscan.calibration.verdict.limits import result_of_test
from jaxscan.calibration.verdict.propagate import TRAVEL_M
from jaxscan.calibration.verdict.quality import ModelTest
from jaxscan.calibration.verdict.structure import (
    Judged,
    Missing,
    extents_of,
    judge,
    lens_terms,
    radial_terms,
    repeated_views,
    sheet_terms,
    turn_terms,
)
from jaxscan.geometry import Layout, LinearStage
from jaxscan.observation import Observations


# Zones of the image by the place in it, -1 ... 1: corners where both coordinates are beyond this, edges where one is,
# and the middle within half of it.
_OUTER = 0.6
# A zone is named where its error is this many times that of the whole image.
_STANDS_OUT = 1.3


class Harm(NamedTuple):
    """A test, and the error that the structure it found does."""

    test: ModelTest
    steps: np.ndarray
    """[steps, shared], in px, rad, m: at most one for each parameter of the rig; none without structure."""


def find_harm(result: Adjustment, settings: CalibrationSettings, given: Observations) -> list[Harm]:
    """Test the models of a finished solve, and find the error that the structure in its residuals does.

    Args:
        result: Of `adjust`, converged; call in 64 bit.
        settings: Of the solve.
        given: The observations before any was left out.
    """
    judged = judge(result, settings)
    scales = np.asarray(result.problem.scales)
    found: list[Harm] = []
    # Cross-validations come last: they count for the part that the others do not cover.
    for test in judged.tests:
        steps, where = np.zeros((0, len(scales))), None
        if test.name in judged.missing:
            steps, where = _steps_of(result, judged.missing[test.name], judged.places)
        elif test.name in judged.splits and _has_structure(test, judged):
            before = np.concatenate([steps, *(harm.steps for harm in found)])
            steps = judged.splits[test.name].beyond(before.T @ before, scales)[None]
        found.append(Harm(replace(test, where=where), steps))
    lines = put_back_lines(result, given) if len(result.problem.lasers.distance) else []
    return [*found, Harm(_lines_test(result, lines), np.stack(lines))] if lines else found


def _lines_test(result: Adjustment, steps: list[np.ndarray]) -> ModelTest:
    """The steps of sheets by lines that were left out, against the covariance of noise."""
    scales = np.asarray(result.problem.scales)
    moved = np.array([step != 0 for step in steps]).any(0)
    step = np.sum(steps, axis=0)[moved] / scales[moved]
    covariance = np.linalg.inv(result.linearised.reduced)[np.ix_(moved, moved)]
    statistic, dof = float(step @ np.linalg.solve(covariance, step)), int(moved.sum())
    p = chance_of(statistic, dof)
    return ModelTest("lines", statistic, dof, p, p)


def _has_structure(test: ModelTest, judged: Judged) -> bool:
    return result_of_test(test.p, test.p_structure, len(judged.tests)) == "structure"


def _steps_of(result: Adjustment, missing: Missing, places: dict[str, np.ndarray]) -> tuple[np.ndarray, str | None]:
    """The steps of missing terms, and where in the image they tell most."""
    problem, where = result.problem, None
    layout = layout_of(problem)
    steps = [missing.shift * np.asarray(problem.scales)]
    has = lambda name: name in places and np.any(missing.size[places[name]] != 0)
    if has("lens") or has("radial"):
        corner_q, extents = _seen_corners(result), extents_of(result.data)
        shape = lens_terms(corner_q, extents) @ missing.size[places["lens"]]
        shape = shape + radial_terms(corner_q, extents) @ missing.size[places["radial"]]
        rest, where = _of_lens(result, layout, shape, steps[0])
        steps += rest
    if has("sheet"):
        steps += _of_sheets(result, layout, missing.size[places["sheet"]], steps[0])
    if has("table") or has("axis"):
        steps += _of_motion(result, layout, missing, places)
    return np.stack(steps), where


def _of_lens(
    result: Adjustment, layout: Layout, shape: np.ndarray, imitation: np.ndarray
) -> tuple[list[np.ndarray], str | None]:
    """Steps of a lens that lacks a shape [views, rows], px; the imitation is changed to the part it can follow."""
    problem, linearised = result.problem, result.linearised
    weight = np.repeat(np.asarray(problem.corner_weight), 2, axis=1)
    used = weight > 0
    count = layout.camera.stop
    slopes = linearised.corner_slopes[used] / weight[used][:, None]
    by_camera = slopes[:, :count]
    # The rays of the fitted camera are off by this much [px], rows u and v in turn.
    field = by_camera @ imitation[layout.camera] - shape[used]
    free = np.asarray(problem.scales)[layout.camera]
    followed, _, _, _ = np.linalg.lstsq(by_camera * free, field, rcond=1e-9)
    imitation[layout.camera] = followed * free
    rest = (field - by_camera @ imitation[layout.camera]).reshape(-1, 2)
    steps = []
    for axis, (focal, centre) in enumerate((("fx", "cx"), ("fy", "cy"))):
        size, reach = (np.sqrt(np.mean(np.square(values))) for values in (rest[:, axis], by_camera[axis::2, axis]))
        # A turn of the camera takes up what moves its centre, so the focal length has all of it and the centre half.
        steps += [_one(layout, focal, size / reach), _one(layout, centre, np.sqrt(0.5) * size)]
    centre, half = extents_of(result.data).image
    return steps, _zone((_seen_corners(result)[used[:, ::2]] - centre) / half, field.reshape(-1, 2))


def _seen_corners(result: Adjustment) -> np.ndarray:
    """Where corners should have been seen [views, corners, 2], px."""
    observed = np.asarray(result.problem.corner_q)
    return observed + result.linearised.corner_error.reshape(observed.shape)


def _zone(place: np.ndarray, field: np.ndarray) -> str | None:
    """Where in the image a field is largest, what looks like a turn of the camera (about a shift) taken off."""
    error = np.sum(np.square(field - field.mean(0)), axis=1)
    outer = np.abs(place) > _OUTER
    zones = {
        "in the corners": outer.all(1),
        "at the edges": outer.any(1) & ~outer.all(1),
        "in the middle": np.linalg.norm(place, axis=1) < _OUTER / 2.0,
    }
    sizes = {name: np.sqrt(np.mean(error[inside])) for name, inside in zones.items() if inside.any()}
    name = max(sizes, key=lambda name: sizes[name]) if sizes else None
    return name if name is not None and sizes[name] > _STANDS_OUT * np.sqrt(np.mean(error)) else None


def _of_sheets(result: Adjustment, layout: Layout, size: np.ndarray, imitation: np.ndarray) -> list[np.ndarray]:
    """Steps of sheets that lack terms; the imitation is changed to the part it can follow."""
    problem, linearised = result.problem, result.linearised
    weight, slope = np.asarray(problem.stripe_weight), linearised.slope
    by_q, offset = linearised.by_q, linearised.offset
    square = np.where(slope > 0, slope, 1.0) ** 2
    q = np.asarray(problem.stripe_q) - by_q * (offset / square)[..., None]
    # How far the points of the sheet are from their plane [m] beside the imitation.
    bend = -slope * (sheet_terms(q, problem, extents_of(result.data)) @ size)
    parts = linearised.stripe_slopes / np.where(weight > 0, weight, 1.0)[..., None]
    turns = []
    for laser in range(len(problem.lasers.distance)):
        lit = (weight > 0) & (np.asarray(problem.stripe_laser) == laser)[:, None]
        if not lit.any():
            continue
        # The derivative by the normal is the point itself.
        points = parts[lit][:, -6:-3]
        basis = np.asarray(problem.lasers.basis)[laser]
        own = slice(layout.lasers.start + 5 * laser, layout.lasers.start + 5 * (laser + 1))
        by_sheet = np.concatenate([points @ basis.T, parts[lit][:, -3:]], axis=1)
        free = np.asarray(problem.scales)[own]
        followed, _, _, _ = np.linalg.lstsq(by_sheet * free, bend[lit], rcond=1e-9)
        rest = (bend[lit] - by_sheet @ (followed * free)) / np.linalg.norm(points, axis=1)
        imitation[own] += followed * free
        # A turn about the line across the rays moves all points of the sheet alike, for their distance.
        ahead = points.mean(0) / np.linalg.norm(points.mean(0))
        turn = np.zeros_like(imitation)
        turn[own.start : own.start + 2] = basis @ ahead * np.sqrt(np.mean(np.square(rest)))
        turns.append(turn)
    return turns


def _of_motion(result: Adjustment, layout: Layout, missing: Missing, places: dict[str, np.ndarray]) -> list[np.ndarray]:
    """Steps of a motion that does not go where its model says: along it, and any other way."""
    aside, turns = missing.size[places["axis"]], turn_terms(result.problem, repeated_views(result.problem))
    along, chance = (turns @ part[places["table"]] for part in (missing.size, missing.noise))
    error = np.sqrt(max(np.mean(along**2) - np.mean(np.sum(chance**2, axis=1)), 0.0))
    shift, distance = _shift_aside(result, aside, missing.noise[places["axis"]])
    if isinstance(result.problem.turntable, LinearStage):
        # Errors of places count over a usual travel.
        names = (("gain", error / TRAVEL_M), ("travel.t1", shift / TRAVEL_M), ("travel.t2", shift / TRAVEL_M))
        return [_one(layout, name, float(size)) for name, size in names]
    tilts = (("axis.d1", shift / distance), ("axis.d2", shift / distance))
    return [_one(layout, name, float(size)) for name, size in (("c1", error), ("s1", error), *tilts)]


def _shift_aside(result: Adjustment, size: np.ndarray, noise: np.ndarray) -> tuple[float, float]:
    """Root mean square shift [m] of boards across their line of sight and across the motion, less that of noise.

    Returns:
        The shift, and the distance of the boards [m].
    """
    problem = result.problem
    views = repeated_views(problem)
    pose = result.linearised.view_poses[views]
    middle = np.append(np.asarray(problem.frame)[:2], 0.0)
    point = pose[:, :3, :3] @ middle + pose[:, :3, 3]
    x, y, z = middle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    # Motion of the board's middle in the camera frame by a twist in the board's own axes.
    moved = np.concatenate([pose[:, :3, :3], -pose[:, :3, :3] @ cross], axis=2)
    speed, axis = np.split(np.asarray(problem.turntable.twist()), 2)
    for direction in (speed + np.cross(axis, point), point):
        unit = direction / np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-300)
        moved = moved - unit[:, :, None] * np.einsum("vi,vij->vj", unit, moved)[:, None, :]
    shift = np.einsum("vij,vj->vi", moved, size.reshape(len(views), 6))
    chance = np.einsum("vij,vjk->vik", moved, noise.reshape(len(views), 6, -1))
    mean_square = max(np.sum(shift**2) - np.sum(chance**2), 0.0) / len(views)
    return float(np.sqrt(mean_square)), float(np.sqrt(np.mean(np.sum(point**2, axis=1))))


def _one(layout: Layout, name: str, size: float) -> np.ndarray:
    """A step of one parameter."""
    return size * (np.array(layout.names) == name)
