"""Examines controller and turntable: firmware, inputs, settings, home, a whole turn."""

import dataclasses
from collections.abc import Callable

from scanrig.config import RigConfig
from scanrig.controllers import Controller, Settings, shortcomings
from scanrig.doctor.findings import Finding, Tell, looked_at
from scanrig.doctor.gearing import TOLERANCE, fitting_gear, measure_turn, needed
from scanrig.errors import Fault, RigFault
from scanrig.session.plan import controller_settings, nearest


_REPEATS = 2
_REPEATABLE = 2
"""Microsteps by which the place of the home switch may vary."""
_UNKNOWN_TURN = 3200
"""First guess for a turn without a configuration [microsteps]: 200 full steps of 16."""


def examine_table(controller: Controller, config: RigConfig | None, tell: Tell, say: Callable[[str], None]) -> bool:
    """Examine the controller and turn its table.

    Args:
        controller: Open.
        config: The rig; without it default settings are used, and a turn is measured without comparison.
        tell: Called with each finding.
        say: Called with a sentence about the progress of long examinations.

    Returns:
        Whether the table is homed and can be used.
    """
    if looked_at("firmware", lambda: _firmware(controller), tell).verdict == "wrong":
        return False
    if lacking := shortcomings(controller.guarantees):
        tell(Finding("safety", "note", lacking[0], " ".join(lacking[1:])))
    inputs = looked_at("inputs", lambda: _inputs(controller), tell)
    settings = Settings() if config is None else controller_settings(config)
    taken = looked_at("settings", lambda: _settings(controller, settings), tell)
    if "wrong" in (inputs.verdict, taken.verdict):
        return False
    if looked_at("home", lambda: _home(controller, config), tell).verdict == "wrong":
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


def _settings(controller: Controller, settings: Settings) -> Finding:
    controller.configure(settings)
    return Finding("settings", "works", "the controller is set as the configuration says")


def _within(config: RigConfig | None) -> int:
    """How far to search for the home switch [microsteps]."""
    if config is None:
        return 64 * _UNKNOWN_TURN
    return nearest(config.turntable.home_within_deg, config.microsteps_per_turn)


def _home(controller: Controller, config: RigConfig | None) -> Finding:
    controller.enable(True)
    within = _within(config)
    try:
        controller.home(within)
    except RigFault as problem:
        if problem.fault is not Fault.HOME_NOT_FOUND:
            raise
        controller.clear()
        return Finding(
            "home",
            "wrong",
            f"the switch was not found within {within} microsteps, or does not open",
            "check that the table turns, in the right direction (turntable.reverse), and the switch closes by hand: "
            "the inputs above then say active",
        )
    if not controller.guarantees.knows_missed_steps:
        return Finding("home", "works", "found; the controller does not report whether at the same place again")
    turn = _UNKNOWN_TURN if config is None else config.microsteps_per_turn
    missed: list[int] = []
    for _ in range(_REPEATS):
        # Away from the switch, within the limits.
        controller.move(_some_way(turn, config))
        missed.append(controller.home(within) or 0)
    values = {"missed_microsteps": max(missed, key=abs)}
    found = f"found, and found again {' and '.join(f'{was:+d}' for was in missed)} microsteps beside it"
    if max(map(abs, missed)) > _REPEATABLE:
        do = "check belt, motor current, speed and the switch: steps are lost, or it does not close at the same place"
        return Finding("home", "wrong", found, do, values)
    return Finding("home", "works", found, values=values)


def _some_way(turn: int, config: RigConfig | None) -> int:
    limits = None if config is None else controller_settings(config).limits
    way = max(turn // 12, 8)
    return way if limits is None or limits[1] >= way else limits[1]


def _turn(controller: Controller, config: RigConfig | None, settings: Settings, say: Callable[[str], None]) -> Finding:
    if not controller.guarantees.knows_missed_steps:
        return Finding(
            "steps per turn",
            "not checked",
            "the controller does not report where it found the home switch",
            "measure an angle by hand: 90 degrees by the configuration must be 90 degrees of the table",
        )
    expected = None if config is None else config.microsteps_per_turn
    guess = expected or _UNKNOWN_TURN
    highest = None if settings.limits is None else settings.limits[1]
    if highest is not None and highest < needed(guess):
        return Finding(
            "steps per turn",
            "not checked",
            f"turntable.limits_deg forbids a turn and {360 * (needed(guess) - guess) / guess:.0f} degrees",
            "measure an angle by hand: 90 degrees by the configuration must be 90 degrees of the table",
        )
    # The way back begins at the home of the next turn, where the limits would be wrong.
    free = dataclasses.replace(settings, limits=None)
    try:
        controller.configure(free)
        measured = measure_turn(controller, guess, speed=settings.speed, highest=highest, tell=say)
    finally:
        controller.configure(settings)
    values = {"measured_microsteps": measured}
    if config is None or expected is None:
        return Finding("steps per turn", "works", f"{measured} microsteps from home to home", values=values)
    values["expected_microsteps"] = expected
    if abs(measured - expected) <= TOLERANCE:
        return Finding(
            "steps per turn", "works", f"{measured} from home to home, {expected} by the configuration", values=values
        )
    found = f"{measured} microsteps from home to home, expected {expected}"
    return Finding("steps per turn", "wrong", found, _fitting(measured, config), values)


def _fitting(measured: int, config: RigConfig) -> str:
    """The change of the configuration that gives the measured turn."""
    table = config.turntable
    cures = []
    gear = fitting_gear(measured, table.full_steps * table.microsteps)
    if gear is not None:
        cures.append(f"gear = [{gear[0]}, {gear[1]}]")
    ratio = measured / config.microsteps_per_turn
    microsteps = round(table.microsteps * ratio)
    power_of_two = microsteps > 0 and microsteps & (microsteps - 1) == 0
    if (
        power_of_two
        and abs(ratio * table.microsteps - microsteps) * config.microsteps_per_turn < TOLERANCE * microsteps
    ):
        cures.append(f"microsteps = {microsteps}, if the driver is set so")
    if not cures:
        return "no gear of two whole numbers fits: check whether steps are lost, or the belt slips"
    return f"under [turntable] set {', or '.join(cures)}"


def _rest(controller: Controller, config: RigConfig | None) -> Finding:
    status = controller.stat()
    if status.state == "fault":
        controller.clear()
    if not status.homed:
        controller.enable(True)
        controller.home(_within(config))
    return Finding("at rest", "works", "")
