"""The surroundings of an experiment: its world, its folders, and the number of draws."""

import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from jaxscan.simulation import SimulationConfig


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

    def say(self, text: str) -> None:
        """Progress, on the error stream."""
        print(f"[{time.perf_counter() - self.started:6.0f} s] {self.world}: {text}", file=sys.stderr, flush=True)

    def generator(self, *numbers: int) -> np.random.Generator:
        """Random numbers of an experiment's own: seeded by the configuration and `numbers`."""
        return np.random.default_rng([self.config.seed, *numbers])
