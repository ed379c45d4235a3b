"""Examines a rig, part after part. The laser is off at the end in every case."""

import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from jaxscan.errors import CaptureError
from jaxscan.files.capture import CameraTable, CaptureHeader, frame_shape
from jaxscan.files.recording import create_capture
from scanrig.cameras import Camera
from scanrig.clock import Clock, SystemClock
from scanrig.config import RigConfig
from scanrig.controllers import Controller
from scanrig.doctor.findings import Finding as Finding
from scanrig.doctor.findings import Tell, looked_at
from scanrig.doctor.light import examine_camera, examine_light
from scanrig.doctor.table import examine_table
from scanrig.errors import RigError
from scanrig.recording import free_bytes, readable
from scanrig.session.plan import estimate, plan_sweep
from scanrig.session.steps import ProvenPair


_STORED_PAIRS = 6


@dataclass(frozen=True)
class Patient:
    """The parts of a rig that can be examined. The examination closes none of them."""

    controller: Controller | None
    """Open; left safe."""
    camera: Camera | None
    """Open; the examination starts it."""
    config: RigConfig | None
    """Without it the controller is examined with default settings, and the camera is not examined."""
    clock: Clock = field(default_factory=SystemClock)


def examine(patient: Patient, *, folder: Path, tell: Tell, say: Callable[[str], None] = lambda sentence: None) -> None:
    """Examine all parts of a rig; the table turns and the laser shines.

    Args:
        patient: The parts.
        folder: Folder for captures.
        tell: Called with each finding.
        say: Called with a sentence about the progress of long examinations.
    """
    controller, camera, config = patient.controller, patient.camera, patient.config
    pair: ProvenPair | None = None
    try:
        homed = False if controller is None else examine_table(controller, config, tell, say)
        if camera is not None and config is not None:
            examine_camera(controller, camera, config, tell, patient.clock)
            if controller is not None and homed:
                pair = examine_light(controller, camera, config, tell, patient.clock)
    finally:
        if controller is not None:
            tell(_laser_off(controller))
    if config is not None:
        looked_at("storage", lambda: _storage(config, folder, pair), tell)


def _storage(config: RigConfig, folder: Path, pair: ProvenPair | None) -> Finding:
    """Check free space, and the time to write a pair to the disk."""
    targets, _ = plan_sweep(config)
    needed = estimate(config, [target.position for target in targets])
    free = free_bytes(folder)
    seconds = _seconds_a_pair(config, folder, pair)
    per_step = needed.seconds / len(targets)
    values = {"free_bytes": free, "sweep_bytes": needed.bytes, "pair_s": seconds, "step_s": per_step}
    found = (
        f"{readable(free)} free, a sweep needs up to {readable(needed.bytes)}; a pair is written in "
        f"{1e3 * seconds:.0f} ms, a step takes {1e3 * per_step:.0f} ms"
    )
    if free < needed.bytes:
        return Finding("storage", "wrong", found, f"make room in {folder}, or write elsewhere", values)
    if seconds > per_step:
        return Finding(
            "storage", "note", found, "the disk is the slowest part of the rig: write to another one", values
        )
    return Finding("storage", "works", found, values=values)


def _seconds_a_pair(config: RigConfig, folder: Path, pair: ProvenPair | None) -> float:
    camera = config.camera
    table = CameraTable(width=camera.width, height=camera.height, pixel_format=camera.pixel_format)
    header = CaptureHeader(kind="sweep", camera=table, laser=tuple(laser.table for laser in config.laser))
    noise = np.random.default_rng(0).integers(20, 30, frame_shape(header), np.uint8)
    on, off = (noise, noise) if pair is None else (pair.on.image, pair.off.image)
    try:
        with tempfile.TemporaryDirectory(prefix=".jaxscan-doctor-", dir=folder) as scratch:
            start = time.perf_counter()
            with create_capture(Path(scratch) / "pairs", header) as writer:
                for number in range(_STORED_PAIRS):
                    writer.append(angle_deg=float(number), on=on, off=off)
            return (time.perf_counter() - start) / _STORED_PAIRS
    except (OSError, CaptureError) as problem:
        reason = getattr(problem, "strerror", None) or problem
        raise RigError(f"{folder}: cannot be written ({reason}); choose another folder") from problem


def _laser_off(controller: Controller) -> Finding:
    try:
        safe = controller.make_safe()
    except RigError as problem:
        return Finding("laser off", "wrong", str(problem), "switch the laser's supply off by hand")
    if safe:
        return Finding(
            "laser off",
            "works",
            "confirmed by the controller"
            + (", contactor open" if controller.guarantees.laser_off_without_host else ""),
        )
    return Finding("laser off", "wrong", "could not be confirmed", "switch the laser's supply off by hand")
