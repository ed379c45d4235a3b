"""A camera, a light sheet and flat things, rendered in plain NumPy: captures of rigs that the simulator does not have.

Nothing here comes from the package but the writer of PNG files, so a wrong sign on one side shows.
"""

import json

import numpy as np

from jaxscan.vision import encode_png


SIZE, FOCAL, CENTRE = (320, 256), 260.0, (158.0, 129.0)
NORMAL = np.array([0.970, 0.005, 0.240]) / np.linalg.norm([0.970, 0.005, 0.240])
DISTANCE = 0.2
TRAVEL = np.array([0.995, 0.03, -0.08]) / np.linalg.norm([0.995, 0.03, -0.08])
"""Where the linear stage moves the camera."""
AXIS, AXIS_POINT = (
    np.array([0.012, -0.9999, 0.008]) / np.linalg.norm([0.012, -0.9999, 0.008]),
    np.array([0.1, 0, -0.06]),
)
SQUARE, COLUMNS, ROWS = 0.07, 7, 5
SUB = 3
"""Samples of a pixel in each direction."""

HEADER = """format = "jaxscan-capture/1"
kind = "{kind}"
[camera]
width = 320
height = 256
pixel_format = "mono8"
{rest}
"""
LASER = '[[laser]]\nname = "red"\n'
BOARD = f'[board]\ntype = "chessboard"\ncolumns = {COLUMNS}\nrows = {ROWS}\nsquare_mm = {1000 * SQUARE:g}\n'


def turned(axis, angle):
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


HAND = turned([0.3, -0.8, 0.5], 1.1), np.array([0.06, -0.03, 0.11])
"""R, t of T_hand_cam."""
BASE = turned([0.9, 0.2, -0.3], 2.0), np.array([0.4, 0.7, 0.2])
"""R, t of T_base_cam0 of a robot: where the scene is in its frame."""
SCATTER = 1e-4, 2e-4
"""Of a robot's poses, by place [m] and angle [rad]."""


def pose_of(rotation, at, noise):
    """Twelve numbers of T_base_hand of a camera at R, t of T_cam0_cam, which err."""
    turn, place = BASE[0] @ rotation @ HAND[0].T, BASE[0] @ at + BASE[1]
    place = place - turn @ HAND[1] + SCATTER[0] * noise.normal(size=3)
    off = SCATTER[1] * noise.normal(size=3)
    turn = turn @ turned(off, np.linalg.norm(off))
    return np.column_stack([turn, place]).ravel().tolist()


def camera_at(carries, position):
    """R, t of T_cam0_cam: by travel, by a turn about the axis, as given, or nothing."""
    if carries == "poses":
        return position
    if carries == "linear":
        return np.eye(3), position * TRAVEL
    if carries == "scanner":
        rotation = turned(AXIS, np.radians(position))
        return rotation, AXIS_POINT - rotation @ AXIS_POINT
    return np.eye(3), np.zeros(3)


def seen_from(plane, camera):
    """A plane (origin, x, y, half sizes, texture) in the frame of a camera elsewhere."""
    rotation, at = camera
    origin, x, y, half, texture = plane
    return rotation.T @ (origin - at), rotation.T @ x, rotation.T @ y, half, texture


def board(rotation, middle):
    """The chessboard with its middle at a place, in a white border."""
    half = np.array([(COLUMNS + 1) * SQUARE / 2, (ROWS + 1) * SQUARE / 2])

    def texture(a, b):
        column, row = np.floor(a / SQUARE + (COLUMNS + 1) / 2), np.floor(b / SQUARE + (ROWS + 1) / 2)
        print_ = (np.abs(a) < half[0]) & (np.abs(b) < half[1])
        return np.where(print_ & ((column + row) % 2 == 0), 30.0, 150.0)

    return middle, rotation[:, 0], rotation[:, 1], half + 0.03, texture


def wall(z, half=(9.0, 9.0), x=0.0):
    """A grey wall across the optical axis of the camera at position 0."""
    flat = lambda a, b: np.full(np.shape(a), 90.0)
    return np.array([x, 0.0, z]), np.array([1.0, 0, 0]), np.array([0, 1.0, 0]), np.array(half), flat


def render(planes, seed):
    """Laser-on and laser-off frames of planes in the camera frame, uint8."""
    width, height = SIZE
    u = (np.arange(width * SUB) + 0.5) / SUB - 0.5
    v = (np.arange(height * SUB) + 0.5) / SUB - 0.5
    u, v = np.meshgrid(u, v)
    ray = np.stack([(u - CENTRE[0]) / FOCAL, (v - CENTRE[1]) / FOCAL, np.ones_like(u)], -1)
    depth, grey = np.full(u.shape, np.inf), np.full(u.shape, 10.0)
    for origin, x, y, half, texture in planes:
        normal = np.cross(x, y)
        z = (normal @ origin) / (ray @ normal)
        at = z[..., None] * ray - origin
        a, b = at @ x, at @ y
        nearer = (z > 0) & (z < depth) & (np.abs(a) < half[0]) & (np.abs(b) < half[1])
        depth, grey = np.where(nearer, z, depth), np.where(nearer, texture(a, b), grey)
    there = np.isfinite(depth)
    # Distance from the sheet, over its change along a row: the stripe is 1.5 px wide whatever it falls on.
    z = np.where(there, depth, 0.0)
    away = z * (ray @ NORMAL) - DISTANCE
    per_px = np.where(there, z * NORMAL[0] / FOCAL, 1.0)
    light = np.where(there, 100.0 * np.exp(-0.5 * (away / per_px / 1.5) ** 2), 0.0)
    noise = np.random.default_rng(seed)
    frames = []
    for image in (grey + light, grey):
        image = image.reshape(height, SUB, width, SUB).mean((1, 3))
        # A lens is never as sharp as a pixel.
        padded = np.pad(image, 1, mode="edge")
        for axis in (0, 1):
            image = sum(w * np.roll(padded, k, axis) for w, k in ((0.25, -1), (0.5, 0), (0.25, 1)))
            padded = image
        image = image[1:-1, 1:-1] + noise.normal(size=(height, width))
        frames.append(np.clip(np.rint(image), 0, 255).astype(np.uint8))
    return frames


def write(folder, kind, rest, records):
    """A capture as a person would write it; a record is (planes, keys), with laser images or not."""
    for side in ("on", "off"):
        (folder / side).mkdir(parents=True)
    (folder / "capture.toml").write_text(HEADER.format(kind=kind, rest=rest))
    lines = []
    for i, (planes, keys, lit) in enumerate(records):
        images = render(planes, i)
        names = {"on": f"on/{i}.png", "off": f"off/{i}.png"}
        for side, image in zip(("on", "off"), images, strict=True):
            if lit or side == "off":
                (folder / names[side]).write_bytes(encode_png(image))
        lines.append(json.dumps({"i": i, **keys, **(names if lit else {"off": names["off"]})}))
    (folder / "frames.jsonl").write_text("\n".join(lines) + "\n")
    return folder


def board_capture(folder, carries, *, lit=True, free=10, placements=3, positions=(0.0,), seed=4):
    """Free poses of the board, then placements seen from several positions of the rig."""
    random, records = np.random.default_rng(seed), []
    key = "position_m" if carries == "linear" else "angle_deg"
    for number in range(free + placements):
        stops = positions if number >= free else (0.0,)
        z = random.uniform(0.75, 1.15)
        middle = np.array([(DISTANCE - 0.24 * z) / 0.97 + random.uniform(-0.06, 0.06), random.uniform(-0.06, 0.06), z])
        axis = random.normal(size=3) * np.array([1, 1, 0.3])
        pose = board(turned(axis, np.radians(random.uniform(15, 32))), middle)
        for stop in stops:
            keys = {"placement": number, key: stop} if len(positions) > 1 else {}
            records.append(([seen_from(pose, camera_at(carries, stop))], keys, lit))
    motion = f'[turntable]\ncarries = "{carries}"\n' if carries else ""
    return write(folder, "calibration", motion + (LASER if lit else "") + BOARD, records)


def around(middle, random, tilt_deg):
    """R, t of T_cam0_cam of a camera that still looks at a place, from elsewhere."""
    turn = turned(random.normal(size=3) * [1, 1, 1.5], np.radians(random.uniform(-tilt_deg, tilt_deg)))
    return turn, middle - turn @ (middle + [0.0, 0.0, random.uniform(-0.1, 0.1)])


def hand_boards(folder, *, seed=5, views=18):
    """One board that stands, seen from all sides by a camera on a robot's hand."""
    random, noise, records = np.random.default_rng(seed), np.random.default_rng(seed + 50), []
    middle = np.array([-0.03, 0.0, 0.95])
    pose = board(turned([1.0, 0.4, 0.1], 0.3), middle)
    for _ in range(views):
        camera = around(middle, random, 32)
        records.append(([seen_from(pose, camera)], {"placement": 0, "pose": pose_of(*camera, noise)}, True))
    return write(folder, "calibration", '[turntable]\ncarries = "poses"\n' + LASER + BOARD, records)


def hand_camera(step):
    """R, t of T_cam0_cam at a step of `hand_sweep`: it travels and turns."""
    at = -0.2 + 0.025 * step
    return turned([0.2, 1.0, 0.1], 0.5 * at), np.array([at, 0.1 * at, 0.05 * at])


def hand_sweep(folder, *, seed=6, steps=17):
    """The scene from a hand."""
    noise, records = np.random.default_rng(seed), []
    for camera in map(hand_camera, range(steps)):
        records.append(([seen_from(plane, camera) for plane in SCENE], {"pose": pose_of(*camera, noise)}, True))
    return write(folder, "sweep", '[turntable]\ncarries = "poses"\n' + LASER, records)


SCENE = (wall(1.2), wall(1.0, half=(0.12, 0.15), x=0.0))
"""A wall, and a block in front of it: 200 mm apart, both across the optical axis."""


def sweep_capture(folder, carries, positions):
    """The scene from several positions of the rig."""
    key = {"linear": "position_m", "scanner": "angle_deg"}.get(carries)
    records = [
        ([seen_from(plane, camera_at(carries, at)) for plane in SCENE], {key: at} if key else {}, True)
        for at in positions
    ]
    return write(folder, "sweep", f'[turntable]\ncarries = "{carries}"\n' + LASER, records)
