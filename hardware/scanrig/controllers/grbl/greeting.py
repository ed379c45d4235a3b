"""Checks which device is on the port, and whether the board's settings fit the configuration."""

import re

from scanrig.controllers.grbl.dialects import is_old, other_device
from scanrig.controllers.grbl.lines import BOOT_S, QUERY, GrblLines
from scanrig.controllers.grbl.report import read_report, read_settings
from scanrig.controllers.grbl.units import TableUnits
from scanrig.controllers.settings import Settings
from scanrig.controllers.table import GrblTable
from scanrig.errors import FirmwareError, LinkLost


AWAKE_S = 0.5
_TOLERANCE = 1e-4
"""Part by which a setting may differ: the board prints three decimals."""


def wake(lines: GrblLines) -> None:
    """Wait until the board answers: at once, or after its boot loader if opening the port has reset it.

    Raises:
        LinkLost: no answer.
    """
    lines.write(b"\n" + QUERY)
    give_up = lines.clock.now() + AWAKE_S
    while (left := give_up - lines.clock.now()) > 0:
        texts = lines.read(left, tell_reset=False)
        if any(read_report(text) for text in texts):
            return
        if lines.greeting and any(text == lines.greeting for text in texts):
            return
    if not lines.await_greeting(BOOT_S):
        lines.reset()


def greet(lines: GrblLines) -> str:
    """Wait until the board answers, and check its greeting.

    Returns:
        Its version.

    Raises:
        FirmwareError: no answer, or another device; the message names it.
        LinkLost: the port went away.
    """
    try:
        wake(lines)
        lines.reset()
    except LinkLost as problem:
        if lines.broken:
            raise
        last = _last_words(lines)
        if read_report(last):
            raise FirmwareError(
                f"{lines.link.name}: found {last[:60]!r} in answer to '?', but no greeting after a reset; expected one "
                f"that begins with '{lines.expected_greeting}': unlock the board ($X, or home it by $H), or write its "
                "greeting into controller.grbl.greeting"
            ) from problem
        found = f"a device that sends {last[:60]!r}{other_device(last)}" if last else "silence"
        raise FirmwareError(
            f"{lines.link.name}: found {found}, needed a board that begins with '{lines.expected_greeting}'; "
            "check port, power, controller.baud and controller.grbl.greeting"
        ) from problem
    if is_old(lines.greeting):
        last = next((line for line in reversed(lines.odd) if line.startswith("<")), lines.greeting)
        raise FirmwareError(lines.not_understood(last))
    # FluidNC writes GRBL's version first, and its own in brackets.
    own = re.search(r"FluidNC (v\S+)", lines.greeting)
    words = lines.greeting.split()
    return own[1] if own else words[1] if len(words) > 1 else "unknown"


def _last_words(lines: GrblLines) -> str:
    """The last line of a device that does not greet; one that takes whole lines alone answers to their end."""
    if not lines.heard:
        lines.write(b"\n$I\n")
        lines.drain()
    return lines.heard


def require_fit(lines: GrblLines, table: GrblTable, units: TableUnits, settings: Settings) -> None:
    """Check that the board's own settings fit the configuration. They belong to its owner and are never changed here.

    Raises:
        FirmwareError: with the settings to type on the board.
    """
    answer = lines.ask("$$")
    says = read_settings(answer)
    axis = "XYZABC".index(table.axis)
    feed = 60 * settings.speed / units.steps_per_unit
    if 100 + axis not in says:
        name, found = lines.dialect.name, ", ".join(answer)[:60] or "nothing"
        where = "its configuration file (config.yaml)" if not lines.dialect.listed else "its own settings"
        raise FirmwareError(
            f"{lines.link.name}: found {found} in answer to $$; {name} does not list its axes there. Look in {where} "
            f"for steps_per_mm = {units.steps_per_unit:.10g} and max_rate = {feed:.10g} or more on axis {table.axis}, "
            "then set check_settings = false under [controller.grbl]"
        )
    wanted = {1: 255.0, 13: 0.0, 32: 0.0, 100 + axis: units.steps_per_unit}
    # A mask in grblHAL: homing is its first bit.
    if table.home and not int(says.get(22, 0)) & 1:
        wanted[22] = 1.0
    wrong = {
        number: value
        for number, value in wanted.items()
        if number not in says or abs(says[number] - value) > _TOLERANCE * max(1.0, abs(value))
    }
    if not int(says.get(10, 1)) & 1:
        wrong[10] = 1.0
    if says.get(110 + axis, feed) < feed * (1 - _TOLERANCE):
        wrong[110 + axis] = feed
    if wrong:
        found = ", ".join(f"${number}={says.get(number, 'nothing')}" for number in wrong)
        do = ", ".join(f"${number}={value:.10g}" for number, value in wrong.items())
        raise FirmwareError(
            f"{lines.link.name}: found {found}; expected {do}: type that on the board, or change the configuration"
        )
