"""`jaxscan console`: the scan from a web page."""

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxscan.cli.options import ConfigPath, OptionalCalibrationPath, check_paths, need_pages
from jaxscan.cli.terminal import console as console_of
from jaxscan.cli.terminal import emit_json


if TYPE_CHECKING:
    from scanrig.config import RigConfig

    from jaxscan.calibration import Calibration

PORT = 8642
CAPTURES = Path("captures")


def console(
    config: ConfigPath,
    /,
    *,
    captures: Path = CAPTURES,
    calibration: OptionalCalibrationPath = None,
    port: str | None = None,
    place_command: str | None = None,
    host: str = "127.0.0.1",
    web_port: int = PORT,
) -> None:
    """Scan from a web page: `jaxscan console scan.toml`.

    Open the address that it prints in a browser. The page has the camera's picture, the calibration of the rig, the
    scan and what was captured. Ctrl-C ends it with the laser off.

    Args:
        config: Configuration of the rig and of the scan (`jaxscan init scan.toml` writes one).
        captures: Folder in which captures, calibrations and clouds are kept.
        calibration: Calibration of the rig; with it the cloud grows during the scan. Without it the newest good one of
            this rig in the folder or beside it.
        port: Serial port instead of the port in the configuration; "auto" takes the only controller there is.
        place_command: Command that places the board; the number of the pose is appended to it, and `none` at the end.
        host: Name or number of this machine at which the page is served. Everybody needs the token of the address that
            is printed.
        web_port: TCP port of the page; 0 for any that is free.
    """
    need_pages("The console", "console")
    # Imported here, so that other verbs and `--help` load neither hardware drivers nor JAX.
    from scanrig.config import load_rig

    from jaxscan.cli.console.captures import Captures
    from jaxscan.cli.console.desk import Desk
    from jaxscan.cli.console.pages import make_site
    from jaxscan.cli.console.sessions import Sessions
    from jaxscan.cli.console.slate import Slate
    from jaxscan.cli.console.works import Works
    from jaxscan.web import Server, open_address

    check_paths({"CONFIG": config, "--calibration": calibration})
    rig = load_rig(config)
    if calibration is not None:
        import jaxscan

        jaxscan.load_scanner(calibration)
    out = console_of()
    folder = Captures(captures, lambda found: _fits(found, rig))
    calibration = calibration or folder.newest_calibration()
    address = open_address(host, web_port, option="--web-port")
    slate = Slate(
        config=str(config),
        folder=str(captures),
        lasers=[laser.name for laser in rig.laser],
        has_board=rig.board is not None,
        board_aspect=None if rig.board is None else _aspect(rig.board.board().outline()),
        steps=rig.sweep.steps * rig.sweep.turns,
        calibration=None,
        calibrations=[],
        goal_mm=rig.goal_mm,
        camera={"exposure_ms": rig.camera.exposure_ms, "gain_db": rig.camera.gain_db},
        wish={"angle_deg": 0.0, "lit": True, "exposure_ms": None, "gain_db": None, "auto": False},
        doing="nothing",
        finished=0,
        laser="off",
        lost="go on",
        works=[],
        captures=[],
    )
    with ExitStack() as stack:
        works = stack.enter_context(Works(slate, folder))
        desk = Desk(config, slate, out, port)
        Sessions(desk, works, folder, place_command)
        if calibration is not None:
            works.take(calibration)
        works.refresh()
        stack.enter_context(Server(make_site(address, desk, works, folder), address))
        for line in address.invitation():
            out.print(line)
        out.print("Ctrl-C ends the console; the laser goes off.")
        emit_json({"url": address.url(), "captures": str(captures)})
        desk.attend()


def _fits(found: "Calibration", rig: "RigConfig") -> bool:
    """Whether a calibration may be one of this rig: its image is as large, and it has the same lasers."""
    scanner, camera = found.scanner, rig.camera
    if scanner is None:
        return False
    lasers = tuple(laser.name for laser in rig.laser)
    size = scanner.camera.width, scanner.camera.height
    return size == (camera.width, camera.height) and tuple(scanner.laser_names) == lasers


def _aspect(outline: Any) -> float:
    """Width of a board over its height, from its corners [n, 2]."""
    width, height = outline.max(0)[:2] - outline.min(0)[:2]
    return float(width / height)
