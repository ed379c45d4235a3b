"""One pair of frames: the light that arrives, and the codes that the sensor makes of it."""

from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np

from jaxscan.simulation.boards import Cover, SeenBoard, cover
from jaxscan.simulation.camera import (
    Blur,
    channels,
    dimmed,
    expose,
    flawed,
    laser_response,
    lens_blur,
    mosaic,
    softened,
    vignette,
)
from jaxscan.simulation.light import (
    ON_BOARD,
    LitSamples,
    LitScene,
    RowTruth,
    laser_channel,
    laser_image,
    line_pieces,
    lit_samples,
    lobe,
    mirrored_samples,
    returned_field,
    row_truth,
    speckle_light,
)
from jaxscan.simulation.rig import WALL_ALBEDO, Motion, Sheet, TrueRig
from jaxscan.simulation.scene import Scene
from jaxscan.simulation.settings import SimulationConfig
from jaxscan.simulation.view import View, observe, points_at


_STRIP = 64
"""Rows evaluated at a time: their numbers stay in the processor's cache."""


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
    samples: tuple[LitSamples, ...] = ()
    """The laser's light before the lens, where it has speckle: the stripe, and its images in mirrors."""


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
    on = take_frame(_flickered(record.off, config, rng) + laser, config, rng)
    off = take_frame(_flickered(record.off, config, rng), config, rng)
    return RenderedRecord(record.angle, record.placement, on, off, record.truth, record.laser_index)


def _flickered(light: np.ndarray, config: SimulationConfig, rng: np.random.Generator) -> np.ndarray:
    """The room's light in one frame."""
    flicker = config.light.flicker
    return light if flicker == 0 else light * np.float32(max(0.0, 1 + flicker * rng.standard_normal()))


def take_frame(light: np.ndarray, config: SimulationConfig, rng: np.random.Generator) -> np.ndarray:
    """An exposure by the camera's own pixels, as the camera hands it out.

    Args:
        light: Linear light in DN, float32 [rows, columns] (rgb8: and 3).
        config: The camera.
        rng: Source of the noise.

    Returns:
        uint8 of the same shape.
    """
    image = expose(flawed(light, config), config.sensor, rng)
    if config.sensor.jpeg_quality is None:
        return image
    # Imported here, so that a simulation without JPEGs does not load OpenCV.
    from jaxscan.vision import through_jpeg

    return through_jpeg(image, config.sensor.jpeg_quality)


def speckled(record: ExpectedRecord, config: SimulationConfig, rng: np.random.Generator) -> np.ndarray:
    """The laser's light of a record with a pattern of speckle of its own; of the shape of `record.laser`."""
    sensor, spec = config.sensor, config.laser[record.laser_index]
    if not record.samples:
        return record.laser
    grain = spec.grain_px(sensor)
    change = sum(speckle_light(samples, grain, spec.speckle_contrast, rng) for samples in record.samples)
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
    """One pair of frames where the table stops when it is sent to `phi` [rad], without noise."""
    stood = rig.stood(phi, placement)
    config, sensor, sheet = rig.config, rig.config.sensor, rig.sheets[laser]
    pose, sees = rig.pose(stood), rig.rays.sees
    shot = LitScene(rig, sheet, scene, pose, None)
    room, behind, ambient = _surroundings(rig, scene, stood, laser if config.light.bounce > 0 else None)
    white = config.light.white_dn if board is None else config.boards.white_dn
    lens, off = behind, ambient * np.float32(white)
    scale, depth, front, facet_at = 1.0, room.depth, None, room.facet_at
    if board is not None:
        in_front = _in_view(rig, board.hit(rig.rays.x, rig.rays.y, rig.rays.z)[0])
        depth, facet_at = np.minimum(depth, in_front), partial(_facet_at, room, *_alone(room.depth, in_front))
        lens = lens_blur(config, depth)
        front = cover(rig, board, in_front, lens)
        where, fills, albedo, board = front
        light, shine = (part * np.float32(white) for part in _board_light(rig, scene, pose, board, where))
        off[:, *where] = off[:, *where] * (1 - fills) + albedo * light + fills * shine
        scale = _board_power(rig, sheet, in_front)
    shot = shot._replace(board=board)
    samples = lit_samples(shot, depth, lens, facet_at)
    glow: np.ndarray = laser_image(samples) * np.float32(scale)
    truth_glow, shade = glow, vignette(config)
    mirrored = mirrored_samples(shot, scene.mirror[room.triangle] > 0, depth, lens)
    for part in mirrored:
        glow = glow + laser_image(part) * np.float32(scale)
    if config.light.bounce > 0:
        glow = glow + _returned(shot, room, behind, depth, front) * np.float32(scale * config.light.bounce)
    if sees is not None:
        # Nothing comes through the lens from beyond its field of view.
        off, glow, truth_glow = off * sees, glow * sees, truth_glow * sees
    truth = row_truth(shot, depth, dimmed(truth_glow, shade))
    lit = dimmed(glow, shade) * laser_response(sensor, sheet.spec.colour)[:, None, None]
    frames = mosaic(dimmed(off, shade), sensor.pixel_format), mosaic(lit, sensor.pixel_format)
    kept: list[LitSamples] = []
    for part in (samples, *mirrored):
        if sheet.spec.speckle_contrast > 0:
            light = dimmed(part.light * np.float32(scale), shade, (part.rows, part.columns))
            kept.append(part._replace(light=light))
    return ExpectedRecord(phi, placement, *frames, truth, laser, tuple(kept))


@lru_cache(maxsize=2)
def _surroundings(rig: TrueRig, scene: Scene, phi: float, laser: int | None) -> tuple[View, Blur, np.ndarray]:
    """What every pixel sees without a board, the lens's blur there, and the picture of `_ambient`.

    The last two are kept: many boards are shown at one angle, and every laser at each. With a `laser`, whose light
    comes back from the surroundings, the albedos for it are there too.
    """
    pose = rig.pose(phi)
    further = None if laser is None else laser_channel(rig.sheets[laser])
    room = observe(rig, scene, pose, channels(rig.config.sensor), further)
    room = room._replace(depth=_in_view(rig, room.depth))
    lens = lens_blur(rig.config, room.depth)
    return room, lens, _ambient(rig, scene, pose, room, lens)


def _alone(depth: np.ndarray, board: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels that show the scene alone, and those that show a board alone, also round their centres; bool.

    Args:
        depth: Of the scene in every pixel [height, width].
        board: Of the board.
    """
    return _around(np.isinf(board)), _around(board * np.float32(1.01) < depth)


def _around(true: np.ndarray) -> np.ndarray:
    """Where something is true of a pixel and of all its neighbours, bool [height, width]."""
    rows = true.copy()
    rows[1:] &= true[:-1]
    rows[:-1] &= true[1:]
    out = rows.copy()
    out[:, 1:] &= rows[:, :-1]
    out[:, :-1] &= rows[:, 1:]
    return out


def _facet_at(
    room: View, scene_alone: np.ndarray, board_alone: np.ndarray, rows: np.ndarray, columns: np.ndarray
) -> np.ndarray:
    """As `View.facet_at`, with a board in front."""
    facet = room.facet_at(rows, columns)
    on_board = np.where(board_alone[rows, columns] & (facet >= 0), ON_BOARD, -1)
    return np.where(scene_alone[rows, columns], facet, on_board)


def _in_view(rig: TrueRig, depth: np.ndarray) -> np.ndarray:
    return depth if rig.rays.sees is None else np.where(rig.rays.sees, depth, np.float32(np.inf))


def _ambient(rig: TrueRig, scene: Scene, pose: Motion, room: View, lens: Blur) -> np.ndarray:
    """The scene in its own light through the lens, float32 [channels, height, width]; 1 is white."""
    image = room.ambient
    hit = np.isfinite(room.depth)
    if not hit.all():
        image = image * hit
    glass = scene.mirror[room.triangle] if scene.mirror.any() else scene.mirror
    if glass.any():
        rows, columns = np.nonzero(glass)
        triangle, points = room.triangle[rows, columns], points_at(rig, pose, room.depth, (rows, columns))
        _, behind, places = scene.reflect(pose.translation, points, triangle)
        # Surfaces are seen from the camera's own picture in the mirror.
        normal = scene.normal[triangle[0]]
        view = pose.translation - 2 * ((pose.translation - points[0]) @ normal) * normal
        light = scene.ambient(behind[None], places[None], view, channels(rig.config.sensor))[:, 0]
        image[:, rows, columns] += glass[rows, columns] * light
    return softened(image, lens)


def _returned(shot: LitScene, room: View, lens: Blur, depth: np.ndarray, front: Cover | None) -> np.ndarray:
    """The laser's light that comes back from the surfaces it lights, through the lens, float32 [height, width], DN."""
    rig, scene, pose = shot.rig, shot.scene, shot.pose
    field = returned_field(shot, line_pieces(shot), partial(points_at, rig, pose, depth))
    image = np.empty_like(room.depth)
    normal = [np.ascontiguousarray(part) for part in scene.facing(pose.translation).T]
    for start in range(0, len(image), _STRIP):
        part = np.s_[start : start + _STRIP]
        strength = sum(along[part] * way.take(room.triangle[part]) for along, way in zip(field, normal, strict=True))
        image[part] = np.maximum(strength, 0) * room.albedo[0, part]
    image = softened(image, lens)
    if front is not None and shot.board is not None:
        where, fills, albedo, _ = front
        facing = (pose.rotation @ shot.board.normal()).astype(np.float32)
        image[where] = image[where] * (1 - fills) + albedo * np.maximum(
            np.einsum("irc,i->rc", field[:, *where], facing), 0
        )
    return image


def _board_light(
    rig: TrueRig, scene: Scene, pose: Motion, board: SeenBoard, where: tuple[slice, slice]
) -> tuple[np.ndarray, np.ndarray | np.float32]:
    """The room's light on the board's plane at pixel centres, and that in its gloss, float32 [rows, columns]."""
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

    asked = spec.peak_dn / spec.paper / (laser.peak_dn / WALL_ALBEDO)
    return asked * strength(laser.range_m) / strength(float(np.median(seen)))
