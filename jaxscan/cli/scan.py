"""`jaxscan scan`: drives a rig and takes a sweep, or a capture of boards; with a calibration also a live cloud."""

import contextlib
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np

from jaxscan import api
from jaxscan.cli.help import Arg
from jaxscan.cli.options import CLOUD_SUFFIXES, ConfigPath, OptionalCalibrationPath, OutputPath, check_paths
from jaxscan.cli.progress import progress_bar
from jaxscan.cli.scan_display import ScanDisplay, ScanPlan, sweep_header
from jaxscan.cli.signals import RigInUse
from jaxscan.cli.terminal import Terminal, console, emit_json
from jaxscan.errors import CaptureError, JaxscanError, OptionError
from jaxscan.files import calibration as calibration_files
from jaxscan.files import capture as capture_files
from jaxscan.files import clouds as cloud_files


if TYPE_CHECKING:
    from scanrig.config import RigConfig
    from scanrig.session import Devices, SessionResult

    from jaxscan.cli.live import LiveCloud


class ScanError(JaxscanError):
    """A scan that is not complete, or whose records are suspect."""


def scan(
    config: ConfigPath,
    /,
    *,
    output: OutputPath,
    boards: bool = False,
    resume: bool = False,
    port: str | None = None,
    calibration: OptionalCalibrationPath = None,
    cloud: Annotated[
        Path | None, Arg(text=f"With --calibration: cloud to write at the end ({CLOUD_SUFFIXES}).")
    ] = None,
    smooth: Literal["off", "edge"] = "edge",
    place_command: str | None = None,
) -> None:
    """Scan with a rig: `jaxscan scan scan.toml -o captures/room`.

    Ctrl-C ends the scan after the current step and switches the laser off. A second Ctrl-C does so at once.

    Args:
        config: Configuration of the rig and of the scan (`jaxscan init scan.toml` writes one).
        output: Folder of the capture.
        boards: Take a capture of the calibration board instead of a sweep; shows which poses are missing.
        resume: Continue a capture that was interrupted.
        port: Serial port instead of the port in the configuration; "auto" takes the only controller there is.
        calibration: Calibration of the rig; with it points are counted during the scan.
        smooth: With --cloud: whether a point uses its neighbours along the stripe, as of `jaxscan reconstruct`.
        place_command: With --boards: command that places the board; the number of the pose is appended to it,
            and `none` at the end.
    """
    # Imported here, so that other verbs and `--help` load neither hardware drivers nor JAX.
    from scanrig.cameras import open_camera
    from scanrig.config import load_rig
    from scanrig.controllers import open_controller
    from scanrig.session import Devices, Interrupts

    from jaxscan.cli.boards import scan_boards
    from jaxscan.cli.live import LiveCloud

    _check_options(boards=boards, calibration=calibration, cloud=cloud, place_command=place_command)
    check_paths(
        {"CONFIG": config, "--calibration": calibration, "--output": output},
        {"--cloud": cloud},
    )
    rig = load_rig(config)
    if boards and rig.board is None:
        raise OptionError(f"{config}: has no [board] table, which --boards needs.")
    if not resume and (output / capture_files.HEADER_NAME).exists():
        raise OptionError(f"--output: {output} holds a capture already; add --resume, or choose another folder.")
    out = console()
    plan = ScanPlan.of(rig, boards=boards)
    plan.show(out, rig, output)
    notes = [*plan.notes]
    with contextlib.ExitStack() as stack:
        live = None
        if calibration is not None:
            scanner = api.load_scanner(calibration)
            doubts = calibration_files.calibration_notes(calibration)
            out.notes(doubts)
            notes += doubts
            settings = api.ReconstructSettings(smooth=smooth)
            header = sweep_header(rig)
            live = stack.enter_context(LiveCloud(output, header, scanner, steps=plan.records, settings=settings))
            if resume and (output / capture_files.HEADER_NAME).exists():
                # A capture without records cannot be opened, and has none to add.
                with contextlib.suppress(CaptureError):
                    live.add_from_disk()
        with contextlib.ExitStack() as opened:
            in_use = opened.enter_context(RigInUse())
            controller = opened.enter_context(open_controller(rig.controller, rig.microsteps_per_turn, port=port))
            camera = opened.enter_context(open_camera(rig.camera, out.print))
            opened.callback(in_use.closing)
            # Ctrl-C ends the scan after the current step only from here on: before, the program may be waiting for a
            # camera.
            interrupts = opened.enter_context(Interrupts())
            devices = Devices(controller, camera)
            if boards:
                result = scan_boards(rig, output, resume, devices, interrupts, place_command, out)
            else:
                result = _scan_sweep(rig, output, resume, devices, interrupts, calibration, live)
        out.print(result.message)
        done = _finish_cloud(live, result, output, cloud, calibration, out)
        notes += done.get("notes", [])
    if result.status == "complete":
        out.print(f"next: {_next_command(boards, output, calibration, cloud)}")
    emit_json({**_as_json(result), "capture": str(output), **done, "notes": notes})
    if result.status != "complete":
        given = {"--port": port, "-c": calibration, "--cloud": cloud, "--place-command": place_command}
        given["--smooth"] = None if smooth == "edge" else smooth
        words = ["jaxscan", "scan", str(config), "-o", str(output), *(["--boards"] if boards else [])]
        words += [str(word) for option in given.items() if option[1] is not None for word in option]
        again = f"go on with: {shlex.join([*words, '--resume'])}"
        if result.status == "interrupted" and interrupts():
            out.print(again)
            raise KeyboardInterrupt(interrupts.received[0])
        raise ScanError(f"{output}: {result.status}; {again}")


def _check_options(*, boards: bool, calibration: Path | None, cloud: Path | None, place_command: str | None) -> None:
    if place_command is not None and not boards:
        raise OptionError("--place-command: found without --boards, expected with it.")
    if boards and calibration is not None:
        raise OptionError("--calibration: found with --boards, expected for a sweep only.")
    if cloud is not None:
        if calibration is None:
            raise OptionError("--cloud: found without --calibration, expected with it.")
        cloud_files.check_cloud_path(cloud)


def _scan_sweep(
    rig: "RigConfig",
    folder: Path,
    resume: bool,
    devices: "Devices",
    should_stop: Callable[[], bool],
    calibration: Path | None,
    live: "LiveCloud | None",
) -> "SessionResult":
    from scanrig.doctor import stripe_level
    from scanrig.session import Hooks, run_sweep
    from scanrig.session.plan import plan_sweep

    with ScanDisplay(None if live is None else live.status, total=len(plan_sweep(rig)[0])) as display:

        def on_pair(number: int, angle: float, on: np.ndarray, off: np.ndarray) -> None:
            display.pair(angle, lambda: stripe_level(on, off, rig, rig.laser_of(number))[0])
            if live is not None:
                live.add(number, angle, on, off)

        return run_sweep(
            rig,
            folder,
            devices,
            Hooks(on_pair, display.progress, display.say, should_stop),
            resume=resume,
            calibration_digest=None if calibration is None else calibration_files.calibration_digest(calibration),
        )


def _finish_cloud(
    live: "LiveCloud | None",
    result: "SessionResult",
    capture: Path,
    cloud: Path | None,
    calibration: Path | None,
    out: Terminal,
) -> dict[str, Any]:
    """Write the cloud, if one was asked for and all records are there: the same as `jaxscan reconstruct` writes."""
    if live is None or cloud is None or calibration is None or result.status not in ("complete", "suspect"):
        return {}
    with progress_bar("Finishing the cloud") as progress:
        done = live.finish(progress)
    sweep, points = api.open_capture(capture), done.cloud
    notes = list(done.notes)
    if api.has_photographs(sweep):
        scanner = api.load_scanner(calibration)
        notes += api.photograph_notes(sweep, scanner, "points")
        with progress_bar("Colouring from photographs") as progress:
            points = api.colour_cloud(points, sweep, scanner, progress=progress)
    out.notes(notes)
    if done.noise:
        out.print(f"noise: {done.noise}")
    api.save_cloud(points, cloud, calibration_digest=calibration_files.calibration_digest(calibration))
    count = int(np.count_nonzero(points.valid))
    out.print(f"{count:,} points, written: {cloud}")
    return {"cloud": str(cloud), "points": count, "live": done.live, "notes": notes, "noise": done.noise}


def _as_json(result: "SessionResult") -> dict[str, Any]:
    names = ("status", "message", "records", "planned", "taken", "retakes", "suspect", "laser_off")
    return {name: getattr(result, name) for name in names}


def _next_command(boards: bool, folder: Path, calibration: Path | None, cloud: Path | None) -> str:
    if boards:
        return f"jaxscan calibrate {folder} -o calibration.json --report calibration.html"
    if cloud is not None:
        return f"jaxscan measure room {cloud} -c {calibration}"
    return f"jaxscan reconstruct {folder} -c {calibration or 'calibration.json'} -o {folder.name}.ply"
