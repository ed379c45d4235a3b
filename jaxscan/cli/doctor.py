"""`jaxscan doctor`: what is installed, what is missing, and what to do about it."""

import importlib
import os
import platform
from collections.abc import Callable
from importlib import metadata
from typing import NamedTuple

from jaxscan.cli.output import JsonTarget, console, emit_json, table
from jaxscan.errors import DependencyError, JaxscanError


class Check(NamedTuple):
    """One thing that was tried."""

    name: str
    needed: bool
    works: bool
    detail: str


def doctor(*, json: JsonTarget = None) -> None:
    """Check this machine: `jaxscan doctor`. Exit code 1 where something needed does not work.

    Args:
        json: Write the result as JSON too.
    """
    checks = [
        _try("JAX", True, _jax),
        _try("OpenCV", True, lambda: _version("cv2", "opencv-python-headless")),
        _try("Numba", True, lambda: _version("numba", "numba")),
        _try("optimistix", True, lambda: _version("optimistix", "optimistix")),
        _try("Open3D (simulator)", False, _open3d),
        _try("matplotlib (reports)", False, lambda: _version("matplotlib.figure", "matplotlib")),
        _try("pyserial (rig)", False, lambda: _version("serial", "pyserial")),
        _try("E57 export", False, lambda: _version("pye57", "pye57")),
        _try("LAS/LAZ export", False, lambda: _version("laspy", "laspy")),
    ]
    out = console(json)
    out.print(f"Python {platform.python_version()} on {platform.system()} {platform.machine()}, {os.cpu_count()} cores")
    rows = [(check.name, "works" if check.works else "missing", check.detail) for check in checks]
    out.print(table("Installation", ("what", "", "detail"), rows))
    emit_json(json, "doctor", {"python": platform.python_version(), "checks": [check._asdict() for check in checks]})
    broken = [check.name for check in checks if check.needed and not check.works]
    if broken:
        raise DependencyError(f"{', '.join(broken)} must work and does not: see the table.")


def _try(name: str, needed: bool, look: Callable[[], str]) -> Check:
    try:
        return Check(name, needed, True, look())
    except (ImportError, OSError, JaxscanError, metadata.PackageNotFoundError) as problem:
        return Check(name, needed, False, str(problem).splitlines()[0] if str(problem) else repr(problem))


def _version(module: str, package: str) -> str:
    importlib.import_module(module)
    return metadata.version(package)


def _jax() -> str:
    import jax

    devices = ", ".join(f"{device.platform}:{device.id}" for device in jax.devices())
    return f"{jax.__version__} on {devices}"


def _open3d() -> str:
    from jaxscan.simulation.open3d import load_open3d

    return str(load_open3d().__version__)
