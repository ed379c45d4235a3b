"""The worlds of the experiments: the paper's rig without and with the effects of `configs/unkind.toml`."""

from pathlib import Path

import jaxscan
from jaxscan.simulation import CameraSpec, SimulationConfig


CONFIGS = Path(__file__).resolve().parents[2] / "configs"
WORLDS = {"kind": CONFIGS / "paper.toml", "unkind": CONFIGS / "paper_unkind.toml"}
_QUICK = 0.25
"""Size of the quick images over that of the full ones."""


def world(name: str, *, quick: bool = False) -> SimulationConfig:
    """The configuration of a world.

    Args:
        name: "kind" or "unkind".
        quick: Small images of the same field of view.
    """
    config = jaxscan.load_simulation(WORLDS[name])
    return smaller(config, _QUICK) if quick else config


def smaller(config: SimulationConfig, scale: float) -> SimulationConfig:
    """The same lens on a sensor of larger pixels; blur and grains of speckle keep their size in pixels.

    Args:
        config: The rig.
        scale: New width of the image over the old one.
    """
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
