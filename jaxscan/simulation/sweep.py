"""Records of sweeps and boards: planned, rendered, developed, and their truth."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache, partial
from itertools import islice
from typing import Any, NamedTuple, TypeVar

import numpy as np

from jaxscan.errors import ConfigError
from jaxscan.geometry import CAMERAS, LaserSheet, Scanner, Turntable, stack_lasers
from jaxscan.geometry.scanner import UP_VECTORS
from jaxscan.simulation.boards import Cover, SeenBoard, cover, make_print
from jaxscan.simulation.camera import (
    Blur,
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
from jaxscan.simulation.rig import WALL_ALBEDO, Motion, Sheet, TrueRig, make_rig, project, rodrigues
from jaxscan.simulation.scene import Scene, make_scene, room_from_scanner
from jaxscan.simulation.settings import BoardsSpec, CameraSpec, RoomSpec, SimulationConfig, TurntableSpec
from jaxscan.simulation.view import SceneView, observe, points_at


def true_scanner(config: SimulationConfig) -> Scanner:
    """The scanner of a perfect calibration of this rig, without covariance."""
    table = config.turntable
    sheets = []
    for laser in config.laser:
        flat = LaserSheet.from_plane(*laser.plane())
        sheets.append(LaserSheet(flat.normal, flat.distance, np.array(laser.bow), flat.basis))
    camera = config.camera
    fx, fy, cx, cy = (np.asarray(value) for value in (camera.fx, camera.fy, *camera.centre()))
    lens = np.array(list(camera.coefficients().values()))
    axis = _axis(table).pointed(np.array(UP_VECTORS[camera.up]))
    turntable = Turntable(
        axis.direction, axis.point, np.asarray(table.gain), np.array(table.harmonics), axis.basis, table.carries
    )
    return Scanner(
        camera=CAMERAS[camera.model](fx, fy, cx, cy, lens, camera.width, camera.height),
        lasers=stack_lasers(sheets),
        turntable=turntable,
        laser_names=tuple(laser.name for laser in config.laser),
        up=camera.up,
    )


def truth(config: SimulationConfig) -> dict[str, Any]:
    """The truth as a dictionary ready for JSON, format "jaxscan-truth/1".

    Holds the scanner's parameters by the names of `Scanner.parameter_names()` (those of a
    direction are 0 by definition, so directions are given whole), and, for a room, its size, its
    wall planes `normal . p = distance` in the scanner frame (normals into the room) and a few
    lengths.
    """
    rig = make_rig(config)
    scanner = true_scanner(config)
    lasers = [
        {
            "name": sheet.spec.name,
            "normal": _plain(sheet.normal),
            "distance_m": sheet.distance,
            "bow": list(sheet.spec.bow),
        }
        for sheet in rig.sheets
    ]
    out: dict[str, Any] = {
        "format": "jaxscan-truth/1",
        "seed": config.seed,
        "parameters": dict(zip(scanner.parameter_names(), _plain(scanner.values()), strict=True)),
        "lasers": lasers,
        "turntable": {
            "carries": config.turntable.carries,
            "direction": _plain(rig.direction),
            "point_m": _plain(rig.point),
            "gain": config.turntable.gain,
            "harmonics": list(config.turntable.harmonics),
        },
    }
    if config.room is not None:
        room, motion = config.room, room_from_scanner(config)
        out["room"] = {
            "size_m": list(room.size_m),
            "planes": _planes(room, motion),
            "distances": _distances(room, motion.inverse()),
        }
    return out


def _axis(spec: TurntableSpec) -> Turntable:
    if spec.tr is None:
        return Turntable.from_axis(np.array(spec.direction), np.array(spec.point_m))
    tr = np.array(spec.tr)
    tr[:3, 3] /= 1000
    return Turntable.from_tr(tr)


def _planes(room: RoomSpec, motion: Motion) -> list[dict[str, Any]]:
    """Walls, floor and ceiling, by the motion from the scanner to the room."""
    planes = []
    for axis, (low, high) in enumerate((("wall x0", "wall x1"), ("wall y0", "wall y1"), ("floor", "ceiling"))):
        for name, sign, at in ((low, 1.0, 0.0), (high, -1.0, room.size_m[axis])):
            normal = np.zeros(3)
            normal[axis] = sign
            # n . (R p + t) = sign at
            distance = sign * at - normal @ motion.translation
            planes.append({"name": name, "normal": _plain(motion.rotation.T @ normal), "distance_m": float(distance)})
    return planes


def _distances(room: RoomSpec, motion: Motion) -> list[dict[str, Any]]:
    """Lengths between points in the scanner frame, by the motion from the room to the scanner."""
    x, y, z = room.size_m
    pairs = {
        "length along x": ((0, y / 2, z / 2), (x, y / 2, z / 2)),
        "length along y": ((x / 2, 0, z / 2), (x / 2, y, z / 2)),
        "height": ((x / 2, y / 2, 0), (x / 2, y / 2, z)),
        "diagonal of the floor": ((0, 0, 0), (x, y, 0)),
    }
    return [
        {
            "name": name,
            "from_m": _plain(motion.apply(np.array(a, float))),
            "to_m": _plain(motion.apply(np.array(b, float))),
            "distance_m": float(np.linalg.norm(np.subtract(a, b))),
        }
        for name, (a, b) in pairs.items()
    ]


def _plain(value: Any) -> Any:
    return np.asarray(value, np.float64).tolist()


# Plans the poses of the board as a careful person holds it: spread over the image, tilted, across the stripe.
#
# The person sees a preview, so this code may use the true rig.


class Placement(NamedTuple):
    """One board pose and the table angles from which it is seen."""

    scanner_from_board: Motion
    angles: tuple[float, ...]
    """[rad], as commanded."""
    number: int | None
    """Number of the placement; None for a free view."""


_MARGIN_PX = 6.0
_CLEARANCE = 0.03
_CHOICES = 6
"""Sound poses from which the one is chosen that shows the board in the least used part of the image."""
_TRIES = 2000


def plan_boards(rig: TrueRig, scene: Scene, rng: np.random.Generator) -> list[Placement]:
    """Free views at angle 0, then placements seen from several angles.

    Raises:
        ConfigError: If the board does not fit into the image or the scene in the wanted ranges.
    """
    spec = rig.config.boards
    seen = np.zeros((6, 8))
    plan = []
    for number in range(spec.free_views):
        # The lens must be known also where no stripe ever runs.
        crossed = number % 3 < 2
        share = _share(number, spec.free_views)
        choices = [_pose(rig, scene, rng, share, turns=1, crossed=crossed)[0] for _ in range(_CHOICES)]
        # The pose whose corners are where few have been.
        pose = max(choices, key=lambda pose: float((_cells(rig, pose) / (1 + seen) ** 2).sum()))
        seen += _cells(rig, pose)
        plan.append(Placement(rig.pose(0.0) @ pose, (0.0,), None))
    for number in range(spec.placements):
        pose, angles = _pose(rig, scene, rng, _share(number, spec.placements), turns=spec.angles)
        plan.append(Placement(rig.pose(0.0) @ pose, angles, number))
    return plan


def _share(number: int, count: int) -> tuple[float, float]:
    """The number-th of `count` equal parts, in an order that mixes near and far."""
    order = sorted(range(count), key=lambda k: (k * 0.618034) % 1)
    return order[number] / count, (order[number] + 1) / count


def _pose(
    rig: TrueRig,
    scene: Scene,
    rng: np.random.Generator,
    share: tuple[float, float],
    *,
    turns: int,
    crossed: bool = True,
) -> tuple[Motion, tuple[float, ...]]:
    """A sound pose T_cam_board at angle 0 with its range in a share of the wanted one."""
    spec = rig.config.boards
    near, far = np.log(spec.range_m)
    for attempt in range(_TRIES):
        # Where a share of the range has no sound pose, the whole range is tried.
        low, high = share if attempt < _TRIES // 2 else (0.0, 1.0)
        distance = float(np.exp(near + (far - near) * rng.uniform(low, high)))
        pose = _draw(rig, rng, distance, crossed=crossed)
        if not _sees(rig, pose) or not _faces(pose) or (crossed and not _crossed(rig, pose)):
            continue
        angles = (0.0,) if turns == 1 else _turns(rig, pose, turns)
        if len(angles) == turns and all(_clear(rig, scene, pose, phi) for phi in angles):
            return pose, angles
    raise ConfigError(
        f"No pose of the board ({spec.columns} x {spec.rows}, {spec.square_mm} mm) was found within "
        f"{list(spec.range_m)} m that the camera sees and the laser crosses: change [boards] range_m, the board's "
        "size, or the room."
    )


def _draw(rig: TrueRig, rng: np.random.Generator, distance: float, *, crossed: bool) -> Motion:
    """A random pose with its middle at the given depth: beside a sheet, or anywhere in the image."""
    camera, spec = rig.config.camera, rig.config.boards
    sheet = rig.sheets[int(rng.integers(len(rig.sheets)))]
    outline = _outline(spec)
    size = np.ptp(outline, axis=0)
    axis = rng.uniform(0, 2 * np.pi)
    tilt = np.deg2rad(rng.uniform(*spec.tilt_deg))
    rotation = rodrigues(np.array([np.cos(axis), np.sin(axis), 0.0]), tilt)
    rotation = rotation @ rodrigues(np.array([0.0, 0.0, 1.0]), np.deg2rad(rng.uniform(-20, 20)))
    middle = np.append(outline.mean(0), 0.0)
    if camera.wide:
        place = _place_around(camera, sheet if crossed else None, rng, distance, size)
        rotation = _facing(place) @ rotation
        return Motion(rotation, place - rotation @ middle)
    x = rng.uniform(-0.5, 0.5) * distance * camera.width / camera.fx
    y = rng.uniform(-0.5, 0.5) * distance * camera.height / camera.fy
    n = sheet.normal
    if crossed and sheet.spec.stripe_axis == "rows":
        x = (sheet.distance - n[2] * distance - n[1] * y) / n[0] + rng.uniform(-0.4, 0.4) * size[0]
    elif crossed:
        y = (sheet.distance - n[2] * distance - n[0] * x) / n[1] + rng.uniform(-0.4, 0.4) * size[1]
    return Motion(rotation, np.array([x, y, distance]) - rotation @ middle)


def _place_around(
    camera: CameraSpec, sheet: Sheet | None, rng: np.random.Generator, distance: float, size: np.ndarray
) -> np.ndarray:
    """A place [3] at the given distance within the field of view of a wide-angle lens: beside a sheet, or anywhere."""
    if sheet is None:
        theta = np.deg2rad(camera.field_deg / 2) * np.sqrt(rng.uniform())
        psi = rng.uniform(0, 2 * np.pi)
        return distance * np.array([np.sin(theta) * np.cos(psi), np.sin(theta) * np.sin(psi), np.cos(theta)])
    half = np.deg2rad(min(sheet.spec.fan_deg, camera.field_deg) / 2)
    tau = rng.uniform(-half, half)
    along = np.sqrt(max(distance**2 - sheet.distance**2, 0.0))
    aside = rng.uniform(-0.4, 0.4) * size[0 if sheet.spec.stripe_axis == "rows" else 1]
    ahead = np.cos(tau) * sheet.ahead + np.sin(tau) * sheet.across
    return (sheet.distance + aside) * sheet.normal + along * ahead


def _facing(place: np.ndarray) -> np.ndarray:
    """The least rotation that turns z towards a place."""
    axis = np.cross([0.0, 0.0, 1.0], place)
    length = float(np.linalg.norm(axis))
    return np.eye(3) if length == 0 else rodrigues(axis / length, float(np.arctan2(length, place[2])))


def _pixels(rig: TrueRig, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels of points [n, 3] in the camera frame, and which are in the image."""
    camera = rig.config.camera
    if camera.wide:
        angle = np.arctan2(np.hypot(points[:, 0], points[:, 1]), points[:, 2])
        straight = angle < np.deg2rad(camera.field_deg / 2) - _MARGIN_PX / camera.fx
        straight &= np.linalg.norm(points, axis=1) > 0.05
    else:
        # Beyond the field of view the lens model folds back into the image.
        reach = 0.6 * np.hypot(camera.width / camera.fx, camera.height / camera.fy)
        straight = np.hypot(points[:, 0], points[:, 1]) < reach * np.maximum(points[:, 2], 1e-6)
        straight &= points[:, 2] > 0.05
        points = np.column_stack([points[:, :2], np.maximum(points[:, 2], 1e-6)])
    u, v = project(camera, points)
    inside = (u > _MARGIN_PX) & (u < camera.width - 1 - _MARGIN_PX) & (v > _MARGIN_PX)
    return np.stack([u, v], -1), inside & (v < camera.height - 1 - _MARGIN_PX) & straight


@lru_cache(maxsize=4)
def _corners(spec: BoardsSpec) -> np.ndarray:
    return spec.board().corners()


@lru_cache(maxsize=4)
def _outline(spec: BoardsSpec) -> np.ndarray:
    return spec.board().outline()


def _sees(rig: TrueRig, pose: Motion) -> bool:
    """Whether the corners that the board's kind needs are in the image."""
    spec = rig.config.boards
    share = _pixels(rig, pose.apply(_corners(spec)))[1].mean()
    return bool(share == 1 if spec.type == "chessboard" else share >= 0.75)


def _faces(pose: Motion) -> bool:
    """Whether the camera does not see the board edge-on."""
    return bool(pose.rotation[:, 2] @ pose.translation > 0.35 * np.linalg.norm(pose.translation))


def _crossed(rig: TrueRig, pose: Motion) -> bool:
    """Whether a stripe runs over most of the board, in the image, and does not graze it."""
    low, high = _outline(rig.config.boards)[[0, 2]]
    share = np.linspace(0.05, 0.95, 10)
    for sheet in rig.sheets:
        # The stripe is met by ten lines across the board, each between its ends.
        along, across = (1, 0) if sheet.spec.stripe_axis == "rows" else (0, 1)
        ends = np.zeros((2, len(share), 3))
        ends[:, :, along] = low[along] + share * (high[along] - low[along])
        ends[0, :, across], ends[1, :, across] = low[across], high[across]
        ends = pose.apply(ends)
        beside = ends @ sheet.normal - sheet.distance
        cut = beside[0] * beside[1] < 0
        at = beside[0] / np.where(cut, beside[0] - beside[1], 1.0)
        points = ends[0] + at[:, None] * (ends[1] - ends[0])
        legs = points - sheet.origin
        lit = legs @ pose.rotation[:, 2] / np.linalg.norm(legs, axis=-1) > 0.35
        fan = np.abs(np.arctan2(legs @ sheet.across, legs @ sheet.ahead)) < np.deg2rad(sheet.spec.fan_deg / 2 - 3)
        if np.mean(cut & lit & fan & _pixels(rig, points)[1]) >= 0.7:
            return True
    return False


def _turns(rig: TrueRig, pose: Motion, count: int) -> tuple[float, ...]:
    """Angles over which the board stays in the image, evenly spread; none if it hardly does."""
    scanner_from_board = rig.pose(0.0) @ pose
    ends = []
    for step in (-0.01, 0.01):
        phi = 0.0
        while abs(phi) < np.pi / 4:
            turned = rig.pose(phi + step).inverse() @ scanner_from_board
            if not _sees(rig, turned) or not _faces(turned):
                break
            phi += step
        ends.append(phi)
    if ends[1] - ends[0] < 0.1:
        return ()
    # Whole hundredths of a degree, to which a stepper can be sent.
    return tuple(float(np.deg2rad(round(np.rad2deg(phi), 2))) for phi in np.linspace(ends[0], ends[1], count))


def _clear(rig: TrueRig, scene: Scene, pose: Motion, phi: float) -> bool:
    """Whether nothing stands before or in the board, for camera and laser, at angle `phi`."""
    spec = rig.config.boards
    low, high = _outline(spec)[[0, 2]] + np.array([[-1.0], [1.0]]) * spec.border_mm / 1000
    x, y = np.meshgrid(np.linspace(low[0], high[0], 5), np.linspace(low[1], high[1], 5))
    # Points behind the board by the clearance: an object that hides them would stick through it.
    grid = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, _CLEARANCE)])
    world = (rig.pose(0.0) @ pose).apply(grid).astype(np.float32)
    turned = rig.pose(phi)
    eyes = [turned.translation, *(turned.apply(sheet.origin) for sheet in rig.sheets)]
    return not any(scene.blocked(eye, world).any() for eye in eyes)


def _cells(rig: TrueRig, pose: Motion) -> np.ndarray:
    """Cells of a 6 x 8 grid over the image that hold corners of the board."""
    camera = rig.config.camera
    pixels, inside = _pixels(rig, pose.apply(_corners(rig.config.boards)))
    seen = np.zeros((6, 8))
    rows, columns = pixels[inside, 1] * 6 // camera.height, pixels[inside, 0] * 8 // camera.width
    seen[rows.astype(int), columns.astype(int)] = 1
    return seen


_STRIP = 64
"""Rows evaluated at a time: their numbers stay in the processor's cache."""


class ExpectedRecord(NamedTuple):
    """A pair of frames before the sensor: linear light in DN, without noise."""

    angle: float
    """The table's own count [rad]."""
    placement: int | None
    """Number of the board's placement; None for free views and sweeps."""
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
    """uint8 [rows, columns] (rgb8: and 3); uint16 of more than 8 bits."""
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
        uint8 of the same shape; uint16 of more than 8 bits.
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
    scale, depth, front = 1.0, room.depth, None
    if board is not None:
        in_front = _in_view(rig, board.hit(rig.rays.x, rig.rays.y, rig.rays.z)[0])
        depth = np.minimum(depth, in_front)
        lens = lens_blur(config, depth)
        front = cover(rig, board, in_front, lens)
        where, fills, albedo, board = front
        light, shine = (part * np.float32(white) for part in _board_light(rig, scene, pose, board, where))
        off[:, *where] = off[:, *where] * (1 - fills) + albedo * light + fills * shine
        scale = _board_power(rig, sheet, in_front)
    shot = shot._replace(board=board)
    samples = lit_samples(shot, depth, lens)
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
def _surroundings(rig: TrueRig, scene: Scene, phi: float, laser: int | None) -> tuple[SceneView, Blur, np.ndarray]:
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


def _in_view(rig: TrueRig, depth: np.ndarray) -> np.ndarray:
    return depth if rig.rays.sees is None else np.where(rig.rays.sees, depth, np.float32(np.inf))


def _ambient(rig: TrueRig, scene: Scene, pose: Motion, room: SceneView, lens: Blur) -> np.ndarray:
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
    return blurred(lambda psf_px: blur(image, psf_px), lens)


def _returned(shot: LitScene, room: SceneView, lens: Blur, depth: np.ndarray, front: Cover | None) -> np.ndarray:
    """The laser's light that comes back from the surfaces it lights, through the lens, float32 [height, width], DN."""
    rig, scene, pose = shot.rig, shot.scene, shot.pose
    field = returned_field(shot, line_pieces(shot), partial(points_at, rig, pose, depth))
    image = np.empty_like(room.depth)
    normal = [np.ascontiguousarray(part) for part in scene.facing(pose.translation).T]
    for start in range(0, len(image), _STRIP):
        part = np.s_[start : start + _STRIP]
        strength = sum(along[part] * way.take(room.triangle[part]) for along, way in zip(field, normal, strict=True))
        image[part] = np.maximum(strength, 0) * room.albedo[0, part]
    image = blurred(lambda psf_px: blur(image, psf_px), lens)
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


_SWEEP, _BOARDS, _PLAN = 0, 1, 2
"""Streams of random numbers that are drawn from one seed."""

Item = TypeVar("Item")
Result = TypeVar("Result")


def sweep_angles(config: SimulationConfig, *, every: int = 1) -> np.ndarray:
    """Commanded angles of a sweep [rad], every n-th step.

    Raises:
        ValueError: If `every` is less than 1.
    """
    if every < 1:
        raise ValueError(f"`every` must be at least 1, got {every}.")
    plan = config.plan
    return np.deg2rad(plan.turn_deg) * np.arange(0, plan.steps, every) / plan.steps


def board_pairs(config: SimulationConfig) -> int:
    """Number of pairs of frames of a board capture."""
    spec = config.boards
    return (spec.free_views + spec.placements * spec.angles) * len(config.laser)


def expect_sweep(config: SimulationConfig, *, every: int = 1) -> Iterator[ExpectedRecord]:
    """The frames of a sweep without noise, in order; with several lasers, one after the other at each angle."""
    rig, scene = make_rig(config), make_scene(config)
    jobs = [(float(phi), index) for phi in sweep_angles(config, every=every) for index in range(len(rig.sheets))]
    return _ahead(lambda job: expect_record(rig, scene, job[0], laser=job[1]), jobs)


def render_sweep(
    config: SimulationConfig,
    *,
    every: int = 1,
    seed: int | None = None,
    angles: np.ndarray | None = None,
    scene: Scene | None = None,
) -> Iterator[RenderedRecord]:
    """The frames of a sweep, in order.

    Args:
        config: The rig and its room.
        every: Only every n-th step.
        seed: Seed of the noise, instead of the configuration's. The same seed gives the same frames,
            whatever `every` is.
        angles: Commanded angles [rad], instead of those of the plan.
        scene: What the rig sees, instead of the configuration's room alone; see `make_scene`.
    """
    seed = config.seed if seed is None else seed
    rig, scene = make_rig(config), make_scene(config) if scene is None else scene
    lasers, angles = len(rig.sheets), sweep_angles(config, every=every) if angles is None else angles[::every]
    jobs = [(k * every * lasers + index, float(phi), index) for k, phi in enumerate(angles) for index in range(lasers)]

    def render(job: tuple[int, float, int]) -> RenderedRecord:
        number, phi, index = job
        return develop(expect_record(rig, scene, phi, laser=index), config, _generator(seed, _SWEEP, number))

    return _ahead(render, jobs)


def render_boards(
    config: SimulationConfig, texture: np.ndarray, *, seed: int | None = None
) -> Iterator[RenderedRecord]:
    """The frames of a board capture: free views at angle 0, then the placements.

    Args:
        config: The rig and its board.
        texture: Picture of the board's printed area (`board.outline()`), uint8 [rows, columns],
            row 0 at y0 and column 0 at x0, with a whole number of cells per square.
        seed: Seed of poses and noise, instead of the configuration's.
    """
    seed = config.seed if seed is None else seed
    rig, scene = make_rig(config), make_scene(config, boards=config.object is not None)
    picture = make_print(config.boards, texture)
    placements = plan_boards(rig, scene, _generator(seed, _PLAN, 0))
    jobs = [(one, phi, index) for one in placements for phi in one.angles for index in range(len(rig.sheets))]

    def render(job: tuple[int, tuple[Placement, float, int]]) -> RenderedRecord:
        number, (placement, phi, index) = job
        pose = rig.pose(rig.stood(phi, placement.number))
        board = SeenBoard(picture, placement.scanner_from_board.inverse() @ pose)
        record = expect_record(rig, scene, phi, laser=index, board=board, placement=placement.number)
        return develop(record, config, _generator(seed, _BOARDS, number))

    return _ahead(render, enumerate(jobs))


def true_cloud(records: Iterable[ExpectedRecord | RenderedRecord]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The cloud of a perfect scanner.

    Returns:
        xyz: float64 [records, lines, 3], m, scanner frame; zero where not valid.
        valid: bool [records, lines].
        angle: float64 [records], rad.
    """
    angles, points, valid = zip(*((one.angle, one.truth.xyz, one.truth.valid) for one in records), strict=True)
    return np.stack(points), np.stack(valid), np.array(angles)


def _generator(seed: int, stream: int, number: int) -> np.random.Generator:
    return np.random.Generator(np.random.SFC64(np.random.SeedSequence([seed, stream, number])))


def _ahead(function: Callable[[Item], Result], items: Iterable[Item], *, workers: int = 2) -> Iterator[Result]:
    """`map` in order, a few items ahead in threads: NumPy and Embree release the interpreter's lock."""
    waiting = iter(items)
    with ThreadPoolExecutor(workers) as pool:
        running = deque(pool.submit(function, item) for item in islice(waiting, workers + 1))
        while running:
            result = running.popleft().result()
            running.extend(pool.submit(function, item) for item in islice(waiting, 1))
            yield result
