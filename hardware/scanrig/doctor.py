"""Examines a rig, part after part: reports faults and remedies."""

import contextlib
import dataclasses
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from jaxscan.stripes import laser_plane
from scanrig.cameras import Camera
from scanrig.checks import PairProof
from scanrig.clock import Clock
from scanrig.config import RigConfig
from scanrig.controllers import Controller, Settings, shortcomings
from scanrig.errors import CameraTimeout, Fault, FrameError, RigError, RigFault
from scanrig.recording import free_bytes, readable
from scanrig.session.plan import controller_settings, estimate, nearest, plan_sweep
from scanrig.session.steps import Pair, Station, next_frame, rest


Verdict = Literal["works", "note", "wrong", "not checked"]


@dataclass(frozen=True)
class Finding:
    """The finding about one part."""

    name: str
    verdict: Verdict
    """"note": works, with a remark; "wrong": a scan would fail or be spoilt."""
    found: str
    do: str = ""
    values: Mapping[str, Any] = field(default_factory=dict)
    """The measured values, for programs; units in the names."""


Tell = Callable[[Finding], None]


def looked_at(name: str, look: Callable[[], Finding], tell: Tell) -> Finding:
    """Examine one part. An error of the rig becomes a finding; its message contains the remedy."""
    try:
        finding = look()
    except RigError as problem:
        finding = Finding(name, "wrong", " ".join(str(problem).split()))
    tell(finding)
    return finding


PULSES = 6
_WANTED_DN = (200.0, 254.0)
_BEST_DN = 225.0
_BRIGHT_ROOM_DN = 100.0
_CLIPPED = 0.25
_LIT_DN = 12.0


def examine(
    controller: Controller | None,
    camera: Camera | None,
    config: RigConfig | None,
    *,
    folder: Path,
    tell: Tell,
    say: Callable[[str], None] = lambda sentence: None,
    clock: Clock | None = None,
) -> None:
    """Examine all parts of a rig; the table turns and the laser shines. None of them is closed.

    Args:
        controller: Open; it is left safe.
        camera: Open; it is started.
        config: Without it the controller is examined with default settings, and the camera is not examined.
        folder: Where captures would be written.
        tell: Called with each finding.
        say: Called with a sentence about the progress of long examinations.
    """
    clock = clock or Clock()
    try:
        homed = False if controller is None else examine_table(controller, config, tell, say)
        if camera is not None and config is not None:
            looked_at("camera", lambda: _camera(camera), tell)
            looked_at("trigger", lambda: _trigger(controller, camera, config, clock), tell)
            if controller is not None and homed:
                _examine_light(controller, camera, config, tell, clock)
    finally:
        if controller is not None:
            tell(_laser_off(controller))
    if config is not None:
        looked_at("storage", lambda: _storage(config, folder), tell)


def _storage(config: RigConfig, folder: Path) -> Finding:
    """Check the folder and its free space."""
    targets, _ = plan_sweep(config)
    needed, free = estimate(config, [target.position for target in targets]).bytes, free_bytes(folder)
    found = f"{readable(free)} free, a sweep needs up to {readable(needed)}"
    do = "" if free >= needed else f"make room in {folder}, or write elsewhere"
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as problem:
        do = f"{folder} cannot be written ({problem.strerror}); choose another folder"
    return Finding("storage", "wrong" if do else "works", found, do, {"free_bytes": free, "sweep_bytes": needed})


def _laser_off(controller: Controller) -> Finding:
    found = "could not be confirmed"
    try:
        if controller.make_safe():
            contactor = ", contactor open" if controller.guarantees.laser_off_without_host else ""
            return Finding("laser off", "works", f"confirmed by the controller{contactor}")
    except RigError as problem:
        found = str(problem)
    return Finding("laser off", "wrong", found, "switch the laser's supply off by hand")


def _camera(camera: Camera) -> Finding:
    camera.start()
    features = camera.features()
    names = ("width", "height", "pixel_format", "exposure_s", "gain_db", "trigger")
    says = ", ".join(f"{name} {features[name]}" for name in names if name in features)
    return Finding("camera", "works", f"{camera.identity}: {says}", values=dict(features))


def _trigger(controller: Controller | None, camera: Camera, config: RigConfig, clock: Clock) -> Finding:
    mode = camera.trigger_mode
    wire = controller if mode == "hardware" else None
    if mode == "hardware" and wire is None:
        return Finding("trigger", "not checked", "its wire comes from the controller, which was not examined")
    camera.drop()
    settings, frames = controller_settings(config), 0
    whole = 0
    before = 0 if wire is None else wire.stat().exposures
    for _ in range(PULSES):
        if wire is not None:
            wire.trigger()
            rest((settings.exposure_ms + settings.gap_ms) / 1000, wire, clock)
        elif mode == "software":
            camera.trigger()
        with contextlib.suppress(CameraTimeout):
            frame = next_frame(camera, wire, config.camera.exposure_ms / 1000 + config.checks.late_s, clock)
            frames, whole = frames + 1, whole + frame.complete
    frames += 0 if mode == "free" else camera.drop()
    values = {"pulses": PULSES, "frames": frames, "complete": whole}
    name = {"hardware": "pulses of the controller", "software": "commands", "free": "waits"}[mode]
    found = f"{PULSES} {name} gave {frames} frames, {whole} of them complete"
    if wire is not None:
        counted = (wire.stat().exposures - before) % 65536
        if counted != PULSES:
            return Finding("trigger", "wrong", f"the controller counted {counted} of {PULSES} pulses", "", values)
    do = ""
    if frames == 0 and wire is not None:
        do = f"check the wire from TRIG to the camera, and its input: trigger_source is {config.camera.trigger_source}"
    elif frames < PULSES:
        do = "the camera misses triggers: expose shorter, or make trigger.gap_ms and laser.off_ms longer"
    elif frames > PULSES:
        do = "the camera exposes by itself, or the wire picks up noise: check camera.trigger and the wire's shield"
    elif whole < frames:
        do = "frames arrive incomplete: check network card and cable; try camera.packet_size = 1400 or 8192"
    return Finding("trigger", "wrong" if do else "works", found, do, values)


def _examine_light(controller: Controller, camera: Camera, config: RigConfig, tell: Tell, clock: Clock) -> None:
    """Examine each laser and the brightness of its line.

    The controller is homed, and its contactor is closed for each pair and opened again; the camera is started.
    """
    pairs: list[tuple[Pair, PairProof]] = []
    checks = config.checks.model_copy(update={"retakes": 1})
    station = Station(config.model_copy(update={"checks": checks}), controller, camera, clock)
    for number in range(len(config.laser)):
        if looked_at(_named("laser", config, number), partial(_laser, station, number, pairs), tell).verdict != "wrong":
            looked_at(_named("exposure", config, number), partial(judge_exposure, *pairs[-1], config), tell)


def _named(part: str, config: RigConfig, number: int) -> str:
    """The name of a finding; with several lasers it includes the laser's name."""
    return part if len(config.laser) == 1 else f"{part} {config.laser[number].name}"


def _laser(station: Station, number: int, pairs: list[tuple[Pair, PairProof]]) -> Finding:
    name = _named("laser", station.config, number)
    station.controller.arm(True)
    try:
        pair, proof = station.take(0, number)
    except FrameError as problem:
        # The message names the problem: dark, swapped, always on, covered, flooded.
        return Finding(name, "wrong", " ".join(str(problem).split()))
    finally:
        station.controller.arm(False)
    pairs.append((pair, proof))
    values = {"lit_lines": proof.lit_lines, "peak_dn": proof.peak_dn, "leak": proof.leak, "unrest": proof.unrest}
    lit = f"{100 * proof.lit_lines:.0f} % of the lines, {proof.peak_dn:.0f} DN high"
    found = f"in the lit frame on {lit}; not in the dark one"
    if pair.rejections.reasons:
        return Finding(name, "note", f"{found}; the first take was dropped: {pair.rejections.reasons[0]}", "", values)
    return Finding(name, "works", found, values=values)


def judge_exposure(pair: Pair, proof: PairProof, config: RigConfig) -> Finding:
    """Whether the peak of the line of a pair, proven or not, is bright and not clipped, and what to change."""
    peak, clipped = stripe_level(pair.on.shown, pair.off.shown, config, pair.laser)
    ambient = proof.ambient_dn
    factor = 0.5 if clipped > _CLIPPED else _BEST_DN / max(peak, 1.0)
    values = {"peak_dn": peak, "clipped": clipped, "ambient_dn": ambient, "factor": factor}
    found = (
        f"line {peak:.0f} DN, wanted {_WANTED_DN[0]:.0f} to 255; {100 * clipped:.0f} % clipped; room {ambient:.0f} DN"
    )
    now, filtered = config.camera.exposure_ms, "or put a filter of the laser's colour on the lens"
    change = f"camera.exposure_ms = {now * factor:.3g} instead of {now:g}"
    do = ""
    if clipped > _CLIPPED:
        do = f"expose shorter, about {factor:g} times: {change}"
    elif peak < _WANTED_DN[0]:
        do = f"expose longer, {factor:.1f} times: {change}"
        if ambient * factor > _BRIGHT_ROOM_DN:
            do += f"; the room becomes bright then: darken it, {filtered}"
    elif ambient > _BRIGHT_ROOM_DN:
        do = f"darken the room, {filtered}"
    return Finding(_named("exposure", config, pair.laser), "note" if do else "works", found, do, values)


def stripe_level(on: np.ndarray, off: np.ndarray, config: RigConfig, laser: int = 0) -> tuple[float, float]:
    """90 % quantile of the peak levels of the lit lines [DN], and the part of lit lines that is clipped."""
    line = config.laser[laser].line
    planes = (laser_plane(frame[None], pixel_format=config.camera.layout, line=line) for frame in (on, off))
    lit, dark = (np.asarray(plane)[0].astype(np.int16) for plane in planes)
    rows = np.arange(len(lit))
    at = (lit - dark).argmax(1)
    seen = (lit - dark)[rows, at] > _LIT_DN
    if not seen.any():
        return 0.0, 0.0
    level = lit[rows, at][seen]
    return float(np.percentile(level, 90)), float(np.mean(level > _WANTED_DN[1] - 1))


TOLERANCE = 8
"""Microsteps by which the place of the switch may vary from turn to turn."""
_PART = 36
"""Motions begin at 1/36 of a turn above the switch, since the switch is wide."""
_DOUBLINGS = 6
_LARGEST_DENOMINATOR = 200
_MOST_EDGES = 64
_LEAST_S = 60.0
_REPEATS = 2
_REPEATABLE = 2
_UNKNOWN_TURN = 3200
"""First guess for a turn without a configuration [microsteps]: 200 full steps of 16."""


def examine_table(controller: Controller, config: RigConfig | None, tell: Tell, say: Callable[[str], None]) -> bool:
    """Examine the controller and turn its table; returns whether it is homed and can be used.

    Without a configuration, a turn is measured without comparison.
    """
    settings = Settings() if config is None else controller_settings(config)

    def configured() -> Finding:
        controller.configure(settings)
        return Finding("settings", "works", "the controller is set as the configuration says")

    if looked_at("firmware", lambda: _firmware(controller), tell).verdict == "wrong":
        return False
    if lacking := shortcomings(controller.guarantees):
        tell(Finding("safety", "note", lacking[0], " ".join(lacking[1:])))
    found = [looked_at("inputs", lambda: _inputs(controller), tell), looked_at("settings", configured, tell)]
    if "wrong" in {one.verdict for one in found}:
        return False
    if looked_at("home", lambda: _home(controller, config, settings), tell).verdict == "wrong":
        return False
    looked_at("steps per turn", lambda: _turn(controller, config, settings, say), tell)
    # The examination may have left a fault; after clearing it a pair can still be taken.
    return looked_at("at rest", lambda: _rest(controller, config), lambda finding: None).verdict == "works"


def _firmware(controller: Controller) -> Finding:
    firmware = controller.hello()
    counters = controller.counters()
    if counters is None:
        return Finding("firmware", "works", f"{firmware.proto}, version {firmware.version}; it counts no errors")
    values = {
        "version": firmware.version,
        "protocol": firmware.proto,
        "boot": firmware.boot,
        "watchdog_resets": counters.watchdog_resets,
        "damaged_lines": counters.damaged,
        "lost_bytes": counters.overruns,
        "laser_cycles": counters.laser_cycles,
    }
    found = (
        f"version {firmware.version}, protocol {firmware.proto}, boot {firmware.boot}, {counters.damaged} damaged "
        f"lines, {counters.overruns} lost bytes, {counters.watchdog_resets} resets by its watchdog ever"
    )
    if counters.overruns or counters.damaged > 10:
        return Finding("firmware", "note", found, "keep the serial cable short and away from the motor's", values)
    return Finding("firmware", "works", found, values=values)


def _inputs(controller: Controller) -> Finding:
    controller.stop()
    status = controller.stat()
    if status.estop:
        do = "release it; if it is not pressed, its wire is broken, since it opens a closed contact"
        return Finding("inputs", "wrong", "the emergency stop is pressed", do)
    if status.state == "fault":
        controller.clear()
    switch = "active" if status.home_switch else "not active"
    left = f"; a fault of earlier was cleared: {status.fault}" if status.fault else ""
    return Finding("inputs", "works", f"emergency stop released, home switch {switch}{left}")


def _within(config: RigConfig | None) -> int:
    """How far to search for the home switch [microsteps]."""
    if config is None:
        return 64 * _UNKNOWN_TURN
    return nearest(config.turntable.home_within_deg, config.microsteps_per_turn)


def _home(controller: Controller, config: RigConfig | None, settings: Settings) -> Finding:
    controller.enable(True)
    within = _within(config)
    try:
        controller.home(within)
    except RigFault as problem:
        if problem.fault is not Fault.HOME_NOT_FOUND:
            raise
        controller.clear()
        found = f"the switch was not found within {within} microsteps, or does not open"
        do = (
            "check that the table turns, in the right direction (turntable.reverse), and the switch closes by hand: "
            "the inputs above then say active"
        )
        return Finding("home", "wrong", found, do)
    if not controller.guarantees.knows_missed_steps:
        return Finding("home", "works", "found; the controller does not report whether at the same place again")
    turn = _UNKNOWN_TURN if config is None else config.microsteps_per_turn
    # Away from the switch, within the limits.
    way = max(turn // 12, 8) if settings.limits is None else min(max(turn // 12, 8), settings.limits[1])
    missed: list[int] = []
    for _ in range(_REPEATS):
        controller.move(way)
        missed.append(controller.home(within) or 0)
    values = {"missed_microsteps": max(missed, key=abs)}
    found = f"found, and found again {' and '.join(f'{was:+d}' for was in missed)} microsteps beside it"
    if max(map(abs, missed)) > _REPEATABLE:
        do = "check belt, motor current, speed and the switch: steps are lost, or it does not close at the same place"
        return Finding("home", "wrong", found, do, values)
    return Finding("home", "works", found, values=values)


def _turn(controller: Controller, config: RigConfig | None, settings: Settings, say: Callable[[str], None]) -> Finding:
    name, by_hand = "steps per turn", "measure an angle by hand: 90 degrees configured must be 90 degrees of the table"
    if not controller.guarantees.knows_missed_steps:
        return Finding(name, "not checked", "the controller does not report where it found the home switch", by_hand)
    expected = None if config is None else config.microsteps_per_turn
    guess = expected or _UNKNOWN_TURN
    highest = None if settings.limits is None else settings.limits[1]
    if highest is not None and highest < guess + _above(guess):
        found = f"turntable.limits_deg forbids a turn and {360 * _above(guess) / guess:.0f} degrees"
        return Finding(name, "not checked", found, by_hand)
    try:
        # The way back begins at the home of the next turn, where the limits would be wrong.
        controller.configure(dataclasses.replace(settings, limits=None))
        measured = measure_turn(controller, guess, speed=settings.speed, highest=highest, say=say)
    finally:
        controller.configure(settings)
    values = {"measured_microsteps": measured}
    if config is None or expected is None:
        return Finding(name, "works", f"{measured} microsteps from home to home", values=values)
    values["expected_microsteps"] = expected
    if abs(measured - expected) <= TOLERANCE:
        found = f"{measured} from home to home, {expected} by the configuration"
        return Finding(name, "works", found, values=values)
    found = f"{measured} microsteps from home to home, expected {expected}"
    return Finding(name, "wrong", found, _fitting(measured, config), values)


def measure_turn(
    controller: Controller,
    guess: int,
    *,
    speed: float,
    highest: int | None = None,
    say: Callable[[str], None] = lambda sentence: None,
) -> int:
    """Turn until the home switch comes again, and turn back the same way, so that no cable winds up.

    Homing searches downwards. A motion that ends a little above one turn therefore finds the edge of that turn, and the
    counter there is the length of one turn or of several; on the way back the edges in between are searched for.

    Args:
        controller: Enabled and homed.
        guess: Expected length of a turn [microsteps].
        speed: Speed of motions, for timeouts [microsteps/s].
        highest: Highest allowed position, above `guess` by a 36th of it; None: no limit.
        say: Called with a sentence about each motion.

    Returns:
        Microsteps of a turn.

    Raises:
        RigError: If the switch does not come again within `2**_DOUBLINGS` times the expected turn.
        RigFault, LinkLost: From the controller.
    """

    def to_switch_from(position: int, reach: int) -> int:
        controller.move(position, _LEAST_S + 2.0 * (abs(position) + reach) / speed)
        was = controller.home(reach, _LEAST_S + 4.0 * reach / speed)
        if was is None:
            raise RigError("the controller does not report where it found the home switch: a turn cannot be measured")
        return was

    top, reached = guess + _above(guess), 0
    for _ in range(_DOUBLINGS):
        if highest is not None and top > highest:
            raise RigError(
                f"the home switch did not come again within {reached} microsteps, and the limits forbid more: a turn "
                f"has more than {guess} microsteps, or the table does not turn"
            )
        say(f"turning up to microstep {top}, then home")
        turns = to_switch_from(top, top + guess)
        if abs(turns) > TOLERANCE:
            break
        reached, top = top, 2 * top
    else:
        raise RigError(
            f"the home switch did not come again within {reached} microsteps, {2 ** (_DOUBLINGS - 1)} times a turn; "
            "check whether the table turns at all"
        )
    left = turns
    for _ in range(_MOST_EDGES):
        say(f"back by {left} microsteps, home on the way")
        edge = -to_switch_from(-(left // 2) + _above(guess), 2 * left + guess)
        if abs(edge - left) <= TOLERANCE:
            return left
        if not TOLERANCE < edge < left:
            break
        left -= edge
    raise RigError(
        f"the home switch was found at {edge} microsteps on the way back, expected at {left} or before: steps are "
        "lost, or the switch has moved; check belt, motor current and speed"
    )


def _above(guess: int) -> int:
    """How far above the switch motions begin [microsteps]."""
    return max(guess // _PART, 8)


def _fitting(measured: int, config: RigConfig) -> str:
    """The change of the configuration that gives the measured turn."""
    table = config.turntable
    cures = []
    if gear := fitting_gear(measured, table.full_steps * table.microsteps):
        cures.append(f"gear = [{gear[0]}, {gear[1]}]")
    # Drivers divide a step by powers of two.
    for microsteps in (2**k for k in range(11)):
        turn = Fraction(config.microsteps_per_turn * microsteps, table.microsteps)
        if abs(turn - measured) < TOLERANCE:
            cures.append(f"microsteps = {microsteps}, if the driver is set so")
    if not cures:
        return "no gear of two whole numbers fits: check whether steps are lost, or the belt slips"
    return f"under [turntable] set {', or '.join(cures)}"


def fitting_gear(turn: int, motor_turn: int) -> tuple[int, int] | None:
    """The simplest ratio of two integers that gives the turn of the table, by that of the motor, within `TOLERANCE`."""
    for denominator in range(1, _LARGEST_DENOMINATOR + 1):
        numerator = round(turn * denominator / motor_turn)
        whole = (motor_turn * numerator) % denominator == 0
        if numerator and whole and abs(Fraction(motor_turn * numerator, denominator) - turn) <= TOLERANCE:
            return numerator, denominator
    return None


def _rest(controller: Controller, config: RigConfig | None) -> Finding:
    status = controller.stat()
    if status.state == "fault":
        controller.clear()
    if not status.homed:
        controller.enable(True)
        controller.home(_within(config))
    return Finding("at rest", "works", "")
