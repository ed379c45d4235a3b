"""What an experiment of the paper stands on: its world, its folders, its figures and their baseline, its pictures."""

import json
import shutil
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, NamedTuple

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np

import jaxscan
from experiments.report import limits_in_words, within
from jaxscan.simulation import CameraSpec, SimulationConfig


@dataclass(frozen=True)
class Stage:
    """One world of the experiments."""

    world: str
    """ "kind" or "unkind"."""
    config: SimulationConfig
    """The paper's rig in that world; small if `quick`."""
    folder: Path
    """Where products are kept that several experiments use; each is made at its first use."""
    pictures: Path
    quick: bool = False
    started: float = field(default_factory=time.perf_counter)

    @property
    def draws(self) -> int:
        """Number of draws of noise of the paper's protocol."""
        return 2 if self.quick else 30

    def picture(self, name: str) -> Path:
        """Path of a picture: "<name>_<world>.png"."""
        self.pictures.mkdir(parents=True, exist_ok=True)
        return self.pictures / f"{name}_{self.world}.png"

    def product(self, name: str) -> Path:
        """Path of a product; its folder exists."""
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        return path

    def emptied(self, name: str) -> Path:
        """Path of a product that is a folder, which is removed."""
        path = self.product(name)
        shutil.rmtree(path, ignore_errors=True)
        return path

    def say(self, text: str) -> None:
        """Progress, on the error stream."""
        print(f"[{time.perf_counter() - self.started:6.0f} s] {self.world}: {text}", file=sys.stderr, flush=True)

    def generator(self, *numbers: int) -> np.random.Generator:
        """Random numbers of an experiment's own: seeded by the configuration and `numbers`."""
        return np.random.default_rng([self.config.seed, *numbers])


CONFIGS = Path(__file__).resolve().parents[2] / "configs"
WORLDS = {"kind": CONFIGS / "paper.toml", "unkind": CONFIGS / "paper_unkind.toml"}
_QUICK = 0.25
"""Size of the quick images over that of the full ones."""


def world(name: str, *, quick: bool = False) -> SimulationConfig:
    """The configuration of a world."""
    config = jaxscan.load_simulation(WORLDS[name])
    return smaller(config, _QUICK) if quick else config


def smaller(config: SimulationConfig, scale: float) -> SimulationConfig:
    """The same lens on a sensor of larger pixels; blur and grains of speckle keep their size in pixels."""
    camera = config.camera
    update = {name: getattr(camera, name) * scale for name in ("fx", "fy")}
    cx, cy = ((at + 0.5) * scale - 0.5 for at in camera.centre())
    size = {"width": round(camera.width * scale), "height": round(camera.height * scale), "cx": cx, "cy": cy}
    return config.model_copy(update={"camera": camera.model_copy(update=update | size)})


def windowed(config: SimulationConfig, first: int, stop: int) -> SimulationConfig:
    """The same camera, of which only the columns `first` ... `stop` - 1 are read out.

    A camera that reads fewer columns is faster, and so is its simulation. Light and sharpness of a pixel are those of
    the whole image; its fixed pattern is another one.
    """
    camera, (cx, _) = config.camera, config.camera.centre()
    part = camera.model_copy(update={"width": stop - first, "cx": cx - first})
    share = _corner2(part) / _corner2(camera)
    sensor = config.sensor
    sensor = sensor.model_copy(update={"vignetting": sensor.vignetting * share, "psf_edge": sensor.psf_edge * share})
    return config.model_copy(update={"camera": part, "sensor": sensor})


def windowed_scanner(scanner: jaxscan.Scanner, first: int, stop: int) -> jaxscan.Scanner:
    """A calibration of the whole image for the columns `first` ... `stop` - 1."""
    camera = scanner.camera
    part = type(camera)(**{**vars(camera), "cx": camera.cx - first, "width": stop - first})
    return type(scanner)(**{**vars(scanner), "camera": part})


def _corner2(camera: CameraSpec) -> float:
    """Squared distance from the principal point to the farthest corner [px^2]."""
    cx, cy = camera.centre()
    return max(cx, camera.width - 1 - cx) ** 2 + max(cy, camera.height - 1 - cy) ** 2


Direction = Literal["less", "more", "near", "none"]
"""Better are smaller ("less") or larger ("more") values; "near": no change is wanted; "none": it only describes."""
BASELINE = Path(__file__).with_name("baseline")
"""Folder of the committed baseline: a file for each world, and for each quick one."""


class Metric(NamedTuple):
    """One figure."""

    key: str
    """Short name with underscores, unique in its experiment."""
    value: float
    unit: str
    direction: Direction = "none"
    tolerance: float = 0.0
    """How much worse than the baseline it may be, in its unit."""
    paper: float | None = None
    """The paper's figure."""
    low: float | None = None
    high: float | None = None
    """Limits: at least `low`, at most `high`."""
    label: str = ""
    """Its line in the table of results: the method, then the quantity."""

    def met(self) -> bool:
        """Whether it is finite and within its limits, if it has any."""
        return within(self.value, self.low, self.high)

    def wanted(self) -> str:
        """Its limits in words."""
        return limits_in_words(self.low, self.high)

    def worse_than(self, baseline: float, tolerance: float) -> bool:
        """Whether it is worse than the baseline by more than the baseline's tolerance."""
        if self.direction == "none":
            return False
        change = self.value - baseline
        if not np.isfinite(change):
            return True
        worse = {"less": change, "more": -change, "near": abs(change)}[self.direction]
        return bool(worse > tolerance)


def shown(value: float) -> str:
    """A value for people: four digits, or two decimals of 1000 and more, so that a room keeps its tenths of a mm."""
    return f"{value:.4g}" if abs(value) < 1000 else f"{value:.2f}"


def line(metric: Metric) -> str:
    """A figure as it is printed."""
    words = {"less": "less is better", "more": "more is better", "near": "no change wanted", "none": ""}
    notes = [words[metric.direction], f"within {metric.tolerance:.2g}" if metric.tolerance else ""]
    notes += [f"paper {metric.paper:g}" if metric.paper is not None else "", metric.wanted()]
    notes += ["" if metric.met() else "MISSED"]
    return f"{metric.key:>44} {shown(metric.value):>12} {metric.unit:<10} " + ", ".join(note for note in notes if note)


def load_baseline(part: str) -> dict[str, tuple[float, float]]:
    """Committed values and tolerances by "experiment.key", of one `part`: a world, or "quick kind"."""
    path = _baseline_path(part)
    return (
        {key: (value, tolerance) for key, (value, tolerance) in json.loads(path.read_text()).items()}
        if path.exists()
        else {}
    )


def save_baseline(part: str, experiment: str, metrics: list[Metric]) -> None:
    """Replace the figures of one experiment; others stay. A figure of which less is better may at most double."""
    kept = {key: value for key, value in load_baseline(part).items() if not key.startswith(f"{experiment}.")}
    for one in metrics:
        tolerance = min(one.tolerance, abs(one.value)) if one.direction == "less" else one.tolerance
        kept[f"{experiment}.{one.key}"] = one.value, tolerance
    BASELINE.mkdir(exist_ok=True)
    lines = [f"{json.dumps(key)}: {json.dumps(value)}" for key, value in sorted(kept.items())]
    _baseline_path(part).write_text("{\n" + ",\n".join(lines) + "\n}\n")


def _baseline_path(part: str) -> Path:
    return BASELINE / f"{part.replace(' ', '_')}.json"


EXPERIMENTS = (
    "table_1", "table_2", "figure_5", "figure_6", "figure_7", "figure_8", "figure_9", "fisheye",
)  # fmt: skip
"""Each is a module with `run(stage) -> list[Metric]`."""


def part_of(world: str, quick: bool) -> str:
    """Name of a world's part of the baseline."""
    return f"quick {world}" if quick else world


def results_path(out: Path, world: str, quick: bool) -> Path:
    """File of the figures of a world."""
    return out / f"{part_of(world, quick).replace(' ', '_')}.json"


mpl.use("Agg")


def save(figure: plt.Figure, path: Path, dpi: int) -> None:
    """Write a picture and free its memory.

    Args:
        dpi: Resolution [dots per inch].
    """
    figure.savefig(path, dpi=dpi)
    plt.close(figure)
