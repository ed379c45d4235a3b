"""Why a calibration is not updated: one sentence each, with the finding, the expectation and the remedy."""

import numpy as np

from jaxscan.recalibration.adjusted import Adjusted
from jaxscan.recalibration.judge.compared import Compared
from jaxscan.recalibration.observed import Surfaces
from jaxscan.recalibration.result import Drift, HoldOut
from jaxscan.recalibration.settings import RecalibrationSettings


# Residuals this much larger than stated, in variance, are of something that is not in the model.
_BELIEVABLE = 3.0
# No wall that anybody calls flat is rougher and more uneven [m].
_ROUGHEST_M = 5e-3
# Planes whose normals are nearer than this have one direction.
_SAME_DIRECTION = np.cos(np.radians(15.0))
_LEAST_DIRECTIONS = 2


def refuse_result(
    adjusted: Adjusted,
    compared: Compared,
    drift: Drift,
    held_out: HoldOut | None,
    settings: RecalibrationSettings,
) -> str:
    """The first reason not to update; empty where there is none."""
    best = float(np.max(compared.factor, initial=1.0))
    directions = count_directions(adjusted.surfaces)
    others = adjusted.observations.tracks is not None or adjusted.observations.boards is not None
    if not adjusted.converged:
        return (
            f"the adjustment did not settle in {adjusted.steps} steps; check that the sweeps are of this rig and of "
            "one room that stood still"
        )
    if directions < _LEAST_DIRECTIONS and not others:
        return (
            f"the planes found face {directions} direction{'s' if directions != 1 else ''}, expected at least "
            f"{_LEAST_DIRECTIONS}, better 3 (two walls and the floor): sweep more of the room"
        )
    if (ratio := adjusted.cost / max(adjusted.freedom, 1)) > _BELIEVABLE or adjusted.wall_m > _ROUGHEST_M:
        return (
            f"the walls do not fit: residuals are {np.sqrt(ratio):.1f} times as large as stated and the walls are "
            f"rough to {1e3 * adjusted.wall_m:.1f} mm, worst {_worst_surfaces(adjusted)}; check that nothing moved "
            "during the sweep and that the calibration is of this rig"
        )
    if held_out is not None and not held_out.better:
        before, after = np.mean(held_out.before_mm), np.mean(held_out.after_mm)
        return (
            f"planes that were not used became less flat ({before:.2f} mm before, {after:.2f} mm after), expected "
            "flatter ones: the walls are not flat enough, or something moved; sweep another room"
        )
    if best < settings.least_gain and not drift.drifted:
        return (
            f"nothing was gained: the best direction is known {best:.2f} times as well as before, expected at least "
            f"{settings.least_gain:g} times; the stored calibration is as good as these sweeps"
        )
    return ""


def count_directions(surfaces: Surfaces) -> int:
    """In how many directions planes face; opposite walls count once."""
    found: list[np.ndarray] = []
    for kind, normal in zip(surfaces.kind, surfaces.normal, strict=True):
        if kind == "plane" and all(abs(normal @ other) < _SAME_DIRECTION for other in found):
            found.append(normal)
    return len(found)


def _worst_surfaces(adjusted: Adjusted) -> str:
    """The surfaces whose points are farthest off, by their directions and distances."""
    points, kept = adjusted.observations.points, adjusted.point_kept
    own = points.surface[kept]
    square = np.bincount(own, adjusted.point_error[kept] ** 2, minlength=len(adjusted.surfaces.kind))
    rms = np.sqrt(square / np.maximum(np.bincount(own, minlength=len(square)), 1))
    order = np.argsort(-rms)[:2]
    return " and ".join(f"{describe_surface(adjusted.surfaces, int(k))} ({1e3 * rms[k]:.1f} mm)" for k in order)


def describe_surface(surfaces: Surfaces, number: int) -> str:
    """A surface in words: "the floor", "a wall at 2.1 m towards 35 degrees"."""
    if surfaces.kind[number] == "sphere":
        return f"the sphere of {2e3 * surfaces.distance[number]:.0f} mm"
    normal, distance = surfaces.normal[number], float(surfaces.distance[number])
    away = normal * np.sign(distance) if distance else normal
    if abs(away[2]) > _SAME_DIRECTION:
        return f"the {'ceiling' if away[2] > 0 else 'floor'} at {abs(distance):.2f} m"
    if abs(away[2]) > np.sin(np.radians(15.0)):
        return f"an inclined plane at {abs(distance):.2f} m"
    return f"the wall at {abs(distance):.2f} m towards {np.degrees(np.arctan2(away[1], away[0])):.0f} degrees"
