"""`jaxscan doctor`: checks the installation, a rig or the images of a capture, and says how to cure each problem."""

import contextlib
import importlib
import os
import platform
from collections.abc import Callable
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar

from jaxscan.cli.help import Arg
from jaxscan.cli.options import check_paths
from jaxscan.cli.progress import progress_bar
from jaxscan.cli.signals import RigInUse
from jaxscan.cli.terminal import Terminal, console, emit_json, table
from jaxscan.errors import CaptureError, DependencyError, JaxscanError, OptionError


class Check(NamedTuple):
    """Result for one part of the installation."""

    name: str
    needed: bool
    works: bool
    detail: str
    without: str = ""
    """What cannot be done without it."""
    extra: str = ""
    """The extra that brings it; none for what every installation has."""


OPTIONAL = {
    "embreex": ("embreex.rtcore_scene", "simulate", "demo, simulate"),
    "pyserial": ("serial", "rig", "scan, console"),
    "aiohttp": ("aiohttp", "console", "console, view"),
    "pye57": ("pye57", "export", "clouds written as E57"),
    "laspy": ("laspy", "export", "clouds as LAS"),
    "lazrs": ("lazrs", "export", "clouds as LAZ"),
    "pyproj": ("pyproj", "export", "convert --epsg"),
    "ezdxf": ("ezdxf", "plan", "drawings as DXF"),
    "ifcopenshell": ("ifcopenshell", "ifc", "rooms as IFC"),
    "fast-simplification": ("fast_simplification", "mesh", "mesh --faces"),
    "open3d": ("open3d", "poisson", "mesh --poisson"),
}
"""Packages that only some work needs: their module, the extra that brings them, and what cannot be done without."""
_SHOWN = 100
"""Problems of a capture that are printed."""


class RigUnwell(JaxscanError):
    """A part of the rig that a scan needs does not work."""


def doctor(
    *,
    port: str | None = None,
    config: Path | None = None,
    camera: str | None = None,
    capture: Annotated[Path | None, Arg("DIR")] = None,
) -> None:
    """Check this machine: `jaxscan doctor`. A rig: `jaxscan doctor --config scan.toml`.

    With a rig the table turns and the laser shines. The exit code is 1 if something that is needed does not work.

    Args:
        port: Examine the controller at this serial port; "auto" takes the only one there is.
        config: Examine the rig that this configuration describes.
        camera: With --config: examine the camera of this id instead. `jaxscan doctor` lists the ids.
        capture: Compare all images of this capture with the sha256 in its journal.
    """
    if camera is not None and config is None:
        raise OptionError(
            "--camera: found without --config, expected with it: the configuration holds the settings of the camera."
        )
    check_paths({"--config": config, "--capture": capture})
    out = console()
    if capture is not None:
        _verify(capture, out)
    elif port is None and config is None:
        _look_at_machine(out)
    else:
        _look_at_rig(port, config, camera, out)


def _look_at_machine(out: Terminal) -> None:
    checks = [
        _try("JAX", True, _jax),
        _try("OpenCV", True, lambda: _version("cv2", "opencv-python-headless")),
        _try("optimistix", True, lambda: _version("optimistix", "optimistix")),
        _try("matplotlib (reports)", False, lambda: _version("matplotlib.figure", "matplotlib")),
    ]
    extras = [
        _try(package, False, partial(_version, module, package))._replace(without=without, extra=extra)
        for package, (module, extra, without) in OPTIONAL.items()
    ]
    out.print(f"Python {platform.python_version()} on {platform.system()} {platform.machine()}, {os.cpu_count()} cores")
    rows = [(check.name, "works" if check.works else "missing", check.detail) for check in checks]
    out.print(table("Installation", ("part", "", "detail"), rows))
    packages = [(one.name, one.detail if one.works else "missing", one.without, one.extra) for one in extras]
    out.print(table("Optional packages", ("package", "", "without it there is no", "extra"), packages))
    for one in extras:
        if not one.works:
            out.print(f"{one.name}: {one.detail}")
    absent = list(dict.fromkeys(one.extra for one in extras if not one.works))
    if absent:
        out.print(f'to have them all: pip install "jaxscan[{",".join(absent)}]"')
    ports, cameras = _found(_ports), _found(_cameras)
    out.print(f"serial ports: {'; '.join(ports) or 'none'}")
    out.print(f"cameras: {'; '.join(cameras) or 'none'}")
    result = {"checks": [check._asdict() for check in (*checks, *extras)], "ports": ports, "cameras": cameras}
    emit_json({"python": platform.python_version(), **result})
    broken = [check.name for check in checks if check.needed and not check.works]
    if broken:
        raise DependencyError(f"{', '.join(broken)} must work and does not: see the table.")


def _look_at_rig(port: str | None, config: Path | None, camera: str | None, out: Terminal) -> None:
    findings: list[dict[str, Any]] = []

    def tell(finding: Any) -> None:
        findings.append({**vars(finding), "values": dict(finding.values)})
        out.print(f"{finding.verdict:>11}  {finding.name}: {finding.found}")
        if finding.do:
            out.print(f"{'':>11}  → {finding.do}")

    # The findings before an error or Ctrl-C are written in any case.
    with contextlib.ExitStack() as stack:
        stack.callback(lambda: emit_json({"rig": findings}))
        examine_rig(port, config, camera, tell, say=lambda text: out.print(f"{'':>11}  {text}", style="dim"))
    wrong = [finding["name"] for finding in findings if finding["verdict"] == "wrong"]
    if wrong:
        raise RigUnwell(f"{', '.join(wrong)} must work and does not: see above.")


def _verify(capture: Path, out: Terminal) -> None:
    from jaxscan.files.capture import read_texts, seal_note, verify_capture

    texts = read_texts(capture)
    with progress_bar("Verifying") as progress:
        found = verify_capture(capture, texts=texts, progress=progress)
    problems = [str(problem) for problem in found]
    for sentence in problems[:_SHOWN]:
        out.print(sentence)
    if len(problems) > _SHOWN:
        out.print(f"and {len(problems) - _SHOWN} more problems; --json lists them all")
    note = seal_note(capture, texts=texts)
    if note:
        out.print(f"note: {note}")
    elif not problems:
        out.print(f"{capture}: all images are as they were written.")
    emit_json({"capture": str(capture), "problems": problems, "notes": [note] if note else []})
    if not problems:
        return
    cures = ["take the records again with jaxscan scan --resume"] * (not all(one.lasting for one in found))
    if any(problem.lasting for problem in found):
        cures.append(
            "the journal or the header has changed since it was written, and new records do not repair it: compare it "
            "with a copy, or take the whole capture again"
        )
    raise CaptureError(f"{capture}: {len(problems)} problems; {'; '.join(cures)}.")


def _found(look: Callable[[], list[str]]) -> list[str]:
    try:
        return look()
    except (ImportError, OSError, JaxscanError) as problem:
        return [f"not looked for ({_first_line(problem)})"]


def _ports() -> list[str]:
    from scanrig.wire import describe, find_ports

    return [describe(info) for info in find_ports()]


def _cameras() -> list[str]:
    from scanrig.cameras import list_cameras

    return list_cameras()


def _try(name: str, needed: bool, look: Callable[[], str]) -> Check:
    try:
        return Check(name, needed, True, look())
    except (ImportError, OSError, JaxscanError, metadata.PackageNotFoundError) as problem:
        return Check(name, needed, False, _first_line(problem))


def _first_line(problem: Exception) -> str:
    return str(problem).splitlines()[0] if str(problem) else repr(problem)


def _version(module: str, package: str) -> str:
    if module == "open3d":
        # It needs a library that its wheel does not name.
        from jaxscan.surface import load_open3d

        load_open3d()
    importlib.import_module(module)
    return metadata.version(package)


def _jax() -> str:
    import jax

    devices = ", ".join(f"{device.platform}:{device.id}" for device in jax.devices())
    return f"{jax.__version__} on {devices}"


T = TypeVar("T")


def examine_rig(
    port: str | None,
    config: Path | None,
    camera: str | None,
    tell: Callable[[Any], None],
    *,
    say: Callable[[str], None],
) -> None:
    """Examine a rig, or a controller alone.

    Args:
        port: Serial port instead of the port in the configuration.
        config: The rig's configuration, where there is one.
        camera: Id of the camera instead of the id in the configuration.
        tell: Called with every `scanrig.doctor.Finding`.
        say: Called with a sentence on each check that takes long.
    """
    from scanrig.cameras import open_camera
    from scanrig.config import load_rig
    from scanrig.controllers import ControllerTable, open_controller
    from scanrig.doctor import Finding, examine

    rig = None if config is None else load_rig(config)
    if rig is not None and camera is not None:
        rig = rig.model_copy(update={"camera": rig.camera.model_copy(update={"id": camera})})

    def opened(name: str, open_it: Callable[[], T]) -> T | None:
        try:
            return open_it()
        except JaxscanError as problem:
            tell(Finding(name, "wrong", " ".join(str(problem).split())))
            return None

    with contextlib.ExitStack() as stack:
        in_use = stack.enter_context(RigInUse())
        table, turn = (ControllerTable(), 0) if rig is None else (rig.controller, rig.microsteps_per_turn)
        controller = opened("port", lambda: open_controller(table, turn, port=port))
        if controller is not None:
            stack.enter_context(controller)
            tell(Finding("port", "works", controller.name))
        device = None if rig is None else opened("camera", lambda: open_camera(rig.camera, say))
        if device is not None:
            stack.enter_context(device)
        stack.callback(in_use.closing)
        examine(controller, device, rig, folder=Path.cwd(), tell=tell, say=say)
