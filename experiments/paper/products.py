"""What several experiments of the paper need and one makes: boards, sweeps, calibrations of all draws, the room.

Boards by the paper's protocol and by ours are rendered once, then written with many draws of noise. In the kind world
the table takes all 3600 steps of the room, as in the paper; in the unkind one every tenth, since a frame there takes
three times as long to render; a quick sweep has 90 steps. The rig's camera is grey: a camera with the same pixels in
colour takes laser-off frames every few degrees, and each point takes its colour from the nearest of them, for
pictures only.
"""

import itertools
import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

import jaxscan
from experiments.paper.methods import (
    EXTRACTORS,
    Extract,
    PaperWay,
    calibrate_paper_way,
    gravity,
    highest,
    linear_plane,
    points_on_board,
    stripe_on_board,
    total_plane,
)
from experiments.paper.stage import Stage, windowed, windowed_scanner
from jaxscan.api.simulation import TEXTURE_PX
from jaxscan.calibration import CalibrationSettings
from jaxscan.errors import ConfigError
from jaxscan.files import Capture, CaptureHeader, create_capture
from jaxscan.observation import Observations
from jaxscan.reconstruction import FrameChunk
from jaxscan.simulation import (
    ExpectedRecord,
    Motion,
    Placement,
    RenderedRecord,
    SeenBoard,
    SimulationConfig,
    develop,
    expect_record,
    make_print,
    make_rig,
    make_scene,
    plan_boards,
    render_sweep,
    rodrigues,
    sweep_angles,
    take_frame,
)
from jaxscan.simulation.rig import project
from jaxscan.simulation.scene import Scene
from jaxscan.stripes import LaserLine, PixelFormat, Response
from jaxscan.vision import board_texture


PAIR_DEG = 1.98
"""Turn between the paper's last two views: that of Table I's Tr."""
VIEWS, LIT = 23, 4
"""Views of the paper's protocol, and how many of them, the last ones, show the stripe."""
CAMERA_RANGE_M = (0.9, 2.0)
"""Distances of the views without a stripe: the board fills the image, or a fifth of it."""
STRIPE_RANGE_M = (1.0, 1.6)
"""Distances of the views with a stripe: round the paper's working distance, 1.3 m."""
_PLAN, _NOISE = 11, 12
"""Streams of random numbers."""


class BoardPlan(NamedTuple):
    """Where boards stand, and which views show the stripe."""

    placements: list[Placement]
    lit: list[bool]
    """Of each record: every placement at each of its angles, in this order."""

    def jobs(self) -> list[tuple[Placement, float, bool]]:
        """Placement, angle [rad] and whether it is lit, of each record."""
        views = [(placement, phi) for placement in self.placements for phi in placement.angles]
        return [(*view, lit) for view, lit in zip(views, self.lit, strict=True)]


def paper_plan(stage: Stage) -> BoardPlan:
    """23 views: 19 without a laser, then 4 with the stripe, of which the last two show one board, 1.98 degrees apart.

    The paper reports the numbers of views and their purposes alone. Assumed are: a board of 11 x 8 corners, 40 mm
    apart, tilted by 20 to 45 degrees; distances of 0.9 to 2 m for the camera, and of 1 to 1.6 m with the stripe, around
    a working distance of 1.3 m. There a stripe of Table II's plane crosses the middle of the image, in agreement with
    the ratios of X and Y to Z in the paper's Fig. 6.
    """
    views = _planned(stage, 0, free_views=VIEWS - LIT, placements=0, range_m=CAMERA_RANGE_M)
    for attempt in range(1, 20):
        stripes = {"free_views": LIT - 2, "placements": 1, "angles": 2, "range_m": STRIPE_RANGE_M}
        *lit, pair = _planned(stage, attempt, **stripes)
        # The planner gives the ends of the arc in which the camera sees all of the board; home is inside.
        if max(pair.angles) >= np.deg2rad(PAIR_DEG):
            pair = pair._replace(angles=(0.0, float(np.deg2rad(PAIR_DEG))))
            return BoardPlan([*views, *lit, pair], [False] * (VIEWS - LIT) + [True] * LIT)
    raise ConfigError("No board was found that the camera sees before and after the turn of the last pair.")


def our_plan(stage: Stage) -> BoardPlan:
    """The protocol of jaxscan's own guide, as in the configuration: every view with the stripe."""
    few = {"free_views": 9, "placements": 2, "angles": 4} if stage.quick else {}
    placements = _planned(stage, 100, **few)
    return BoardPlan(placements, [True] * sum(len(each.angles) for each in placements))


def _planned(stage: Stage, number: int, **changes: object) -> list[Placement]:
    """Poses of the boards, with changes of the configuration's protocol."""
    config = stage.config.model_copy(update={"boards": stage.config.boards.model_copy(update=changes)})
    return plan_boards(make_rig(config), make_scene(config), stage.generator(_PLAN, number))


def expect(stage: Stage, plan: BoardPlan) -> Iterator[ExpectedRecord]:
    """All frames of a plan without noise: in full size 13 MB a view, and 13 MB more for the laser's light.

    Records that are not lit have an empty `laser`.
    """
    config = stage.config
    # In views without it the laser is one that is rendered fast.
    off = tuple(laser.model_copy(update={"speckle_contrast": 0.0}) for laser in config.laser)
    still = config.model_copy(update={"light": config.light.model_copy(update={"bounce": 0.0}), "laser": off})
    rig, dark, scene = make_rig(config), make_rig(still), make_scene(config)
    picture = make_print(config.boards, board_texture(config.boards.board(), TEXTURE_PX))
    for placement, phi, lit in plan.jobs():
        board = SeenBoard(picture, placement.scanner_from_board.inverse() @ rig.pose(phi))
        record = expect_record(rig if lit else dark, scene, phi, board=board, placement=placement.number)
        yield record if lit else record._replace(laser=np.zeros(0, np.float32), samples=())


def write_captures(
    stage: Stage, records: Iterable[ExpectedRecord], plan: BoardPlan, folders: dict[int, Path]
) -> list[Capture]:
    """Draws of noise as captures on disk, in new folders by their seeds; the same seed writes the same frames.

    Records are taken one by one, and not kept.
    """
    config = stage.config
    sensor = {"pixel_format": config.sensor.pixel_format, "response": config.sensor.response}
    header = CaptureHeader.model_validate(
        {
            "kind": "calibration",
            "camera": config.camera.model_dump(include={"width", "height", "up"}) | sensor,
            "turntable": {"carries": config.turntable.carries},
            "laser": [laser.model_dump(include={"name", "colour", "stripe_axis"}) for laser in config.laser],
            "board": config.boards.table(),
            "plan": {"steps": len(plan.lit)},
            "acquisition": {"software": "jaxscan simulate"},
        }
    )
    with ExitStack() as stack:
        # Raw frames: packing them would take longer than all else. None is kept for long.
        writers = {
            seed: stack.enter_context(create_capture(folder, header, storage="npy", durable=False))
            for seed, folder in folders.items()
        }
        for number, (record, lit) in enumerate(zip(records, plan.lit, strict=True)):
            angle = float(np.rad2deg(record.angle))
            for seed, writer in writers.items():
                on, off = _frames(record, lit, config, stage.generator(_NOISE, seed, number))
                lasers = [config.laser[0].name]
                writer.append(angle_deg=angle, on=on, off=off, placement=record.placement, lasers=lasers)
    return [jaxscan.open_capture(folder) for folder in folders.values()]


def _frames(
    record: ExpectedRecord, lit: bool, config: SimulationConfig, random: np.random.Generator
) -> tuple[np.ndarray | None, np.ndarray]:
    """Frames on and off with noise; no frame on where the laser was not lit."""
    if lit:
        both = develop(record, config, random)
        return both.on, both.off
    flicker = max(0.0, 1 + config.light.flicker * random.standard_normal())
    return None, take_frame(record.off * np.float32(flicker), config, random)


Watch = Callable[[int, np.ndarray, np.ndarray], None]
"""Called with the first record of a chunk, and its frames on and off, uint8 [records, rows, columns(, 3)]."""


class RenderedSweep:
    """A sweep of a simulated rig, as `jaxscan.reconstruct` takes it; every reading renders the same frames."""

    compression = None
    exposures = (1.0,)
    bits = 8

    def __init__(
        self,
        config: SimulationConfig,
        angles: np.ndarray,
        *,
        seed: int,
        scene: Scene | None = None,
        watch: Watch | None = None,
    ) -> None:
        """At angles [rad]; `scene` replaces the configuration's room, and `watch` sees all frames that are read."""
        self.config, self.seed, self.scene, self.watch = config, seed, scene, watch
        self.angles = np.asarray(angles, np.float64)
        self.record = np.arange(len(self.angles), dtype=np.int32)
        self.laser = np.zeros(len(self.angles), np.int32)

    pixel_format: PixelFormat = property(lambda self: self.config.sensor.pixel_format)  # type: ignore[assignment]
    response: Response = property(lambda self: self.config.sensor.response)  # type: ignore[assignment]

    @property
    def lasers(self) -> tuple[LaserLine, ...]:
        """The one laser."""
        laser = self.config.laser[0]
        return (LaserLine(name=laser.name, colour=laser.colour, stripe_axis=laser.stripe_axis),)

    @property
    def image_size(self) -> tuple[int, int]:
        """Width and height [px]."""
        return self.config.camera.width, self.config.camera.height

    @property
    def carries(self) -> str:
        """The table's load: "scanner" or "object"."""
        return self.config.turntable.carries

    def __len__(self) -> int:
        return len(self.angles)

    def chunks(self, size: int) -> Iterator[FrameChunk]:
        """All frames in order, `size` records at a time."""
        records = self._records()
        first = 0
        while part := list(itertools.islice(records, size)):
            on, off = (np.stack([getattr(record, side) for record in part]) for side in ("on", "off"))
            if self.watch is not None:
                self.watch(first, on, off)
            first += len(part)
            yield FrameChunk(on, off)

    def _records(self) -> Iterator[RenderedRecord]:
        return render_sweep(self.config, seed=self.seed, angles=self.angles, scene=self.scene)


class PlainStripes(NamedTuple):
    """The stripes of a sweep by a plain finder [records, rows]."""

    u: np.ndarray
    """Column [px]."""
    valid: np.ndarray
    grey: np.ndarray | None = None
    """The laser-off image at the centres [DN]."""


def plain_stripes(shape: tuple[int, int], first: int = 0) -> tuple[dict[str, PlainStripes], Watch]:
    """Stripes by every plain finder, in the red channel of colour frames, and what fills them while a sweep is read.

    Args:
        shape: Records and rows.
        first: Column of the whole image at which the frames begin; it is added to the stripes' [px].
    """
    found = {name: PlainStripes(np.zeros(shape), np.zeros(shape, bool), np.zeros(shape)) for name in EXTRACTORS}

    def watch(start: int, on: np.ndarray, off: np.ndarray) -> None:
        on, off = (frames if frames.ndim == 3 else frames[..., 0] for frames in (on, off))
        for name, extract in EXTRACTORS.items():
            u, valid = extract(on, off)
            left = np.clip(u.astype(int), 0, off.shape[2] - 2)
            low, high = (np.take_along_axis(off, at[..., None], 2)[..., 0].astype(float) for at in (left, left + 1))
            parts = np.where(valid, u + first, 0), valid, low + (u - left) * (high - low)
            # Frames may be read more than once: stripes are kept by the number of their record.
            for whole, part in zip(found[name], parts, strict=True):
                whole[start : start + len(part)] = part

    return found, watch


SETTINGS = CalibrationSettings(judge=False)
"""The tests of the models take longer than the solve, and no draw uses them."""
_OURS = 1000
"""First seed of the captures of our protocol."""


class Draw(NamedTuple):
    """One draw of noise of the paper's 23 views."""

    number: int
    paper: PaperWay
    """By the paper's method, stripes by their centre of gravity."""
    ours: Path
    """Of the same images: the calibration by `jaxscan.calibrate`."""
    highest: PaperWay
    """By the paper's method, stripes by their highest pixel."""

    def by(self, finder: str) -> PaperWay:
        """By the paper's method with a stripe finder of `EXTRACTORS`."""
        return {"gravity": self.paper, "highest": self.highest}[finder]


def draws(stage: Stage) -> list[Draw]:
    """`stage.draws` draws of noise; made once, then loaded. Those that a method cannot calibrate are left out."""
    gravities, tops = (
        [stage.product(f"draws/paper_{name}_{number:02}.npz") for number in range(stage.draws)]
        for name in ("gravity", "highest")
    )
    ours, failed = (
        [stage.product(f"draws/{name.format(number)}") for number in range(stage.draws)]
        for name in ("ours_{:02}.json", "failed_{:02}.txt")
    )
    missing = [number for number in range(stage.draws) if not (ours[number].exists() or failed[number].exists())]
    if missing:
        plan = paper_plan(stage)
        records = list(expect(stage, plan))
        stage.say(f"rendered the paper's {len(records)} views")
        for number in missing:
            folder = stage.emptied(f"draws/capture_{number}")
            (capture,) = write_captures(stage, records, plan, {number: folder})
            try:
                way = calibrate_paper_way(capture, gravity)
                save_paper_way(way, gravities[number])
                save_paper_way(with_stripes(way, capture, highest), tops[number])
                # Last: a draw with this file is complete.
                jaxscan.save_calibration(jaxscan.calibrate(capture, settings=SETTINGS), ours[number])
                stage.say(f"draw {number + 1} of {stage.draws}")
            except (ValueError, jaxscan.JaxscanError) as problem:
                # Tables say how many draws they have.
                failed[number].write_text(f"{problem}\n")
                stage.say(f"draw {number + 1} of {stage.draws} failed: {problem}")
            shutil.rmtree(folder)
    return [
        Draw(number, load_paper_way(gravities[number]), ours[number], load_paper_way(tops[number]))
        for number in range(stage.draws)
        if not failed[number].exists()
    ]


def our_calibrations(stage: Stage, count: int = 3) -> list[Path]:
    """Calibrations by our own protocol, each with its own noise; made once. A quick stage has one only."""
    count = 1 if stage.quick else count
    paths = [stage.product(f"draws/our_protocol_{number}.json") for number in range(count)]
    missing = [number for number, path in enumerate(paths) if not path.exists()]
    if missing:
        plan = our_plan(stage)
        folders = {_OURS + number: stage.emptied(f"draws/our_capture_{number}") for number in missing}
        # View by view: 66 of them without noise are too many to keep.
        captures = write_captures(stage, expect(stage, plan), plan, folders)
        stage.say(f"rendered the {len(plan.lit)} views of our protocol")
        for number, capture in zip(missing, captures, strict=True):
            jaxscan.save_calibration(jaxscan.calibrate(capture, settings=SETTINGS), paths[number])
        for folder in folders.values():
            shutil.rmtree(folder)
        stage.say(f"{len(missing)} calibrations by our protocol")
    return paths


def with_stripes(way: PaperWay, capture: Capture, extract: Extract) -> PaperWay:
    """The paper's calibration of the same capture with another stripe finder: camera and poses do not depend on it."""
    outline, stripe, lifted = capture.board.outline(), list(way.stripe), []
    for index, uv in enumerate(way.stripe):
        if len(uv):
            found = extract(*capture.frames(index))
            stripe[index] = stripe_on_board(way.matrix, way.k, way.pose[index], outline, found)
            lifted.append(points_on_board(way.matrix, way.k, way.pose[index], stripe[index]))
    every = np.concatenate(lifted)
    return way._replace(stripe=stripe, linear=linear_plane(every), total=total_plane(every))


def save_paper_way(way: PaperWay, path: Path) -> None:
    """Write a calibration by the paper's method, an npz file."""
    fields = way._asdict()
    stripe = fields.pop("stripe")
    counts = np.array([len(view) for view in stripe])
    np.savez_compressed(path, counts=counts, stripe=np.concatenate([*stripe, np.zeros((0, 2))]), **fields)


def load_paper_way(path: Path) -> PaperWay:
    """Read a file of `save_paper_way`."""
    with np.load(path) as file:
        fields = dict(file)
    counts, stripe = fields.pop("counts"), fields.pop("stripe")
    numbers = {name: float(fields.pop(name)) for name in ("k", "pair_angle")}
    return PaperWay(**fields, **numbers, stripe=np.split(stripe, np.cumsum(counts)[:-1]))


WORKING_M = 1.3
"""Depth at which the paper's stripe crosses the middle of the image; see `figure_6`."""
_SEED = 2000
"""First seed of the noise; the calibrations have others."""
_HELD_OUT, _MARGIN_PX = 31, 8


class HeldOut(NamedTuple):
    """Captures of boards that no calibration has seen, one for each draw."""

    captures: list[Path]
    true_u: np.ndarray
    """Where the sheet's centre meets each row, float64 [boards, rows], px: for comparison alone."""
    true_valid: np.ndarray


def held_out(stage: Stage) -> HeldOut:
    """Six boards in three draws of noise, three in one for a quick stage; made once."""
    boards, count = (3, 1) if stage.quick else (6, 3)
    truth = stage.product("held_out/truth.npz")
    captures = [stage.product(f"held_out/capture_{number}") for number in range(count)]
    if not truth.exists():
        plan = held_out_plan(stage, boards)
        records = list(expect(stage, plan))
        folders = {_SEED + number: stage.emptied(f"held_out/{path.name}") for number, path in enumerate(captures)}
        write_captures(stage, records, plan, folders)
        u, valid = (np.stack([getattr(record.truth, name) for record in records]) for name in ("u", "valid"))
        # Last: with this file all is there.
        np.savez(truth, u=u, valid=valid)
        stage.say(f"rendered {boards} boards at {WORKING_M} m, {count} draws of noise")
    with np.load(truth) as file:
        return HeldOut(captures, file["u"], file["valid"])


def held_out_plan(stage: Stage, boards: int) -> BoardPlan:
    """Boards that stand upright in the middle of the image, tilted by 20 to 35 degrees to all sides.

    The stripe then runs along the board's longer side, over about a sixth of the depth to both sides of the optical
    axis, in agreement with the ratios of X and Y to Z in the paper's Fig. 6.
    """
    rig, random = make_rig(stage.config), stage.generator(_HELD_OUT)
    board, sheet = stage.config.boards.board(), rig.sheets[0]
    centre = np.append(board.outline().mean(0), 0.0)
    placements = []
    for number in range(boards):
        direction = 2 * np.pi * (number + random.uniform(-0.2, 0.2)) / boards
        tilt = rodrigues(np.array([np.cos(direction), np.sin(direction), 0.0]), np.deg2rad(random.uniform(20, 35)))
        rotation = tilt @ rodrigues(np.array([0.0, 0.0, 1.0]), np.deg2rad(90 + random.uniform(-8, 8)))
        y = random.uniform(-0.03, 0.03)
        x = (sheet.distance - sheet.normal[2] * WORKING_M - sheet.normal[1] * y) / sheet.normal[0]
        place = np.array([x + random.uniform(-0.08, 0.08), y, WORKING_M])
        pose = Motion(rotation, place - rotation @ centre)
        pixels = np.stack(project(stage.config.camera, pose.apply(board.corners())), -1)
        last = np.array([stage.config.camera.width, stage.config.camera.height]) - 1
        if not ((pixels > _MARGIN_PX) & (pixels < last - _MARGIN_PX)).all():
            raise ConfigError(f"The board at {WORKING_M} m does not fit into the image.")
        placements.append(Placement(rig.pose(0.0) @ pose, (0.0,), None))
    return BoardPlan(placements, [True] * boards)


@lru_cache(maxsize=4)
def observe_held_out(calibration: Path, capture: Path) -> Observations:
    """Corners and stripes of a capture of `held_out` by `jaxscan.calibrate` with a known rig, which is held."""
    scanner = jaxscan.load_scanner(calibration)
    known = jaxscan.KnownParts(camera=scanner.camera, sheets=(scanner.laser(0),), motion=scanner.turntable)
    observations = jaxscan.calibrate(jaxscan.open_capture(capture), known=known, settings=SETTINGS).observations
    assert observations is not None
    return observations


NEAR_M, FAR_M = 1.2, 4.0
"""Depths between which the room and its furniture lie, as a user knows [m]."""
MARGIN = 40 / 2048
"""Columns read on either side of the stripe's, as a share of the image's width."""
STRIDE = {"kind": 1, "unkind": 10}
"""Every n-th of the plan's steps is taken."""
_QUICK_STEPS = 90


class Room(NamedTuple):
    """The stripes of a sweep of the room; all columns are those of the whole image."""

    stripes: jaxscan.Stripes
    """By our extractor, within the gate of our first calibration; with colours."""
    plain: dict[str, PlainStripes]
    """By the names of `EXTRACTORS`."""
    angles: np.ndarray
    """As commanded [records]; rad."""
    window: tuple[int, int]
    """Columns that were read: first, and one past the last."""


def room(stage: Stage) -> Room:
    """The sweep, rendered once in each world and kept."""
    path = stage.product("room.npz")
    if not path.exists():
        found = _sweep(stage)
        arrays = {f"ours_{name}": np.asarray(field) for name, field in vars(found.stripes).items() if field is not None}
        for name, plain in found.plain.items():
            arrays |= {f"{name}_u": plain.u, f"{name}_valid": plain.valid}
        partial = path.with_suffix(".part.npz")
        np.savez(partial, angles=found.angles, window=found.window, **arrays)
        partial.rename(path)
    with np.load(path) as kept:
        ours = {name.removeprefix("ours_"): kept[name] for name in kept.files if name.startswith("ours_")}
        plain = {name: PlainStripes(kept[f"{name}_u"], kept[f"{name}_valid"]) for name in EXTRACTORS}
        first, stop = kept["window"].tolist()
        return Room(jaxscan.Stripes(**ours), plain, kept["angles"], (first, stop))


def room_sweep(stage: Stage, angles: np.ndarray) -> RenderedSweep:
    """The sweep of the whole camera for `jaxscan.reconstruct`, which reads no frame if the stripes have colours."""
    return RenderedSweep(stage.config, angles, seed=stage.config.seed)


def stripe_window(scanner: jaxscan.Scanner, near_m: float, far_m: float, margin_px: float) -> tuple[int, int]:
    """Columns of the image in which the stripe lies for depths from `near_m` to `far_m`: first, and one past the last.

    The bow of the sheet is left to the margin, on either side.
    """
    camera, sheet = scanner.camera, scanner.laser(0)
    (nx, ny, nz), distance = np.asarray(sheet.normal), float(sheet.distance)
    rows = np.linspace(0, camera.height - 1, 33)
    slope = (rows - float(camera.cy)) / float(camera.fy)
    z, slope = (part.ravel() for part in np.meshgrid([near_m, far_m], slope))
    points = np.column_stack([(distance - nz * z - ny * slope * z) / nx, slope * z, z])
    u = np.asarray(camera.project(points))[:, 0]
    first, stop = int(np.floor(u.min() - margin_px)), int(np.ceil(u.max() + margin_px)) + 1
    return max(first, 0), min(stop, camera.width)


def _sweep(stage: Stage) -> Room:
    config = stage.config
    scanner = jaxscan.load_scanner(our_calibrations(stage, 1)[0])
    every = config.plan.steps // _QUICK_STEPS if stage.quick else STRIDE[stage.world]
    angles = sweep_angles(config, every=every)
    first, stop = stripe_window(scanner, NEAR_M, FAR_M, MARGIN * config.camera.width)
    shape = len(angles), config.camera.height
    plain, watch = plain_stripes(shape, first)
    sweep = RenderedSweep(windowed(config, first, stop), angles, seed=config.seed, watch=watch)
    settings = jaxscan.ReconstructSettings(min_range_m=NEAR_M - 0.1, max_range_m=FAR_M + 0.3)
    stage.say(f"sweep of the room: {len(angles)} records")
    found = jaxscan.extract(sweep, windowed_scanner(scanner, first, stop), settings=settings).stripes
    fields = vars(found) | {"u": np.where(found.valid, found.u + first, 0).astype(np.float32)}
    return Room(jaxscan.Stripes(**fields), plain, angles, (first, stop))


STEP_DEG, QUICK_DEG = 5.0, 15.0
"""Between frames in colour."""
_COLOURS = 92


def room_colours(stage: Stage, seen: Room, xyz: np.ndarray, scanner: jaxscan.Scanner) -> np.ndarray:
    """Colours of the points of a sweep [records, rows, 3] by `scanner`, uint8; zero where there is no point.

    Made once and kept.
    """
    path = stage.product("room_colours.npy")
    if not path.exists():
        partial = path.with_suffix(".part.npy")
        np.save(partial, _look(stage, seen, xyz, scanner))
        partial.rename(path)
    return np.load(path)


def _look(stage: Stage, seen: Room, xyz: np.ndarray, scanner: jaxscan.Scanner) -> np.ndarray:
    step = np.deg2rad(QUICK_DEG if stage.quick else STEP_DEG)
    sensor = stage.config.sensor.model_copy(update={"pixel_format": "rgb8"})
    # The stripe's own columns, and those in which its points are seen until the next frame.
    wider = int(0.65 * step * stage.config.camera.fx)
    first, stop = max(seen.window[0] - wider, 0), min(seen.window[1] + wider, stage.config.camera.width)
    config = windowed(stage.config.model_copy(update={"sensor": sensor}), first, stop)
    rig, scene, part = make_rig(config), make_scene(config), windowed_scanner(scanner, first, stop)
    nearest = np.rint(seen.angles / step).astype(int)
    rgb = np.zeros(xyz.shape, np.uint8)
    for view in np.unique(nearest):
        frame = take_frame(expect_record(rig, scene, view * step).off, config, stage.generator(_COLOURS, int(view)))
        there = xyz.any(-1) & (nearest == view)[:, None]
        pixels = np.rint(np.asarray(jaxscan.pixels(part.rig, xyz[there], view * step))).astype(int)
        column, row = np.clip(pixels, 0, np.array(frame.shape[1::-1]) - 1).T
        rgb[there] = frame[row, column]
    return rgb
