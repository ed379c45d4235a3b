"""Examines camera, trigger and lasers: one frame per pulse, a proven pair, suitable levels."""

from functools import partial

import numpy as np

from jaxscan.stripes import laser_plane
from scanrig.cameras import Camera, Frame
from scanrig.clock import Clock
from scanrig.config import RigConfig
from scanrig.controllers import Controller
from scanrig.doctor.findings import Finding, Tell, looked_at
from scanrig.errors import CameraTimeout, FrameError
from scanrig.session.plan import controller_settings
from scanrig.session.steps import ProvenPair, Station, Step, next_frame, rest, take_pair


PULSES = 6
_WANTED_DN = (200.0, 254.0)
_BEST_DN = 225.0
_BRIGHT_ROOM_DN = 100.0
_CLIPPED = 0.25
_LIT_DN = 12.0


def examine_camera(controller: Controller | None, camera: Camera, config: RigConfig, tell: Tell, clock: Clock) -> None:
    """Examine the camera and its trigger."""
    looked_at("camera", lambda: _camera(camera), tell)
    looked_at("trigger", lambda: _trigger(controller, camera, config, clock), tell)


def examine_light(
    controller: Controller, camera: Camera, config: RigConfig, tell: Tell, clock: Clock
) -> ProvenPair | None:
    """Examine each laser and the brightness of its line.

    Args:
        controller: Homed; its contactor is closed for each pair and opened again.
        camera: Started.
        config: The rig.
        tell: Called with each finding.
        clock: For waiting.

    Returns:
        The first proven pair, or None.
    """
    pairs: list[ProvenPair] = []
    station = Station(_with_one_retake(config), controller, camera, clock)
    for number in range(len(config.laser)):
        known = len(pairs)
        looked_at(_named("laser", config, number), partial(_laser, station, number, pairs), tell)
        for pair in pairs[known:]:
            looked_at(_named("exposure", config, number), partial(judge_exposure, pair, config), tell)
    return pairs[0] if pairs else None


def _named(part: str, config: RigConfig, number: int) -> str:
    """The name of a finding; with several lasers it includes the laser's name."""
    return part if len(config.laser) == 1 else f"{part} {config.laser[number].name}"


def _camera(camera: Camera) -> Finding:
    camera.start()
    features = camera.features()
    names = ("width", "height", "pixel_format", "exposure_s", "gain_db", "trigger")
    says = ", ".join(f"{name} {features[name]}" for name in names if name in features)
    return Finding("camera", "works", f"{camera.identity}: {says}", values=dict(features))


def _trigger(controller: Controller | None, camera: Camera, config: RigConfig, clock: Clock) -> Finding:
    """Check that each pulse gives one frame."""
    mode = camera.trigger_mode
    if mode == "hardware" and controller is None:
        return Finding("trigger", "not checked", "its wire comes from the controller, which was not examined")
    camera.drop()
    frames: list[Frame] = []
    pulse_s = controller_settings(config).exposure_ms / 1000
    wait_s = config.camera.exposure_ms / 1000 + config.checks.late_s
    exposing = controller if mode == "hardware" else None
    before = 0 if controller is None else controller.stat().exposures
    for _ in range(PULSES):
        if mode == "hardware" and controller is not None:
            controller.trigger()
            rest(pulse_s + controller_settings(config).gap_ms / 1000, controller, clock)
        elif mode == "software":
            camera.trigger()
        try:
            frames.append(next_frame(camera, exposing, wait_s, clock))
        except CameraTimeout:
            continue
    more = 0 if mode == "free" else camera.drop()
    count, whole = len(frames) + more, sum(frame.complete for frame in frames)
    values = {"pulses": PULSES, "frames": count, "complete": whole}
    name = {"hardware": "pulses of the controller", "software": "commands", "free": "waits"}[mode]
    found = f"{PULSES} {name} gave {count} frames, {whole} of them complete"
    if mode == "hardware" and controller is not None:
        counted = (controller.stat().exposures - before) % 65536
        if counted != PULSES:
            return Finding("trigger", "wrong", f"the controller counted {counted} of {PULSES} pulses", "", values)
    if count == 0 and mode == "hardware":
        do = f"check the wire from TRIG to the camera, and its input: trigger_source is {config.camera.trigger_source}"
        return Finding("trigger", "wrong", found, do, values)
    if count < PULSES:
        do = "the camera misses triggers: expose shorter, or make trigger.gap_ms and laser.off_ms longer"
        return Finding("trigger", "wrong", found, do, values)
    if count > PULSES:
        do = "the camera exposes by itself, or the wire picks up noise: check camera.trigger and the wire's shield"
        return Finding("trigger", "wrong", found, do, values)
    if whole < len(frames):
        do = "frames arrive incomplete: check network card and cable; try camera.packet_size = 1400 or 8192"
        return Finding("trigger", "wrong", found, do, values)
    return Finding("trigger", "works", found, values=values)


def _laser(station: Station, number: int, pairs: list[ProvenPair]) -> Finding:
    name = _named("laser", station.config, number)
    station.controller.arm(True)
    try:
        pair = take_pair(station, Step(0, number, number))
    except FrameError as problem:
        # The message names the problem: dark, swapped, always on, covered, flooded.
        return Finding(name, "wrong", " ".join(str(problem).split()))
    finally:
        station.controller.arm(False)
    pairs.append(pair)
    proof = pair.proof
    values = {"lit_lines": proof.lit_lines, "peak_dn": proof.peak_dn, "leak": proof.leak, "unrest": proof.unrest}
    lit = f"{100 * proof.lit_lines:.0f} % of the lines, {proof.peak_dn:.0f} DN high"
    found = f"in the lit frame on {lit}; not in the dark one"
    if pair.rejected:
        return Finding(name, "note", f"{found}; the first take was dropped: {pair.rejected[0]}", "", values)
    return Finding(name, "works", found, values=values)


def _with_one_retake(config: RigConfig) -> RigConfig:
    checks = config.checks.model_copy(update={"retakes": 1})
    return config.model_copy(update={"checks": checks})


def judge_exposure(pair: ProvenPair, config: RigConfig) -> Finding:
    """Whether the peak of the line is bright and not clipped, and what to change.

    Args:
        pair: A pair of the rig, proven or not.
        config: The rig.
    """
    name = _named("exposure", config, pair.laser)
    peak, clipped = stripe_level(pair.on.image, pair.off.image, config, pair.laser)
    ambient = pair.proof.ambient_dn
    factor = 0.5 if clipped > _CLIPPED else _BEST_DN / max(peak, 1.0)
    values = {"peak_dn": peak, "clipped": clipped, "ambient_dn": ambient, "factor": factor}
    found = (
        f"line {peak:.0f} DN, wanted {_WANTED_DN[0]:.0f} to 255; {100 * clipped:.0f} % clipped; room {ambient:.0f} DN"
    )
    now = config.camera.exposure_ms
    if clipped > _CLIPPED:
        do = f"expose shorter, about {factor:g} times: camera.exposure_ms = {now * factor:.3g} instead of {now:g}"
        return Finding(name, "note", found, do, values)
    if peak < _WANTED_DN[0]:
        do = f"expose longer, {factor:.1f} times: camera.exposure_ms = {now * factor:.3g} instead of {now:g}"
        if ambient * factor > _BRIGHT_ROOM_DN:
            do += "; the room becomes bright then: darken it, or put a filter of the laser's colour on the lens"
        return Finding(name, "note", found, do, values)
    if ambient > _BRIGHT_ROOM_DN:
        do = "darken the room, or put a filter of the laser's colour on the lens"
        return Finding(name, "note", found, do, values)
    return Finding(name, "works", found, values=values)


def stripe_level(on: np.ndarray, off: np.ndarray, config: RigConfig, laser: int = 0) -> tuple[float, float]:
    """90 % quantile of the peak levels of the lit lines [DN], and the part of lit lines that is clipped.

    Args:
        on: Laser-on frame.
        off: Laser-off frame.
        config: The rig.
        laser: The laser of the pair, counted from 0.
    """
    line = config.laser[laser].line
    planes = (laser_plane(frame[None], pixel_format=config.camera.pixel_format, line=line) for frame in (on, off))
    lit, dark = (np.asarray(plane)[0].astype(np.int16) for plane in planes)
    rows = np.arange(len(lit))
    at = (lit - dark).argmax(1)
    seen = (lit - dark)[rows, at] > _LIT_DN
    if not seen.any():
        return 0.0, 0.0
    level = lit[rows, at][seen]
    return float(np.percentile(level, 90)), float(np.mean(level > _WANTED_DN[1] - 1))
