"""The rig and the frames of the speed experiments: a difficult room.

The background has texture, furniture and a bright window; frames have read and shot noise. The
stripe comes from depths in the room through the calibrated rig, with a step at every piece of
furniture; its height runs from 20 to 200 DN along the rows, some runs of rows have none, and some
have a second reflection, inside or outside of the columns where the rig could see a stripe.
"""

from typing import NamedTuple

import numpy as np

from jaxscan.geometry import LaserSheet, Pinhole, Scanner, Turntable, rays, stack_lasers


WIDTH, HEIGHT = 1280, 1024
DISTINCT = 32
"""Different pairs; longer stacks repeat them, each time in memory of their own."""
STEP = float(np.radians(0.1))
"""Turn of the table between records [rad]."""
READ_DN, ELECTRONS_PER_DN = 1.0, 40.0
DISTORTION = np.array([-0.21, 0.09, 4e-4, -3e-4, 0.0])
_NEAR_M, _FAR_M = 0.9, 7.5


class Frames(NamedTuple):
    """A stack of pairs and the stripes that were drawn into it."""

    on: np.ndarray
    """uint8 [pairs, rows, columns]."""
    off: np.ndarray
    u: np.ndarray
    """Column of the stripe [pairs, rows], px."""
    lit: np.ndarray
    """Whether there is one, bool [pairs, rows]."""
    second: np.ndarray
    """Whether there is a second reflection, bool [pairs, rows]."""


def make_scanner() -> Scanner:
    """About the paper's rig at 1280 x 1024."""
    camera = Pinhole(*(np.float64(x) for x in (1809.0, 1804.6, 635.3, 510.6)), DISTORTION, width=WIDTH, height=HEIGHT)
    sheet = LaserSheet.from_abc(-7.606, -1.685, 1.296203)
    return Scanner(camera, stack_lasers([sheet]), Turntable.from_axis([-0.018, -1.0, -0.001], [-0.01, 0.0, -0.212]))


def make_frames(pairs: int, scanner: Scanner) -> Frames:
    """A stack of so many pairs."""
    distinct = [_draw(number, stage) for stage in [_Stage(scanner)] for number in range(min(DISTINCT, pairs))]
    order = np.arange(pairs) % DISTINCT
    # Field by field, so that every pair has memory of its own.
    return Frames(*(np.stack(field)[order] for field in zip(*distinct, strict=True)))


def make_angles(pairs: int) -> np.ndarray:
    """The table's angle of each record [rad]."""
    return STEP * np.arange(pairs)


class _Stage:
    """The room and the rig of all pairs."""

    def __init__(self, scanner: Scanner) -> None:
        self.random = np.random.default_rng(20)
        self.knots = np.linspace(0.0, WIDTH - 1.0, 161)
        self.range_of_column = _ranges(scanner, self.knots)
        self.panorama = _panorama(self.random)
        self.furniture = [
            (start, start + self.random.integers(40, 180), self.random.uniform(_NEAR_M, 4.2), drift, albedo)
            for start, drift, albedo in zip(
                self.random.integers(0, HEIGHT - 60, 9),
                self.random.uniform(-2.0, 2.0, 9),
                self.random.uniform(0.15, 1.0, 9),
                strict=True,
            )
        ]


def _ranges(scanner: Scanner, columns: np.ndarray) -> np.ndarray:
    """Range at which every pixel of the given columns meets the sheet [rows, columns], m; far is far."""
    q = np.stack(np.meshgrid(columns, np.arange(HEIGHT, dtype=float)), -1)
    ray = np.asarray(rays(scanner.rig, q))
    incidence = ray @ np.asarray(scanner.lasers.normal[0])
    return np.where(incidence > 1e-3, float(scanner.lasers.distance[0]) / np.maximum(incidence, 1e-3), 1e3)


def _panorama(random: np.random.Generator) -> np.ndarray:
    """A lit wall with grain, boards and a window [DN], wide enough for all pairs."""
    width = WIDTH + 3 * DISTINCT
    rows, columns = np.mgrid[:HEIGHT, :width].astype(np.float32)
    light = 45.0 + 20.0 * np.sin(columns / 190.0) * np.cos(rows / 140.0)
    grain = random.standard_normal((HEIGHT, width)).astype(np.float32)
    grain = grain + np.roll(grain, 1, 0) + np.roll(grain, 1, 1) + np.roll(grain, (1, 1), (0, 1))
    light *= 1.0 + 0.06 * grain + 0.2 * (np.sin(columns / 3.1 + 4.0 * np.sin(rows / 60.0)) > 0.6)
    for _ in range(25):
        top, left = random.integers(0, HEIGHT - 30), random.integers(0, width - 30)
        bottom, right = top + random.integers(20, 260), left + random.integers(10, 240)
        light[top:bottom, left:right] *= random.uniform(0.3, 1.9)
    light[120:330, 880:1010] = 215.0
    return np.clip(light, 3.0, 235.0)


def _draw(number: int, stage: _Stage) -> tuple[np.ndarray, ...]:
    random, rows = stage.random, np.arange(HEIGHT)
    depth = 3.6 + 0.8 * np.sin(rows / 410.0 + 0.05 * number) + 0.02 * number
    albedo = 0.55 + 0.4 * np.sin(rows / 37.0 + 0.1 * number)
    for start, end, metres, drift, shade in stage.furniture:
        part = slice(max(start + int(drift * number), 0), max(end + int(drift * number), 0))
        depth[part], albedo[part] = metres + 0.002 * (rows[part] - start), shade
    depth = np.clip(depth, _NEAR_M, _FAR_M)
    u = np.array([np.interp(depth[v], stage.range_of_column[v], stage.knots) for v in rows])
    height = np.clip(1500.0 * albedo / depth**2, 20.0, 200.0)
    lit = ~_runs(random, 0.07, 25)
    second = _runs(random, 0.15, 30)
    # A reflection keeps its distance within a run.
    offset = np.repeat(random.choice([-1.0, 1.0], 64) * random.uniform(18.0, 260.0, 64), HEIGHT // 64)
    mirrored = u + offset + 3.0 * np.sin(rows / 9.0)
    strength = np.repeat(random.uniform(0.3, 1.15, 64), HEIGHT // 64) * height
    sigma = 1.5 + 0.6 * np.sin(rows / 75.0) ** 2

    off = stage.panorama[:, 3 * number : 3 * number + WIDTH]
    columns = np.arange(WIDTH, dtype=np.float32)[None, :]
    on = off + _stripe(columns, u, lit * height, sigma)
    on = on + _stripe(columns, mirrored, (second & lit) * strength, 1.4 * sigma)
    frames = [_expose(light, random) for light in (on, off)]
    return *frames, u.astype(np.float32), lit, second & lit


def _stripe(columns: np.ndarray, u: np.ndarray, height: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    u, height, sigma = (values.astype(np.float32)[:, None] for values in (u, height, sigma))
    return height * np.exp(-0.5 * ((columns - u) / sigma) ** 2)


def _expose(light: np.ndarray, random: np.random.Generator) -> np.ndarray:
    noise = np.sqrt(READ_DN**2 + light / ELECTRONS_PER_DN) * random.standard_normal(light.shape, np.float32)
    return np.clip(np.round(light + noise), 0, 255).astype(np.uint8)


def _runs(random: np.random.Generator, share: float, length: int) -> np.ndarray:
    """Rows in runs of about `length` that are `share` of all."""
    chosen = np.zeros(HEIGHT, bool)
    while chosen.mean() < share:
        start = random.integers(0, HEIGHT)
        chosen[start : start + random.integers(length // 2, 2 * length)] = True
    return chosen
