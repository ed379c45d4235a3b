"""Sweeps without laser-off images beside the same sweeps with them; and sweeps in which no laser is lit.

A furnished room of the simulator, 48 steps of 2 degrees, in mono and in colour, at several powers of the laser; and the
real pictures of tests/data/ciclop. Found: lines with the laser's light within 1.5 px, of all that the pair gives.
False: stripes off the laser's light, of all that are accepted. A table goes to experiments/results/without_off.md.

    python -m experiments.without_off [--steps N]
"""

import itertools
import tomllib
from dataclasses import replace
from importlib.resources import files

import cv2
import numpy as np

import jaxscan
from experiments.report import RESULTS, ROOT, command_line, table
from jaxscan.errors import CaptureError
from jaxscan.reconstruction import ReconstructSettings, Sweep, extract
from jaxscan.simulation import SimulationConfig, develop, expect_sweep, expose, true_scanner


CICLOP = ROOT / "tests" / "data" / "ciclop"
SETTINGS = ReconstructSettings(min_range_m=0.5, max_range_m=5.0)
WORLDS = (("mono8", 150.0), ("mono8", 40.0), ("rgb8", 150.0), ("rgb8", 40.0), ("rgb8", 900.0), ("bayer_rggb8", 150.0))
SEED = 7
NEAR_PX = 1.5


def found_in(sweep: Sweep, scanner: jaxscan.Scanner) -> tuple[np.ndarray, np.ndarray, str]:
    """Centres, which of them exist, and the note or refusal."""
    try:
        found = extract(sweep, scanner, settings=SETTINGS)
    except CaptureError:
        return np.zeros(0), np.zeros(0, bool), "refused"
    return np.asarray(found.stripes.u), np.asarray(found.stripes.valid), "doubtful" if found.notes else "accepted"


def room_rows(pixel_format: str, peak_dn: float, steps: int) -> list[list[str]]:
    """Rows of the table for one simulated room."""
    config = tomllib.loads(files("jaxscan.data").joinpath("demo.toml").read_text())
    config["sensor"]["pixel_format"], config["laser"]["peak_dn"] = pixel_format, peak_dn
    spec, rng = SimulationConfig(**config), np.random.default_rng(SEED)
    expected = list(itertools.islice(expect_sweep(spec), steps))
    pairs = [develop(one, spec, rng) for one in expected]
    on, off = (np.stack(frames) for frames in zip(*((one.on, one.off) for one in pairs), strict=True))
    dark = np.stack([expose(one.off, spec.sensor, rng) for one in expected])
    truth = np.stack([one.truth.u for one in expected])
    light = np.stack([one.laser if one.laser.ndim == 2 else one.laser.max(-1) for one in expected])
    sweep = Sweep(on, off, np.array([one.angle for one in expected]), pixel_format=pixel_format)
    scanner, rows = true_scanner(spec), []
    u, valid, verdict = found_in(sweep, scanner)
    cases = (
        ("with off images", sweep),
        ("without", replace(sweep, off=None)),
        ("with off images, no laser", replace(sweep, on=dark)),
        ("without, no laser", replace(sweep, on=dark, off=None)),
    )
    for name, one in cases:
        own, seen, verdict = found_in(one, scanner)
        title = [f"{pixel_format}, {peak_dn:.0f} DN, {name}", verdict]
        if verdict == "refused" or name.endswith("no laser"):
            rows.append([*title, f"{np.count_nonzero(seen)} lines", "", ""])
            continue
        at = np.clip(np.rint(own).astype(int)[..., None] + np.arange(-3, 4), 0, light.shape[2] - 1)
        good = seen & (np.take_along_axis(light, at, 2).max(-1) > 1.0)
        same = good & valid & (np.abs(own - u) < NEAR_PX)
        error = np.median(np.abs(own - truth)[same]) if same.any() else np.nan
        share, false = (
            np.count_nonzero(same) / np.count_nonzero(valid),
            1 - np.count_nonzero(good) / np.count_nonzero(seen),
        )
        rows.append([*title, f"{100 * share:.1f} %", f"{100 * false:.2f} %", f"{error:.3f} px"])
    return rows


def ciclop_rows() -> list[list[str]]:
    """Rows of the table for the real pictures: the pair is the reference."""
    rows = []
    names = (
        ("scene/laser", "scene/laser_background"),
        ("pattern/laser-0-255-255-8", "pattern/laser-background-0-255-255-8"),
    )
    for lit, room in names:
        on, off = (cv2.imread(str(CICLOP / f"{name}.png"))[None, ..., ::-1].copy() for name in (lit, room))
        every = jaxscan.StripeSettings(choice="all")
        pair = jaxscan.extract_stripes(on, off, pixel_format="rgb8", settings=every)
        alone = jaxscan.extract_stripes(on, pixel_format="rgb8")
        bright = (cv2.blur(on[0, ..., 0].astype(np.float32) - off[0, ..., 0], (9, 1))).max(1) > 20
        u, valid = np.asarray(alone.u)[0], np.asarray(alone.valid)[0] & bright
        apart = np.where(np.asarray(pair.valid), np.abs(np.asarray(pair.u) - u), np.inf).min(0)
        good = valid & (apart < 3)
        share, false = np.count_nonzero(good) / np.count_nonzero(bright), np.count_nonzero(valid & ~good) / valid.sum()
        middle = np.median(apart[good])
        numbers = [f"{100 * share:.1f} %", f"{100 * false:.2f} %", f"{middle:.3f} px"]
        rows.append([f"ciclop, {lit}, without", "", *numbers])
    return rows


def main() -> None:
    """Measure, print, and write the table."""
    parser = command_line(__doc__)
    parser.add_argument("--steps", type=int, default=48)
    steps = parser.parse_args().steps
    rows = []
    for pixel_format, peak_dn in WORLDS:
        rows += room_rows(pixel_format, peak_dn, steps)
        print(*rows[-4:], sep="\n", flush=True)
    rows += ciclop_rows() if CICLOP.is_dir() else []
    head = (
        "# Sweeps without laser-off images\n\nWritten by `python -m experiments.without_off`: the demo's room "
        f"({steps} steps of 2 degrees, 640 x 512 px, seed {SEED}) with and without laser-off images, with and without "
        "a lit laser. The error is that of the centres against the truth; of ciclop's pictures against the pair.\n\n"
    )
    text = table(["sweep", "verdict", "found", "false", "median error"], rows)
    (RESULTS / "without_off.md").write_text(f"{head}{text}\n")


if __name__ == "__main__":
    main()
