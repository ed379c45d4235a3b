"""Plans the poses of the board as a careful person holds it: spread over the image, tilted, across the stripe.

The person sees a preview, so this code may use the true rig.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from jaxscan.errors import ConfigError
from jaxscan.simulation.rays import project
from jaxscan.simulation.rig import Motion, Sheet, TrueRig, rodrigues
from jaxscan.simulation.scene import Scene
from jaxscan.simulation.settings import BoardsSpec, CameraSpec


class Placement(NamedTuple):
    """One board pose and the table angles from which it is seen."""

    scanner_from_board: Motion
    angles: tuple[float, ...]
    """[rad], as commanded."""
    number: int | None
    """Which placement; None for a free view."""


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
        # Where no stripe ever runs, the lens must be known too.
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
    # Whole hundredths of a degree, which a stepper can be told to go to.
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
    """Which cells of a 6 x 8 grid over the image hold corners of the board."""
    camera = rig.config.camera
    pixels, inside = _pixels(rig, pose.apply(_corners(rig.config.boards)))
    seen = np.zeros((6, 8))
    rows, columns = pixels[inside, 1] * 6 // camera.height, pixels[inside, 0] * 8 // camera.width
    seen[rows.astype(int), columns.astype(int)] = 1
    return seen
