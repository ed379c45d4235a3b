"""Opens the parts of a rig that are there, has them examined, and closes them with the laser off."""

import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from jaxscan.cli.process.signals import RigInUse
from jaxscan.errors import JaxscanError


if TYPE_CHECKING:
    from scanrig.config import RigConfig

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
        tell: Called with every `scanrig.doctor.findings.Finding`.
        say: Called with a sentence on each check that takes long.

    Raises:
        ConfigError: If the configuration cannot be read.
    """
    from scanrig.cameras import open_camera
    from scanrig.config import load_rig
    from scanrig.controllers import ControllerTable, open_controller
    from scanrig.doctor import Finding, Patient, examine

    rig = None if config is None else _with_camera(load_rig(config), camera)

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
        examine(Patient(controller, device, rig), folder=Path.cwd(), tell=tell, say=say)


def _with_camera(rig: "RigConfig", camera: str | None) -> "RigConfig":
    if camera is None:
        return rig
    return rig.model_copy(update={"camera": rig.camera.model_copy(update={"id": camera})})
