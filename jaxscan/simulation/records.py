"""One pair of frames: what the camera is to see, and what its sensor makes of it."""

from typing import NamedTuple

import numpy as np

from jaxscan.simulation.boards import SeenBoard, cover
from jaxscan.simulation.camera import (
    blur,
    blurred,
    channels,
    dimmed,
    expose,
    flawed,
    laser_response,
    lens_blur,
    mosaic,
    vignette,
)
from jaxscan.simulation.light import (
    LitSamples,
    LitScene,
    RowTruth,
    laser_image,
    lit_samples,
    lobe,
    row_truth,
    speckle_light,
)
from jaxscan.simulation.rig import WALL_ALBEDO, Motion, Sheet, TrueRig
from jaxscan.simulation.scene import Scene
from jaxscan.simulation.settings import SimulationConfig


class ExpectedRecord(NamedTuple):
    """A pair of frames before the sensor: linear light in DN, without noise."""

    angle: float
    """The table's own count [rad]."""
    placement: int | None
    """Which placement of the board; None for free views and sweeps."""
    off: np.ndarray
    """The room's light, float32 [rows, columns] (rgb8: and 3)."""
    laser: np.ndarray
    """The laser's light, of the same shape: the laser-on frame expects `off + laser`."""
    truth: RowTruth
    laser_index: int
    samples: LitSamples | None = None
    """The laser's light before the lens, where it has speckle."""


class RenderedRecord(NamedTuple):
    """A pair of frames, and the truth for comparison."""

    angle: float
    """The table's own count [rad]."""
    placement: int | None
    on: np.ndarray
    """uint8 [rows, columns] (rgb8: and 3)."""
    off: np.ndarray
    truth: RowTruth
    laser_index: int = 0


def develop(record: ExpectedRecord, config: SimulationConfig, rng: np.random.Generator) -> RenderedRecord:
    """Expose both frames of a record, each with its own noise."""
    laser = speckled(record, config, rng)
    on = _frame(_flickered(record.off, config, rng) + laser, config, rng)
    off = _frame(_flickered(record.off, config, rng), config, rng)
    return RenderedRecord(record.angle, record.placement, on, off, record.truth, record.laser_index)


def _flickered(light: np.ndarray, config: SimulationConfig, rng: np.random.Generator) -> np.ndarray:
    """The room's light in one frame."""
    flicker = config.light.flicker
    return light if flicker == 0 else light * np.float32(max(0.0, 1 + flicker * rng.standard_normal()))


def _frame(light: np.ndarray, config: SimulationConfig, rng: np.random.Generator) -> np.ndarray:
    """An exposure by the camera's own pixels."""
    return expose(flawed(light, config), config.sensor, rng)


def speckled(record: ExpectedRecord, config: SimulationConfig, rng: np.random.Generator) -> np.ndarray:
    """The laser's light of a record with a pattern of speckle of its own; of the shape of `record.laser`."""
    sensor, spec = config.sensor, config.laser[record.laser_index]
    if record.samples is None:
        return record.laser
    change = speckle_light(record.samples, spec.grain_px(sensor), spec.speckle_contrast, rng)
    change = mosaic(change * laser_response(sensor, spec.colour)[:, None, None], sensor.pixel_format)
    return np.where(record.laser > 0, np.maximum(record.laser + change, 0), np.float32(0))


def expect_record(
    rig: TrueRig,
    scene: Scene,
    phi: float,
    *,
    laser: int = 0,
    board: SeenBoard | None = None,
    placement: int | None = None,
) -> ExpectedRecord:
    """One pair of frames at the table's angle `phi` [rad], without noise."""
    config, sensor, sheet = rig.config, rig.config.sensor, rig.sheets[laser]
    pose, sees = rig.pose(phi), rig.rays.sees
    rays = pose.turn(rig.rays.vectors)

    def in_view(depth: np.ndarray) -> np.ndarray:
        return depth if sees is None else np.where(sees, depth, np.float32(np.inf))

    depth, triangle = (part.reshape(rig.rays.shape) for part in scene.cast(pose.translation, rays))
    depth = in_view(depth)
    white = config.light.white_dn if board is None else config.boards.white_dn
    off = _ambient(rig, scene, pose, rays, depth, triangle) * np.float32(white)
    scale, sharp = 1.0, lens_blur(config, depth)
    if board is not None:
        in_front = in_view(board.hit(rig.rays.x, rig.rays.y, rig.rays.z)[0])
        depth = np.minimum(depth, in_front)
        sharp = lens_blur(config, depth)
        where, fills, albedo, board = cover(rig, board, in_front, sharp)
        light, shine = (part * np.float32(white) for part in _board_light(rig, scene, pose, board, where))
        off[:, *where] = off[:, *where] * (1 - fills) + albedo * light + fills * shine
        scale = _board_power(rig, sheet, in_front)
    shot = LitScene(rig, sheet, scene, pose, board)
    samples = lit_samples(shot, depth, sharp)
    glow = laser_image(samples) * np.float32(scale)
    if sees is not None:
        # Nothing comes through the lens from beyond its field of view.
        off, glow = off * sees, glow * sees
    shade = vignette(config)
    off, glow = dimmed(off, shade), dimmed(glow, shade)
    truth = row_truth(shot, depth, glow)
    lit = glow * laser_response(sensor, sheet.spec.colour)[:, None, None]
    frames = mosaic(off, sensor.pixel_format), mosaic(lit, sensor.pixel_format)
    kept = None
    if sheet.spec.speckle_contrast > 0:
        light = dimmed(samples.light * np.float32(scale), shade, (samples.rows, samples.columns))
        kept = samples._replace(light=light)
    return ExpectedRecord(phi, placement, *frames, truth, laser, kept)


def _ambient(
    rig: TrueRig, scene: Scene, pose: Motion, rays: np.ndarray, depth: np.ndarray, triangle: np.ndarray
) -> np.ndarray:
    """The scene in its own light through the lens, float32 [channels, height, width]; 1 is white."""
    hit = np.isfinite(depth)
    points = rays * np.where(hit, depth, np.float32(0)).reshape(-1, 1) + pose.translation.astype(np.float32)
    image = scene.ambient(triangle, points.reshape(*hit.shape, 3), pose.translation, channels(rig.config.sensor))
    if not hit.all():
        image *= hit
    return blurred(lambda psf: blur(image, psf), lens_blur(rig.config, depth))


def _board_light(
    rig: TrueRig, scene: Scene, pose: Motion, board: SeenBoard, where: tuple[slice, slice]
) -> tuple[np.ndarray, np.ndarray | np.float32]:
    """The room's light on the board's plane at pixel centres, and what its gloss reflects, float32 [rows, columns]."""
    rays = rig.rays.at(*where)
    r2 = board.board_from_camera.rotation[2].astype(np.float32)
    depth = np.float32(-board.board_from_camera.translation[2]) / (r2[0] * rays.x + r2[1] * rays.y + r2[2] * rays.z)
    points = pose.apply(np.stack([rays.x * depth, rays.y * depth, rays.z * depth], -1))
    normal = np.broadcast_to((pose.rotation @ board.normal()).astype(np.float32), points.shape)
    light = scene.light(points, normal, pose.translation)
    picture = board.picture
    if picture.gloss == 0:
        return light, np.float32(0)
    lamp, eye = (place.astype(np.float32) - points for place in (scene.lamp, pose.translation))
    shine = np.float32(picture.gloss) * lobe(lamp, eye, normal, picture.gloss_rad)
    return light, shine * scene.lamp_light(points)


def _board_power(rig: TrueRig, sheet: Sheet, depth: np.ndarray) -> float:
    """Factor on the laser's power that makes its stripe on the board as bright as wanted."""
    spec, laser = rig.config.boards, sheet.spec
    seen = depth[np.isfinite(depth)]
    if not len(seen):
        return 1.0
    psf2 = rig.config.sensor.psf_px**2 + 1 / 12

    def strength(r: float) -> float:
        width_px = float(sheet.thickness(np.array([r]))[0]) * rig.config.camera.fx / r
        # Light per metre of stripe, on pixels of r / f, spread over the seen width.
        return 1 / np.sqrt(width_px**2 + psf2) * rig.config.camera.fx / r**2

    return (
        spec.peak_dn
        / spec.paper
        / (laser.peak_dn / WALL_ALBEDO)
        * strength(laser.range_m)
        / strength(float(np.median(seen)))
    )
