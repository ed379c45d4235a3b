"""Second reflections in a room: stripes of light that are as bright as the true one, elsewhere in the row.

A furnished room is rendered once without noise. On a share of its lit rows a second stripe is added
as light, before the sensor: in runs of rows with a smooth course of its own (a glossy surface shows
the stripe again), or on single rows. The clean frames and those with reflections share their noise.
"""

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from scipy.special import erf  # type: ignore[import-untyped]

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
    """Light of a reflection with this peak on a pixel that it is centred on."""
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

    def plus(self, other: "Score") -> "Score":
        return Score(*(a + b for a, b in zip(self, other, strict=True)))


class Variant(NamedTuple):
    """A kind of reflection."""

    name: str
    draw: Callable[[ExpectedRecord, int, float, np.random.Generator], Reflection]
    strength: float
    asked: float | None
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
