"""The laser's light on a facet: depth, distance from the sheet and angle in the fan follow from its plane."""

import math

import numpy as np

from jaxscan.simulation.light.fan import across, along, band, widened
from jaxscan.simulation.light.lit import LitScene, laser_channel
from jaxscan.simulation.light.open import FanView
from jaxscan.simulation.scene import Plane, Rays


def light_on(shot: LitScene, plane: Plane, rays: Rays, fan: FanView) -> np.ndarray:
    """Light of the laser seen along rays that meet a plane before anything else, behind a board or beside it.

    Args:
        shot: The scene and its laser.
        plane: The plane.
        rays: Of the samples of some pixels [pixels, samples].
        fan: The edges in the laser's way.

    Returns:
        float32 [pixels, samples], DN on a pixel filled with it; as `illuminate`.
    """
    f, sheet = np.float32, shot.sheet
    light = np.zeros(rays.x.shape, np.float32)
    height = float(plane.normal @ shot.pose.apply(sheet.origin)) - plane.offset
    if height <= 0:
        return light
    depth = plane.depth(rays)
    # The way from the laser: along the middle of the fan, across it, and out of the sheet.
    ahead, aside, out = (
        depth * rays.along(axis) - f(axis @ sheet.origin) for axis in (sheet.ahead, sheet.across, sheet.normal)
    )
    r2 = ahead * ahead
    r2 += aside * aside
    r2 += out * out
    r = np.sqrt(r2, out=r2)
    thick = f(band(sheet) * (1 + sheet.spec.widening)) * sheet.thickness(r)
    at = np.flatnonzero(np.abs(out) < thick + f(sheet.bulge) * depth)
    ahead, aside, out, r, depth = (part.ravel()[at] for part in (ahead, aside, out, r, depth))
    some = rays.ravel().at(at)
    beside = out if sheet.spec.bow == (0.0, 0.0) else depth * sheet.slope_at(*some.whole()) - f(sheet.distance)
    angle = np.arctan2(aside, ahead)
    thickness = sheet.thickness(r) * widened(sheet, angle)
    power = along(sheet, angle)
    inside = np.flatnonzero((np.abs(beside) < f(band(sheet)) * thickness) & (power > 0))
    at, some, depth = at[inside], some.at(inside), depth[inside]
    open_ = np.flatnonzero(_open(shot, plane, fan, at // rays.x.shape[-1], (some, depth, angle[inside], r[inside])))
    if shot.board is not None:
        points = np.stack([part * depth[open_] for part in np.broadcast_arrays(*some.at(open_).whole())], -1)
        open_ = open_[~shot.board.blocks(sheet.origin, points)]
    inside, some, depth = inside[open_], some.at(open_), depth[open_]
    beside, r, thickness, power = beside[inside], r[inside], thickness[inside], power[inside]
    energy = f(sheet.power / math.sqrt(2 * math.pi) * height) / (r * r * thickness)
    (albedo,) = plane.albedo(some, depth, laser_channel(shot.sheet))
    light.ravel()[at[open_]] = energy * power * across(sheet, beside / thickness) * albedo
    return light


def _open(
    shot: LitScene,
    plane: Plane,
    fan: FanView,
    pixel: np.ndarray,
    points: tuple[Rays, np.ndarray, np.ndarray, np.ndarray],
) -> np.ndarray:
    """Whether nothing stands between the laser and points of a plane, bool [n].

    Args:
        shot: The scene and its laser.
        plane: The plane.
        fan: The edges in the laser's way.
        pixel: Number of each point's pixel, in order. One point of a pixel stands for all where no shadow can end.
        points: Their rays, depths, angles in the fan and distances from the laser.
    """
    rays, depth, angle, far = points
    if len(pixel) == 0:
        return np.zeros(0, bool)
    starts = np.flatnonzero(np.diff(pixel, prepend=-1))
    low, high = np.minimum.reduceat(angle, starts), np.maximum.reduceat(angle, starts)
    clear = fan.clear(low, high, np.maximum.reduceat(far, starts))
    counts = np.diff(starts, append=len(pixel))
    cast = ~clear.repeat(counts)
    cast[starts[clear]] = True
    found = np.zeros(len(pixel), bool)
    at = np.flatnonzero(cast)
    found[at] = ~shot.scene.blocked(shot.pose.apply(shot.sheet.origin), plane.points(rays.at(at), depth[at]))
    return np.where(clear.repeat(counts), found[starts].repeat(counts), found)
