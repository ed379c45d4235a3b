"""Physical speckle on boards and walls: are stripes found, true, and honest about it?

    python -m experiments.unkind.speckle [--seeds 11 20] [--contrasts 0.2 0.45 0.6] [--jobs N] [--worlds FOLDER]
        [--results DIR]

Worlds of `experiments.unkind.simulated` with a lens at f/4 and a laser whose speckle has such a contrast on one pixel,
each calibrated as a user does, camera, sheet and axis from one capture of boards, by jaxscan and by the plain method.
Every figure is printed beside its limit; the exit code is 1 if one is missed. With `--worlds` captures and figures are
kept, and what is there is not made again.
"""

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from experiments.report import Figure, command_line, conclude, figure_table, in_processes, machine, progress, rms
from experiments.unkind import judge, simulated
from experiments.unkind.figures import AMPLITUDES, figure
from jaxscan.errors import CalibrationError
from jaxscan.simulation import SimulationConfig


SEEDS = (11, 20)
"""First and last seed that are judged; 1 to 3 were used while building."""
CONTRASTS = (0.2, 0.45, 0.6)
"""Contrasts of the laser's light on one pixel [1]; 0.6 is all that a lens at f/4 and pixels of 3.45 um leave."""
PEAKS_DN, WHITE_DN = (12.0, 120.0), 20.0
"""Peaks of the stripe on walls, by the seed, and white paper in the dim light of a sweep [DN]: faint stripes occur."""
F_NUMBER, STEPS, FREE_VIEWS = 4.0, 40, 12
HONEST = (0.9, 1.15)
LEAST_DUE = 500
"""Rows from which a class of brightness has figures."""
HEAD = """
# Speckle

`python -m experiments.unkind.speckle --results DIR` writes this page: worlds of `experiments.unkind.simulated` at f/4,
pixels of 3.45 um, and a laser whose light varies by such a contrast from pixel to pixel; 24 views of a board, a sweep
of 40 steps. "plain" is a blur of 1 px, a centre of gravity, and sequential calibration by OpenCV. Figures are medians
or sums over all seeds. Sigmas of points on boards are those of the observation, before the solve weighs them.
"""


def draw_config(seed: int, contrast: float) -> SimulationConfig:
    """The unkind world of a seed, smaller and with such a contrast on a pixel."""
    config = simulated.draw_config(seed)
    sensor = config.sensor.model_copy(update={"f_number": F_NUMBER})
    full = config.laser[0].model_copy(update={"speckle_contrast": 1.0})
    most = simulated.pixel_contrast(config.model_copy(update={"sensor": sensor, "laser": (full,)}))
    peak = float(np.exp(np.random.default_rng([seed, 43]).uniform(*np.log(PEAKS_DN))))
    laser = full.model_copy(update={"speckle_contrast": min(contrast / most, 1.0), "peak_dn": peak})
    light = config.light.model_copy(update={"white_dn": WHITE_DN})
    plan = config.plan.model_copy(update={"steps": STEPS})
    boards = config.boards.model_copy(update={"free_views": FREE_VIEWS})
    changed = {"sensor": sensor, "laser": (laser,), "light": light, "plan": plan, "boards": boards}
    return SimulationConfig.model_validate(config.model_copy(update=changed).model_dump())


def measure(seed: int, contrast: float, folder: Path) -> dict[str, Any]:
    """The figures of one world by both methods; it is rendered and judged where it is not yet."""
    kept = folder / "figures.json"
    if not (folder / "truth.npz").exists():
        simulated.render_config(draw_config(seed, contrast), folder)
    if not kept.exists():
        kept.write_text(json.dumps(judge.judge(folder)))
    found: dict[str, Any] = json.loads(kept.read_text())
    return found


def judged(world: tuple[float, int, Path]) -> dict[str, Any] | None:
    """The figures of the world of a contrast and a seed in a folder of its own; None where calibration refuses it."""
    contrast, seed, folder = world
    name = f"speckle_{contrast:g}_{seed}"
    try:
        found = measure(seed, contrast, folder / name)
    except CalibrationError as problem:
        progress(f"{name}: {problem}")
        return None
    progress(f"{name}: {in_a_line(found)}")
    return found


def figures_of(contrast: float, worlds: list[dict[str, Any]]) -> list[Figure]:
    """The figures of all seeds of one contrast, with their limits."""
    ours, plain = ([world[which] for world in worlds] for which in ("ours", "plain"))

    def each(side: list[dict[str, Any]], *path: str) -> np.ndarray:
        return np.array([figure(one, path) for one in side], float)

    def over_plain(*path: str) -> float:
        return rms(each(ours, *path)) / rms(each(plain, *path))

    honest = each(ours, "observed", "error_over_stated")
    apart = each(ours, "observed", "rms_px") / each(ours, "rows", "rms_px")
    out = [
        Figure("boards: error / stated, median", float(np.median(honest)), "1", *HONEST),
        Figure("boards: error / stated, least", float(honest.min()), "1", *HONEST),
        Figure("boards: error / stated, most", float(honest.max()), "1", *HONEST),
        Figure("boards: RMS", rms(each(ours, "observed", "rms_px")), "px"),
        Figure("boards: RMS over the sweep's, median", float(np.median(apart)), "1", high=1.3),
        Figure("boards: RMS over the sweep's of the same brightness", _like_for_like(ours), "1", high=1.3),
        Figure("boards: points over plain's", over_plain("observed", "points"), "1"),
        Figure("sheet at 2.5 m", rms(each(ours, "rig", "sheet_mm")), "mm"),
        Figure("sheet at 2.5 m over plain's", over_plain("rig", "sheet_mm"), "1", high=0.6),
    ]
    names = [f"{low}-{high}" for low, high in AMPLITUDES]
    for label, chosen in (("all", names), *((f"{name} DN", [name]) for name in names)):
        due, found, other = (
            sum(each(side, "smooth", "classes", name, what).sum() for name in chosen)
            for side, what in ((ours, "due"), (ours, "found"), (plain, "found"))
        )
        if due >= LEAST_DUE:
            out.append(Figure(f"sweep: rows found, {label}", found / due, "1"))
            out.append(Figure(f"sweep: rows found less plain's, {label}", (found - other) / due, "1", low=-0.005))
    for name in names:
        stated = each(ours, "smooth", "classes", name, "stated_over_true")
        if np.isfinite(stated).any():
            out.append(Figure(f"sweep, {name} DN: stated / true, median", float(np.nanmedian(stated)), "1", 0.9, 1.1))
    out.append(Figure("sweep: false points", float(each(ours, "smooth", "false_share").mean()), "1", high=0.005))
    out.append(Figure("sweep: false points, plain", float(each(plain, "smooth", "false_share").mean()), "1"))
    for part, name in (("rows", "sweep by rows"), ("smooth", "sweep")):
        middle = float(np.median(each(ours, part, "stated_over_true")))
        out.append(Figure(f"{name}: stated / true, median", middle, "1", 0.9, 1.1))
        out.append(Figure(f"{name}: RMS over plain's", over_plain(part, "rms_near_px"), "1"))
    return [one._replace(key=f"{contrast:g} {one.key}") for one in out]


def _like_for_like(worlds: list[dict[str, Any]]) -> float:
    """Root mean square of errors on boards, over that of rows of the sweeps as bright: black print is faint."""
    on_boards = own = 0.0
    for low, high in AMPLITUDES:
        name = f"{low}-{high}"
        boards, sweep = (
            [world[part][kind][name] for world in worlds]
            for part, kind in (("observed", "amplitudes"), ("rows", "classes"))
        )
        squares = [sum(one["points"] * one["rms_px"] ** 2 for one in each if one["points"]) for each in (boards, sweep)]
        counts = [sum(one["points"] for one in each) for each in (boards, sweep)]
        if counts[1] >= LEAST_DUE:
            on_boards, own = on_boards + squares[0], own + counts[0] * squares[1] / counts[1]
    return float(np.sqrt(on_boards / own))


def main() -> int:
    """Make and judge the worlds, and write the page."""
    parser = command_line(__doc__, json=True)
    parser.add_argument("--seeds", type=int, nargs=2, default=SEEDS, metavar=("FIRST", "LAST"))
    parser.add_argument("--contrasts", type=float, nargs="+", default=CONTRASTS)
    parser.add_argument("--jobs", type=int, default=1, help="worlds at once, each in a process of about 2 GB")
    parser.add_argument("--worlds", type=Path, metavar="FOLDER", help="where worlds are kept, and taken again")
    parser.add_argument("--results", type=Path, metavar="DIR", help="where the page is written")
    options = parser.parse_args()
    first, last = options.seeds
    found: list[Figure] = []
    with tempfile.TemporaryDirectory() as scratch:
        folder, seeds = options.worlds or Path(scratch), range(first, last + 1)
        worlds = [(contrast, seed, folder) for contrast in options.contrasts for seed in seeds]
        each = in_processes(judged, worlds, options.jobs)
    for number, contrast in enumerate(options.contrasts):
        own = each[number * len(seeds) : (number + 1) * len(seeds)]
        known = [world for world in own if world is not None]
        found.append(Figure(f"{contrast:g} worlds refused", len(own) - len(known), "1", high=0))
        found += figures_of(contrast, known) if known else []
    if options.results:
        text = f"{HEAD.strip()}\n\nSeeds {first} to {last}; {machine()}.\n\n{figure_table(found)}\n"
        (options.results / "speckle.md").write_text(text)
    return conclude("speckle", found, options.json)


def in_a_line(world: dict[str, Any]) -> str:
    """A world in a line, for people who wait."""
    ours, plain = world["ours"], world["plain"]
    pairs = (("sheet", ("rig", "sheet_mm")), ("rows found", ("smooth", "found_share")))
    return ", ".join(f"{name} {figure(ours, path):.3f} (plain {figure(plain, path):.3f})" for name, path in pairs)


if __name__ == "__main__":
    sys.exit(main())
