"""Accuracy of stripe centres against the Cramer-Rao bound, and shares of rows found, missed, invented or mistaken.

Everything uses the public call with its default settings, on frames from an independent renderer
(`stripe_world.py`), once with known noise and once with noise estimated from the frames:

- cells: error over the bound, bias over the sub-pixel phase and honesty of sigma, width by amplitude;
- narrow: the same at 0.7 px; over-exposed: at 2.4 times full scale;
- faint: 12 DN in noise of 3 DN, and rows invented where there is no stripe;
- reflections: rows mistaken in a furnished room;
- speckle: error over the limit of coherent light, where it is the noise that counts.

Without --only and --quick a page is written to experiments/results. The exit code is
1 if a figure misses its limit.

    python -m experiments.stripe_accuracy [--only SECTION] [--quick] [--json FILE] [--results DIR]
"""

import math
import sys
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

import jaxscan
from experiments import stripe_world
from experiments.report import RESULTS, Figure, command_line, conclude, figure_table, machine, rms, table
from experiments.stripe_world import (
    Course,
    Sensor,
    Speckle,
    centre_bound,
    curved_course,
    expose_evenly,
    render,
    render_coherent,
    scattered_course,
)
from jaxscan.reconstruction.along import smooth_sweep
from jaxscan.stripes import NoiseModel


class Cell(NamedTuple):
    """One width and amplitude, with one kind of noise model."""

    width: float
    amplitude: float
    noise: str
    rows: int
    valid: float
    bound: float
    rms: float
    bias: float
    """Largest mean error of a phase bin [px]."""
    bias_error: float
    """Largest standard error of a bin's mean [px]."""
    honesty: float
    """Reported sigma over true error, both root mean square."""

    @property
    def ratio(self) -> float:
        return self.rms / self.bound


def cell_figures(cells: list[Cell], section: str) -> list[Figure]:
    """The figures of each cell, with their limits."""
    out = []
    for cell in cells:
        key = f"{section}_{cell.width:g}px_{cell.amplitude:g}dn_{cell.noise}"
        out.append(Figure(f"{key}_valid", cell.valid, "of rows"))
        out.append(Figure(f"{key}_sigma_over_error", cell.honesty, "1", 0.9, 1.1))
        if section == "over_exposed":
            out.append(Figure(f"{key}_rms", cell.rms, "px", high=0.02))
            out.append(Figure(f"{key}_rms_over_bound", cell.ratio, "1"))
        else:
            out.append(Figure(f"{key}_rms_over_bound", cell.ratio, "1", high=1.10 if section == "narrow" else 1.05))
        out.append(Figure(f"{key}_bias", cell.bias, "px", high=0.005 if section == "cells" else None))
    return out


def cell_table(cells: list[Cell], section: str) -> str:
    """A Markdown table: a row per cell, both noise models side by side."""
    head = ["width px", "amplitude DN", "rows", "bound px", "valid", "RMS px", "RMS/bound", "bias px", "± px"]
    out = []
    pairs = zip(cells[::2], cells[1::2], strict=True)
    for known, estimated in pairs:
        both = [f"{getattr(known, name):{form}}, {getattr(estimated, name):{form}}" for name, form in _COLUMNS]
        holds = all(figure.met() for figure in cell_figures([known, estimated], section))
        place = [f"{known.width:g}", f"{known.amplitude:g}", f"{known.rows}", f"{known.bound:.4f}"]
        out.append([*place, *both[:4], f"{known.bias_error:.4f}", both[4], "" if holds else "MISSED"])
    return table([*head, "sigma/error", ""], out)


_COLUMNS = (("valid", ".4f"), ("rms", ".4f"), ("ratio", ".3f"), ("bias", ".4f"), ("honesty", ".3f"))


CONTRASTS, F_NUMBERS = (1.0, 0.5, 0.2), (2.8, 5.6, 8.0)
_SENSOR = Sensor(read_dn=1.7, electrons_per_dn=8.0, ambient_dn=0.0, black_dn=5.0)
_WIDTH, _SPECKLE_ROWS, _SPECKLE_COLUMNS, _FRAMES = 1.3, 512, 192, 12
_CLASSES = ((30.0, 80.0), (80.0, 130.0), (130.0, 180.0), (180.0, 230.0))
"""Amplitudes [DN]."""


def measure_speckle(*, quick: bool, seed: int) -> list[Figure]:
    """Figures of every contrast and aperture."""
    speckles = [Speckle(contrast, f_number) for contrast in CONTRASTS for f_number in F_NUMBERS]
    return [figure for each in speckles for figure in _speckle_figures(each, 4 if quick else _FRAMES, seed)]


def _speckle_figures(speckle: Speckle, frames: int, seed: int) -> list[Figure]:
    rng = np.random.default_rng([seed, 41, round(100 * speckle.contrast), round(10 * speckle.f_number)])
    v = (np.arange(_SPECKLE_ROWS) - _SPECKLE_ROWS / 2) / _SPECKLE_ROWS
    middle, tilt, sag = (rng.uniform(-a, a, (frames, 1)) for a in (2.0, 8.0, 6.0))
    u = _SPECKLE_COLUMNS / 2 + middle + tilt * v + sag * v**2
    amplitude = 130.0 - 100.0 * np.cos(8 * np.pi * v)
    room = np.linspace(3.0, 70.0, _SPECKLE_COLUMNS)[None, :] * np.linspace(1.0, 0.4, _SPECKLE_ROWS)[:, None]
    pairs = render_coherent(Course(u, _WIDTH, amplitude), room, speckle, _SENSOR, rng)
    found = jaxscan.extract_stripes(pairs.on, pairs.off)
    centre, sigma, valid = (np.asarray(field) for field in (found.u, found.sigma, found.valid))
    level, error, line = np.broadcast_to(amplitude, u.shape), centre - u, smooth_sweep(found)
    honest = [_ratio(sigma, error, valid & (level >= low) & (level < high)) for low, high in _CLASSES]
    rows = {
        "limit": (speckle.limit_px, "px"),
        "valid": (float(valid[pairs.snr > 5].mean()), "of rows with light over 5 sigma", 0.99),
        "row_rms_over_limit": (rms(error[valid]) / speckle.limit_px, "1"),
        "row_sigma_over_error": (_ratio(sigma, error, valid), "1", 0.9, 1.1),
        "row_sigma_over_error_least_of_4_amplitudes": (min(honest), "1", 0.9, 1.1),
        "row_sigma_over_error_most_of_4_amplitudes": (max(honest), "1", 0.9, 1.1),
        "row_beyond_5_sigma": (float(np.mean(np.abs(error)[valid] > 5 * sigma[valid])), "of rows", None, 1e-3),
        "line_rms_over_limit": (rms((line.u - u)[valid]) / speckle.limit_px, "1"),
        "line_sigma_over_error": (_ratio(line.sigma, line.u - u, valid), "1", 0.9, 1.1),
    }
    key = f"speckle_{speckle.contrast:g}_at_f{speckle.f_number:g}"
    return [Figure(f"{key}_{name}", *row) for name, row in rows.items()]


def _ratio(sigma: np.ndarray, error: np.ndarray, valid: np.ndarray) -> float:
    """Stated over true, both root mean square."""
    return rms(sigma[valid]) / rms(error[valid])


WIDTHS = (1.0, 1.25, 1.5, 2.0, 2.5, 3.0)
AMPLITUDES = (20.0, 40.0, 60.0, 120.0, 180.0, 240.0)
NARROW = 0.7
OVER_EXPOSED = 2.4 * 255
COLUMNS, ROWS = 256, 1024
BATCH = 16
"""Frames per call."""
PHASES = 10
BIAS_ERROR_PX = 0.00095
"""Standard error of a phase bin's mean that sets the number of rows, where the bound is reached."""
NOISES = ("known", "estimated")


def extracted(on: np.ndarray, off: np.ndarray, noise: NoiseModel | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """u, sigma, valid of every row, by the public call."""
    stripes = jaxscan.extract_stripes(on, off, noise=noise)
    return np.asarray(stripes.u, np.float64), np.asarray(stripes.sigma, np.float64), np.asarray(stripes.valid)


def models(sensor: Sensor) -> dict[str, NoiseModel | None]:
    """Noise models that the extraction is given; None: it estimates the noise."""
    return {"known": NoiseModel(sensor.read_dn, sensor.electrons_per_dn), "estimated": None}


def measure_cell(width: float, amplitude: float, *, quick: bool, seed: int) -> list[Cell]:
    """Measure one width and amplitude.

    The standard error of the bias sets the number of rows; there are at least 32768, which give a root mean square to
    0.4 %.
    """
    sensor = Sensor()
    bound = centre_bound(width, amplitude, sensor)
    batches = 1 if quick else max(2, math.ceil(PHASES * (bound / BIAS_ERROR_PX) ** 2 / (BATCH * ROWS)))
    rng = np.random.default_rng([seed, round(100 * width), round(amplitude)])
    parts: dict[str, list] = {name: [] for name in NOISES}
    for _ in range(batches):
        frames = render(scattered_course(BATCH, ROWS, COLUMNS, rng), width, amplitude, COLUMNS, sensor, rng)
        for name, model in models(sensor).items():
            u, sigma, valid = extracted(frames.on, frames.off, model)
            parts[name].append(np.stack([u - frames.u, sigma, frames.u, valid]).reshape(4, -1))
    cells = []
    for name in NOISES:
        error, sigma, truth, valid = np.concatenate(parts[name], -1)
        found = valid > 0
        error, sigma, truth = error[found], sigma[found], truth[found]
        phase = np.floor(PHASES * (truth + 0.5 - np.floor(truth + 0.5))).astype(int)
        bins = [error[phase == k] for k in range(PHASES)]
        found_rms = rms(error)
        cells.append(
            Cell(
                width,
                amplitude,
                name,
                rows=len(found),
                valid=float(found.mean()),
                bound=bound,
                rms=found_rms,
                bias=max(abs(float(b.mean())) for b in bins),
                bias_error=max(float(b.std()) / math.sqrt(len(b)) for b in bins),
                honesty=rms(sigma) / found_rms,
            )
        )
    return cells


def measure_faint(*, quick: bool, seed: int) -> list[Figure]:
    """A faint continuous stripe, and rows invented on frames without one."""
    columns, amplitude, width = 1280, 12.0, 2.0
    sensor = Sensor.of_difference(3.0)
    rng = np.random.default_rng([seed, 12])
    out, counts = [], {name: np.zeros(4) for name in NOISES}
    for _ in range(1 if quick else 4):
        frames = render(curved_course(BATCH, ROWS, columns, rng), width, amplitude, columns, sensor, rng)
        for name, model in models(sensor).items():
            u, _, valid = extracted(frames.on, frames.off, model)
            error = (u - frames.u)[valid]
            close = np.abs(error) <= 1.0
            counts[name] += close.sum(), len(error), (error[close] ** 2).sum(), frames.u.size
    for name in NOISES:
        near, found, square, total = (float(count) for count in counts[name])
        out.append(Figure(f"faint_{name}_within_1px", near / total, "of rows", low=0.98))
        out.append(Figure(f"faint_{name}_valid", found / total, "of rows"))
        out.append(Figure(f"faint_{name}_beyond_1px", (found - near) / total, "of rows"))
        out.append(Figure(f"faint_{name}_rms_within_1px", math.sqrt(square / max(near, 1)), "px"))
    bound = centre_bound(width, amplitude, sensor)
    out.append(Figure("faint_bound", bound, "px"))
    # Of errors that are Gaussian and at the bound, so many are within 1 px.
    out.append(Figure("faint_within_1px_at_the_bound", math.erf(1.0 / (math.sqrt(2.0) * bound)), "of rows"))
    for words, dark in (("faint", sensor), ("usual", Sensor())):
        invented, rows = dict.fromkeys(NOISES, 0), 0
        for _ in range(1 if quick else 13):
            on, off = (expose_evenly((BATCH, ROWS, columns), dark, rng) for _ in range(2))
            rows += BATCH * ROWS
            for name, model in models(dark).items():
                invented[name] += int(extracted(on, off, model)[2].sum())
        out += [
            Figure(f"invented_{words}_noise_{name}", invented[name] / rows, "of rows", high=0.001) for name in NOISES
        ]
        out.append(Figure(f"invented_{words}_noise_rows", rows, "rows"))
    return out


def measure_reflections(*, quick: bool, seed: int) -> list[Figure]:
    """Rows that are mistaken in a room with second reflections."""
    config, records = stripe_world.room_records(6 if quick else 24)
    draws = [stripe_world.score(config, records, seed + number) for number in range(1 if quick else 8)]
    out = []
    for variant in stripe_world.VARIANTS:
        total = stripe_world.Score(*np.sum([scores[variant.name] for scores in draws], 0).tolist())
        key = "reflections_" + variant.name.replace(", ", "_").replace(" ", "_")
        affected = max(total.affected, 1)
        out.append(Figure(f"{key}_right", total.right / affected, "of affected rows", low=variant.least))
        shares = {"on_the_reflection": total.reflected, "missing": total.missing}
        out += [Figure(f"{key}_{name}", count / affected, "of affected rows") for name, count in shares.items()]
        out.append(Figure(f"{key}_affected", total.affected, "rows"))
        out.append(Figure(f"{key}_right_of_all", total.right_of_all / max(total.clean, 1), "of rows"))
        out.append(Figure(f"{key}_found_on_clean_frames", total.clean / total.lit, "of lit rows"))
    return out


SECTIONS = ("cells", "narrow", "over_exposed", "faint", "reflections", "speckle")
TITLES = {
    "cells": "Width by amplitude (limits: RMS ≤ 1.05 of the bound, bias ≤ 0.005 px, sigma 0.9–1.1 of the error)",
    "narrow": "Narrow stripes (limits: RMS ≤ 1.10 of the bound, sigma 0.9–1.1 of the error)",
    "over_exposed": "Over-exposed 2.4 times (limits: RMS ≤ 0.02 px, sigma 0.9–1.1 of the error)",
    "faint": "A stripe of 12 DN, 2 px wide, in noise of 3 DN of the difference; and no stripe at all",
    "speckle": "Where speckle rules: contrast 1, 0.5, 0.2 at f/2.8, 5.6, 8; its limit is C lambda / (2 pi sin u')",
    "reflections": "Second reflections on a fifth of the lit rows of a furnished room",
}


_MEASURES = {"faint": measure_faint, "reflections": measure_reflections, "speckle": measure_speckle}


def measure(section: str, *, quick: bool, seed: int) -> tuple[str, list[Figure]]:
    """A section's table and figures."""
    places = {
        "cells": [(width, amplitude) for width in WIDTHS for amplitude in AMPLITUDES],
        "narrow": [(NARROW, amplitude) for amplitude in AMPLITUDES],
        "over_exposed": [(width, OVER_EXPOSED) for width in WIDTHS],
    }
    if section in places:
        cells = [cell for place in places[section] for cell in measure_cell(*place, quick=quick, seed=seed)]
        return cell_table(cells, section), cell_figures(cells, section)
    figures = _MEASURES[section](quick=quick, seed=seed)
    return figure_table(figures), figures


HEAD = """# Stripe centres: accuracy

{machine}; {seconds:.0f} s.
{kept} of {limited} figures keep their limits. Written by `python -m experiments.stripe_accuracy`; default settings, one
configuration for all. Noise: read 1 DN, 40 e-/DN, rounding to 8 bits, clipping at 255, ambient light of 10 DN in both
images. Where two numbers stand in a field, the first is with the noise known, the second with it estimated from the
frames (whose background has one level only, so that the gain is left at its default, which is true here). The bias is
the largest of the means over ten bins of the phase, ± its standard error. Seed {seed}. The part on speckle is of
another camera (8 e-/DN, read 1.7 DN, black level 5 DN; 12 pairs of 512 lines for each contrast and aperture), and
learns all of its noise from the frames.
"""


def main() -> int:
    """The command."""
    parser = command_line(__doc__, quick="few rows: to see that it runs, its verdicts mean little", json=True)
    parser.add_argument("--only", choices=SECTIONS, action="append", help="a section; may be given several times")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--results", type=Path, default=RESULTS, help="folder of the table")
    options = parser.parse_args()
    start, parts, figures = time.perf_counter(), [], []
    for section in options.only or SECTIONS:
        found, own = measure(section, quick=options.quick, seed=options.seed)
        parts.append(f"## {TITLES[section]}\n\n{found}\n")
        print(parts[-1], file=sys.stderr, flush=True)
        figures += own
    if not (options.only or options.quick):
        limited = [figure for figure in figures if figure.target()]
        kept, seconds = sum(figure.met() for figure in limited), time.perf_counter() - start
        head = HEAD.format(machine=machine(), seconds=seconds, kept=kept, limited=len(limited), seed=options.seed)
        options.results.mkdir(parents=True, exist_ok=True)
        (options.results / "stripe_accuracy.md").write_text("\n".join([head, *parts]))
    code = conclude("stripe-accuracy", figures, options.json, quick=options.quick)
    return 0 if options.quick else code


if __name__ == "__main__":
    sys.exit(main())
