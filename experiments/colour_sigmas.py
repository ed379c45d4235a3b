"""Are sigmas of smoothed stripes and of planes honest where neighbouring lines err alike, as colour cameras make them?

The demo's rig leans by up to 20 degrees in a room with furniture, so that its line crosses the rows of flat walls at
slopes from 0 to 0.5; 24 steps a turn, with laser-off images. Each world is taken by a mono camera, a colour camera
without a mosaic, the same through JPEG (quality 90, chroma of half the size), a mosaic that OpenCV demosaics, the same
through JPEG, and the raw mosaic. Truth is that of the simulator. Error over stated sigma is the 0.683 quantile of all
rows whose true line is a cubic over 25 rows. Planes are fitted to the parts of the cloud on the true walls with the
sigmas of the rows; error over stated is the root mean square of all walls and seeds.

Developed on seeds 1 to 3, judged on 11 to 16; limits are 0.85 and 1.2.

    python -m experiments.colour_sigmas [--seeds N …] [--jobs N] [--json FILE]
"""

import sys
import tomllib
from importlib.resources import files
from typing import Any, NamedTuple

import cv2
import numpy as np

from experiments.report import Figure, command_line, conclude, in_processes, progress, rms
from jaxscan.measurement.planes import fitted_plane
from jaxscan.measurement.samples import samples_of
from jaxscan.reconstruction import ReconstructSettings, Sweep, extract, reconstruct
from jaxscan.reconstruction.along import smooth_sweep
from jaxscan.simulation import ExpectedRecord, SimulationConfig, expect_sweep, expose, true_scanner, truth
from jaxscan.stripes import Sites
from jaxscan.vision import through_jpeg


CAMERAS = {
    "mono": "mono8",
    "colour": "rgb8",
    "colour, JPEG": "rgb8",
    "raw mosaic": "bayer_rggb8",
    "demosaiced": "bayer_rggb8",
    "demosaiced, JPEG": "bayer_rggb8",
}
PEAKS_DN = 150.0, 50.0
JUDGED = (11, 12, 13, 14, 15, 16)
STEPS = 24
LOW, HIGH = 0.85, 1.2
SETTINGS = ReconstructSettings(min_range_m=0.5, max_range_m=5.0)
REACH = 12
"""Rows on either side over which the true line is a cubic."""
NEAR_PX, ON_WALL_M, CUBIC_PX = 2.0, 0.002, 0.01
"""Nearest true line of a centre that is none of another thing; distance of true points from their wall;
and of the true line from a cubic."""
MANY = 1000
"""Points of a wall that is fitted."""


def world(pixel_format: str, seed: int) -> SimulationConfig:
    """A leaning rig somewhere in the demo's room."""
    config: dict[str, Any] = tomllib.loads(files("jaxscan.data").joinpath("demo.toml").read_text())
    rng = np.random.default_rng(seed)
    roll, pitch = np.deg2rad(rng.uniform(-20, 20, 2))
    x, y = rng.uniform(-0.4, 0.4), rng.uniform(-0.5, 0.5)
    config["seed"], config["plan"]["steps"] = seed, STEPS
    config["sensor"]["pixel_format"], config["laser"]["peak_dn"] = pixel_format, PEAKS_DN[0]
    config["room"] |= {"yaw_deg": float(rng.uniform(0, 360)), "rig_m": [2.0 + x, 2.6 + y, 1.2]}
    upward = np.sin(roll) * np.cos(pitch), -np.cos(roll) * np.cos(pitch), np.sin(pitch)
    config["turntable"]["direction"] = [float(part) for part in upward]
    return SimulationConfig(**config)


def taken(light: np.ndarray, camera: str, config: SimulationConfig, rng: np.random.Generator) -> np.ndarray:
    """A frame as the camera hands it out."""
    frame = expose(light, config.sensor, rng)
    if camera.startswith("demosaiced"):
        frame = cv2.cvtColor(frame, cv2.COLOR_BayerRGGB2RGB)
    return through_jpeg(frame, 90) if camera.endswith("JPEG") else frame


class Judged(NamedTuple):
    """One world and camera."""

    centres: np.ndarray
    """Error over stated sigma of smoothed centres on smooth lines [n]."""
    walls: list[float]
    """The same of walls, at the middle of their points."""


def judged(camera: str, config: SimulationConfig, expected: list[ExpectedRecord], power: float) -> Judged:
    """A sweep by one camera against the truth, by a part of the laser's power."""
    rng = np.random.default_rng([config.seed, 1])
    frames = [[taken(one.off + lit * power * one.laser, camera, config, rng) for lit in (1.0, 0.0)] for one in expected]
    on, off = (np.stack(kind) for kind in zip(*frames, strict=True))
    pixel_format = "rgb8" if camera.startswith("demosaiced") else CAMERAS[camera]
    scanner = true_scanner(config)
    sweep = Sweep(on, off, np.array([one.angle for one in expected]), pixel_format=pixel_format)
    stripes = extract(sweep, scanner, settings=SETTINGS).stripes
    smoothed = smooth_sweep(stripes, {0: Sites(line_step=2)} if camera == "raw mosaic" else {})
    u, valid, xyz = (np.stack([getattr(one.truth, name) for one in expected]) for name in ("u", "valid", "xyz"))
    true = valid & np.asarray(stripes.valid) & (np.abs(np.asarray(stripes.u) - u) < NEAR_PX)
    smooth = true & on_smooth_lines(u, valid)
    cloud = reconstruct(sweep, scanner, stripes=stripes, smoothed=smoothed, settings=SETTINGS)
    walls = []
    for plane in truth(config)["room"]["planes"]:
        normal = np.array(plane["normal"])
        lit = smooth & np.asarray(cloud.valid) & (np.abs(xyz @ normal - plane["distance_m"]) < ON_WALL_M)
        if np.count_nonzero(lit) >= MANY:
            samples = samples_of(cloud).take(lit[np.asarray(cloud.valid)])
            found = fitted_plane(samples, normal)
            off_wall = normal @ found.centre - plane["distance_m"]
            walls.append(float(off_wall / np.sqrt(found.covariance[0, 0])))
    return Judged(((smoothed.u - u) / np.maximum(smoothed.sigma, 1e-9))[smooth], walls)


def judged_seed(seed: int) -> dict[str, Judged]:
    """All cameras in one world, by their names."""
    found, kept = {}, dict[str, list[ExpectedRecord]]()
    for camera, pixel_format in CAMERAS.items():
        config = world(pixel_format, seed)
        if pixel_format not in kept:
            kept[pixel_format] = list(expect_sweep(config))
        for peak in PEAKS_DN:
            one = judged(camera, config, kept[pixel_format], peak / PEAKS_DN[0])
            found[f"{camera}, {peak:.0f} DN"] = one
            progress(f"seed {seed}, {camera}, {peak:.0f} DN: {quantile(one.centres):.2f}, {rms(one.walls):.2f}")
    return found


def quantile(values: np.ndarray) -> float:
    """Size below which are as many as within one standard deviation."""
    return float(np.quantile(np.abs(values), 0.6827)) if len(values) else float("nan")


def on_smooth_lines(u: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Rows about which the true line is a cubic."""
    x = np.arange(-REACH, REACH + 1.0)
    design = np.vander(x, 4)
    left = np.eye(len(x)) - design @ np.linalg.pinv(design)
    view = lambda field: np.lib.stride_tricks.sliding_window_view(field, len(x), 1)
    found = np.zeros(u.shape, bool)
    found[:, REACH:-REACH] = view(valid).all(2) & (np.abs(view(u) @ left).max(2) < CUBIC_PX)
    return found


def main() -> int:
    """Measure and print."""
    parser = command_line(__doc__, json=True)
    parser.add_argument("--seeds", type=int, nargs="+", default=JUDGED)
    parser.add_argument("--jobs", type=int, default=1, help="processes, each of which takes a seed")
    arguments = parser.parse_args()
    each_seed = in_processes(judged_seed, arguments.seeds, arguments.jobs)
    found = {name: [of_seed[name] for of_seed in each_seed] for name in each_seed[0]}
    figures = []
    for name, each in found.items():
        centres, walls = (np.concatenate([one[kind] for one in each]) for kind in (0, 1))
        figures.append(Figure(f"{name}: centres", quantile(centres), "1", LOW, HIGH))
        figures.append(Figure(f"{name}: {len(walls)} walls", rms(walls), "1", LOW, HIGH))
    return conclude("colour-sigmas", figures, arguments.json)


if __name__ == "__main__":
    sys.exit(main())
