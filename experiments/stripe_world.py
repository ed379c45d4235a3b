"""Stripes with known truth: incoherent and coherent, their sensor and bound, and second reflections in a room.

Nothing here shares code with the extraction under test: pixels are integrated in closed form, speckle is as an aperture
makes it, noise is Poisson electrons, Gaussian read noise, rounding and clipping. For reflections a furnished room is
rendered once without noise; on a share of its lit rows a second stripe is added as light, before the sensor, in runs of
rows or on single ones. The clean frames and those with reflections share their noise.
"""

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from scipy.fft import ifft2  # type: ignore[import-untyped]
from scipy.special import (
    erf,  # type: ignore[import-untyped]
    ndtr,  # type: ignore[import-untyped]
)
from scipy.stats import poisson  # type: ignore[import-untyped]

import jaxscan
from jaxscan.simulation import (
    CameraSpec,
    ExpectedRecord,
    LaserSpec,
    PlanSpec,
    RoomSpec,
    SensorSpec,
    SimulationConfig,
    TurntableSpec,
    develop,
    expect_sweep,
)


_REACH = 6.5
"""Standard deviations to which a stripe is rendered: beyond is 1e-9 of its peak."""


class Sensor(NamedTuple):
    """Noise of one frame, and the light that is always there."""

    read_dn: float = 1.0
    electrons_per_dn: float = 40.0
    ambient_dn: float = 10.0
    black_dn: float = 0.0
    """Level of a pixel without light."""

    def background_variance(self) -> float:
        """Variance of a pixel beside the stripe, with that of rounding [DN^2]."""
        return self.read_dn**2 + self.ambient_dn / self.electrons_per_dn + 1 / 12

    @classmethod
    def of_difference(cls, sigma_dn: float) -> "Sensor":
        """The sensor whose difference of two dark frames has this standard deviation [DN], noise of all kinds."""
        usual = cls()
        return usual._replace(
            read_dn=float(np.sqrt(0.5 * sigma_dn**2 - usual._replace(read_dn=0).background_variance()))
        )


class Frames(NamedTuple):
    """Pairs of frames uint8 [frames, rows, columns], and the truth [frames, rows]."""

    on: np.ndarray
    off: np.ndarray
    u: np.ndarray


def stripe_level(u: np.ndarray, column: np.ndarray, width: float, amplitude: float) -> np.ndarray:
    """Mean over a pixel of a Gaussian stripe [DN]; `u` and `column` broadcast."""
    upper, lower = (erf((column + side - u) / (math.sqrt(2) * width)) for side in (0.5, -0.5))
    return amplitude * width * math.sqrt(math.pi / 2) * (upper - lower)


def expose(level: np.ndarray, sensor: Sensor, rng: np.random.Generator) -> np.ndarray:
    """One exposure of an expected light [DN above black], uint8."""
    electrons = rng.poisson(np.maximum(level, 0.0) * sensor.electrons_per_dn)
    noisy = electrons / sensor.electrons_per_dn + sensor.read_dn * rng.standard_normal(level.shape) + sensor.black_dn
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def expose_evenly(shape: tuple[int, ...], sensor: Sensor, rng: np.random.Generator) -> np.ndarray:
    """Exposures of the ambient light alone, uint8: the law of `expose`, by inversion, far faster.

    16 random bits choose the code from a table; where they do not suffice, because a step of the
    cumulative distribution lies between them and the next, more are drawn.
    """
    electrons = np.arange(poisson.isf(1e-15, sensor.ambient_dn * sensor.electrons_per_dn) + 1)
    chance = poisson.pmf(electrons, sensor.ambient_dn * sensor.electrons_per_dn)
    edges = np.arange(255) + 0.5
    steps = chance @ ndtr((edges[None, :] - electrons[:, None] / sensor.electrons_per_dn) / sensor.read_dn)
    low = np.searchsorted(steps, np.arange(65536) / 65536, side="right")
    high = np.searchsorted(steps, np.arange(1, 65537) / 65536, side="left")
    table = low.astype(np.uint8)
    bits = rng.integers(0, 65536, shape, np.uint16)
    codes = table[bits]
    open_ = (low != high)[bits]
    share = (bits[open_] + rng.random(np.count_nonzero(open_))) / 65536
    codes[open_] = np.searchsorted(steps, share, side="right")
    return codes


def scattered_course(frames: int, rows: int, columns: int, rng: np.random.Generator) -> np.ndarray:
    """Centres [frames, rows] on slanted lines, each row moved by up to half a pixel.

    Phases are uniform and independent, so that nothing can be learnt about a row from its
    neighbours but roughly where to look.
    """
    slope = rng.uniform(-0.06, 0.06, (frames, 1))
    middle = rng.uniform(0.35, 0.65, (frames, 1)) * columns
    return middle + slope * (np.arange(rows) - rows / 2) + rng.uniform(-0.5, 0.5, (frames, rows))


def curved_course(frames: int, rows: int, columns: int, rng: np.random.Generator) -> np.ndarray:
    """Centres [frames, rows] of continuous, gently curved stripes."""
    v = (np.arange(rows) - rows / 2) / rows
    middle, tilt, sag = (rng.uniform(low, high, (frames, 1)) for low, high in ((0.3, 0.7), (-0.1, 0.1), (-0.15, 0.15)))
    return columns * (middle + tilt * v + sag * v**2)


def render(
    u: np.ndarray, width: float, amplitude: float, columns: int, sensor: Sensor, rng: np.random.Generator
) -> Frames:
    """Pairs of frames with a stripe at `u` [frames, rows]."""
    on, off = (expose_evenly((*u.shape, columns), sensor, rng) for _ in range(2))
    half = int(np.ceil(_REACH * width + 1))
    column = np.rint(u).astype(np.int64)[..., None] + np.arange(-half, half + 1)
    if column.min() < 0 or column.max() >= columns:
        raise ValueError(f"The stripe leaves the image of {columns} columns.")
    level = sensor.ambient_dn + stripe_level(u[..., None], column, width, amplitude)
    np.put_along_axis(on, column, expose(level, sensor, rng), -1)
    return Frames(on, off, u)


def centre_bound(width: float, amplitude: float, sensor: Sensor) -> float:
    """Cramer-Rao bound of the centre [px], root mean square over its phase.

    Amplitude and width are unknown too; a clipped pixel tells nothing. The variance of a sample of
    the difference is the sum of both frames' with rounding, and the stripe's own shot noise. The
    information in the change of that variance with the centre is neglected: less than 1e-3 at 40 e-/DN.
    """
    half = int(np.ceil(_REACH * width + 2))
    column = np.arange(-half, half + 1).astype(float)
    variances = []
    for phase in np.linspace(-0.5, 0.5, 40, endpoint=False):
        truth = np.array([phase, width, amplitude])

        def level(at):
            return stripe_level(np.array([at[0]]), column, at[1], at[2])

        slopes = np.stack([(level(truth + d) - level(truth - d)) / 2e-4 for d in 1e-4 * np.eye(3)], -1)
        stripe = level(truth)
        variance = 2 * sensor.background_variance() + stripe / sensor.electrons_per_dn
        seen = stripe + sensor.ambient_dn < 254.5
        variances.append(np.linalg.inv(slopes[seen].T @ (slopes[seen] / variance[seen, None]))[0, 0])
    return float(np.sqrt(np.mean(variances)))


_FINE = 4
"""Samples of a pixel in each direction: speckle of f/2.8 has no frequencies beyond their Nyquist limit."""
_HALF_WINDOW = 24
"""Pixels on either side of the middle that the stripe may reach."""


class CoherentFrames(NamedTuple):
    """Pairs of frames uint8 [frames, rows, columns], and the truth [frames, rows]."""

    on: np.ndarray
    off: np.ndarray
    u: np.ndarray
    snr: np.ndarray
    """The laser's light on each row's brightest pixel over the noise of the pair there without it [1]."""


class Speckle(NamedTuple):
    """The coherent light, and the aperture through which it comes."""

    contrast: float
    """Standard deviation over mean before pixels integrate it [1]: mean of 1 / contrast^2 patterns."""
    f_number: float
    wavelength_um: float = 0.650
    pixel_um: float = 3.45

    @property
    def grain_px(self) -> float:
        """Width of a grain, wavelength / (2 sin u') [px]."""
        return self.wavelength_um * self.f_number / self.pixel_um

    @property
    def limit_px(self) -> float:
        """The uncertainty C wavelength / (2 pi sin u') of Dorsch, Haeusler and Herrmann [px]."""
        return self.contrast * self.grain_px / np.pi


def pattern(shape: tuple[int, int], speckle: Speckle, rng: np.random.Generator) -> np.ndarray:
    """Speckle of mean 1 on a grid of _FINE samples per pixel: fields behind a round aperture, as many as give it the
    contrast."""
    count = round(1 / speckle.contrast**2)
    frequency = np.hypot(*np.meshgrid(*(np.fft.fftfreq(n, 1 / _FINE) for n in shape), indexing="ij"))
    inside = frequency <= 0.5 / speckle.grain_px
    waves = np.count_nonzero(inside)
    total = np.zeros(shape, np.float32)
    for _ in range(count):
        field = np.zeros(shape, np.complex64)
        field[inside] = rng.standard_normal(waves, np.float32) + 1j * rng.standard_normal(waves, np.float32)
        total += np.abs(ifft2(field)) ** 2
    return total / total.mean()


class Course(NamedTuple):
    """A stripe."""

    u: np.ndarray
    """Centres [frames, rows], within 16 px of the middle of the image; straight between the middles of rows."""
    width: float
    """Standard deviation [px]."""
    amplitude: np.ndarray
    """Peak of each row [DN]."""


def render_coherent(
    stripe: Course, room: np.ndarray, speckle: Speckle, sensor: Sensor, rng: np.random.Generator
) -> CoherentFrames:
    """Pairs of frames with a stripe in the room's light.

    Args:
        room: Light with the laser off [rows, columns], DN above black.
    """
    rows, columns = room.shape
    fine_row = (np.arange(rows * _FINE) + 0.5) / _FINE - 0.5
    first = columns // 2 - _HALF_WINDOW
    fine_column = first + (np.arange(2 * _HALF_WINDOW * _FINE) + 0.5) / _FINE - 0.5
    height = np.interp(fine_row, np.arange(rows), stripe.amplitude)
    lit = np.zeros((len(stripe.u), rows, columns))
    for frame, centre in zip(lit, stripe.u, strict=True):
        at = np.interp(fine_row, np.arange(rows), centre)
        light = height[:, None] * np.exp(-0.5 * ((fine_column[None, :] - at[:, None]) / stripe.width) ** 2)
        light *= pattern(light.shape, speckle, rng)
        pixels = light.reshape(rows, _FINE, 2 * _HALF_WINDOW, _FINE).mean((1, 3))
        frame[:, first : first + 2 * _HALF_WINDOW] = pixels
    on = expose(room + lit, sensor, rng)
    off = expose(np.broadcast_to(room, on.shape), sensor, rng)
    dark = 2.0 * (sensor.read_dn**2 + 1 / 12 + room / sensor.electrons_per_dn)
    return CoherentFrames(on, off, stripe.u, (lit / np.sqrt(dark)).max(2))


RIGHT_PX = 1.5
"""A row is right where it is this close to the truth."""
APART_PX = 12.0
"""Least distance of a reflection from the true stripe."""
LIT_DN = 10.0
"""Peak of the true stripe from which a row counts as lit."""
SHARE = 0.2
"""Lit rows with a reflection."""


class Reflection(NamedTuple):
    """Light that is added to one record."""

    light: np.ndarray
    """[rows, columns], DN."""
    u: np.ndarray
    """Its centre [rows], px."""
    affected: np.ndarray
    """Rows that have one."""


def room_records(angles: int) -> tuple[SimulationConfig, list[ExpectedRecord]]:
    """A sweep of a furnished room without noise, spread over the whole turn."""
    config = SimulationConfig(
        camera=CameraSpec(width=640, height=512, fx=410.0, fy=410.5, cx=322.4, cy=254.1, k1=-0.06, k2=0.02),
        sensor=SensorSpec(psf_px=0.8),
        laser=(
            LaserSpec(baseline_m=0.45, crossing_m=3.2, fan_deg=110.0, waist_mm=1.0, divergence_mrad=0.5, range_m=2.2),
        ),
        turntable=TurntableSpec(direction=(0.012, -0.99989, 0.008), point_m=(0.12, 0.0, -0.06)),
        room=RoomSpec(yaw_deg=50.0),
        plan=PlanSpec(steps=angles),
    )
    return config, list(expect_sweep(config))


def stripe_widths(record: ExpectedRecord) -> np.ndarray:
    """Standard deviation of the true stripe [rows], px, from its light and its peak."""
    columns = np.arange(record.laser.shape[1])
    near = np.abs(columns[None, :] - record.truth.u[:, None]) <= 8
    area = np.where(near, record.laser, 0).sum(1)
    return area / (math.sqrt(2 * math.pi) * np.maximum(record.truth.amplitude, 1e-3))


def lit_rows(record: ExpectedRecord) -> np.ndarray:
    """Rows whose true stripe is no mere glimmer."""
    return record.truth.valid & (record.truth.amplitude >= LIT_DN)


def _rendered(record: ExpectedRecord, u: np.ndarray, peak: np.ndarray, width: np.ndarray, affected: np.ndarray):
    """Light of a reflection; `peak` is the level of a pixel that it is centred on."""
    centre, width = u[:, None], np.where(affected, width, 1.0)[:, None]
    column = np.arange(record.laser.shape[1])[None, :]
    scale = math.sqrt(2.0) * width
    light = 0.5 * (erf((column + 0.5 - centre) / scale) - erf((column - 0.5 - centre) / scale))
    top = erf(0.5 / scale)
    return Reflection(np.where(affected[:, None], peak[:, None] * light / top, 0), u, affected)


def reflections_in_runs(record: ExpectedRecord, wanted: int, strength: float, rng: np.random.Generator) -> Reflection:
    """Runs of 5 to 150 rows, about `wanted` rows in all.

    Half of the runs follow a line or a slight curve of their own, half are the true stripe's smooth
    course seen in a mirror. Brightness: 0.7 to 1.3 times `strength` times that of the true stripe
    in the row, changing along the run; width: 0.8 to 1.6 times.
    """
    truth, lit, widths = record.truth, lit_rows(record), stripe_widths(record)
    rows, columns = record.laser.shape
    u, peak, width, affected = np.zeros(rows), np.zeros(rows), np.ones(rows), np.zeros(rows, bool)
    for _ in range(200):
        missing = wanted - int(affected.sum())
        if missing < 5:
            break
        length = int(rng.integers(5, 151))
        start = int(rng.integers(0, rows - length + 1))
        run = np.arange(start, start + length)
        run = run[lit[run] & ~affected[run]]
        if len(run) < 5:
            continue
        v = run - run.mean()
        if rng.random() < 0.5:
            course = rng.uniform(-0.5, 0.5) * v + rng.uniform(-8, 8) * (v / 75) ** 2
        else:
            mirrored = np.polyfit(v, truth.u[run], min(2, len(run) - 1))
            course = -np.polyval([*mirrored[:-1], 0.0], v)
        course = course + _place(float(truth.u[run].mean()), columns, rng)
        clear = (np.abs(course - truth.u[run]) >= APART_PX) & (course > 6) & (course < columns - 7)
        if clear.mean() < 0.9:
            continue
        run, course, v = run[clear], course[clear], v[clear]
        ends = rng.uniform(0.7, 1.3, 2)
        u[run], affected[run] = course, True
        peak[run] = strength * np.interp(v, [v[0], v[-1]], ends) * truth.amplitude[run]
        width[run] = rng.uniform(0.8, 1.6) * np.median(widths[run])
    return _rendered(record, u, peak, width, affected)


def _place(u: float, columns: int, rng: np.random.Generator) -> float:
    """Middle of a reflection: half of them anywhere, half beside the true stripe, as in a corner."""
    if rng.random() < 0.5:
        return rng.uniform(10, columns - 10)
    return u + rng.choice([-1, 1]) * rng.uniform(APART_PX, 80.0)


def reflections_on_single_rows(
    record: ExpectedRecord, wanted: int, strength: float, rng: np.random.Generator
) -> Reflection:
    """Random rows, each with a reflection at a place of its own; brightness and width as in runs."""
    truth, lit = record.truth, np.flatnonzero(lit_rows(record))
    rows, columns = record.laser.shape
    u = rng.uniform(6, columns - 7, rows)
    chosen = rng.permutation(lit)[:wanted]
    affected = np.zeros(rows, bool)
    affected[chosen] = True
    for _ in range(50):
        close = affected & (np.abs(u - truth.u) < APART_PX)
        u[close] = rng.uniform(6, columns - 7, int(close.sum()))
    affected &= np.abs(u - truth.u) >= APART_PX
    peak = strength * rng.uniform(0.7, 1.3, rows) * truth.amplitude
    return _rendered(record, u, peak, rng.uniform(0.8, 1.6, rows) * stripe_widths(record), affected)


class Score(NamedTuple):
    """Counts of rows by outcome. Only rows count whose stripe is found on the clean frames."""

    lit: int
    clean: int
    """Lit rows that are right on the clean frames: those that count below."""
    affected: int
    right: int
    """Affected rows that are right."""
    reflected: int
    """Affected rows that are on the reflection."""
    missing: int
    """Affected rows without a stripe."""
    right_of_all: int


class Variant(NamedTuple):
    """A kind of reflection."""

    name: str
    draw: Callable[[ExpectedRecord, int, float, np.random.Generator], Reflection]
    strength: float
    least: float | None
    """Least share of right rows among the affected."""


VARIANTS = (
    Variant("runs", reflections_in_runs, 1.0, 0.99),
    Variant("single rows", reflections_on_single_rows, 1.0, 0.99),
    Variant("runs, twice as bright", reflections_in_runs, 2.0, None),
)


def score(config: SimulationConfig, records: list[ExpectedRecord], seed: int) -> dict[str, Score]:
    """One draw of noise and of every kind of reflections over a sweep, through the public call with its defaults."""
    truth, lit = np.stack([r.truth.u for r in records]), np.stack([lit_rows(r) for r in records])
    u_clean, valid_clean = _found(config, records, seed)
    counts = lit & valid_clean & (np.abs(u_clean - truth) <= RIGHT_PX)
    scores = {}
    for number, variant in enumerate(VARIANTS):
        rng = np.random.default_rng([seed, 0, number])
        struck, reflections, owed = [], [], 0.0
        for record in records:
            owed += SHARE * float(lit_rows(record).sum())
            reflection = variant.draw(record, round(owed), variant.strength, rng)
            owed -= float(reflection.affected.sum())
            struck.append(record._replace(laser=record.laser + reflection.light.astype(np.float32)))
            reflections.append(reflection)
        u, valid = _found(config, struck, seed)
        right = counts & valid & (np.abs(u - truth) <= RIGHT_PX)
        affected = counts & np.stack([r.affected for r in reflections])
        on_it = affected & valid & (np.abs(u - np.stack([r.u for r in reflections])) <= 2 * RIGHT_PX)
        masks = lit, counts, affected, right & affected, on_it, affected & ~valid, right
        scores[variant.name] = Score(*(int(mask.sum()) for mask in masks))
    return scores


def _found(config: SimulationConfig, records: list[ExpectedRecord], seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Centres and which are valid. A seed's noise is the same wherever the light is the same."""

    def exposed(job):
        number, record = job
        frames = develop(record, config, np.random.default_rng([seed, 1, number]))
        return frames.on, frames.off

    with ThreadPoolExecutor(2) as pool:
        on, off = zip(*pool.map(exposed, enumerate(records)), strict=True)
    stripes = jaxscan.extract_stripes(np.stack(on), np.stack(off))
    return np.asarray(stripes.u, np.float64), np.asarray(stripes.valid)
