"""Measures the microsteps of a turn, from home switch to home switch."""

from collections.abc import Callable
from fractions import Fraction

from scanrig.controllers.controller import Controller
from scanrig.errors import RigError


TOLERANCE = 8
"""Microsteps by which the place of the switch may vary from turn to turn."""
_PART = 36
"""Motions begin at 1/36 of a turn above the switch, since the switch is wide."""
_DOUBLINGS = 6
_LARGEST_DENOMINATOR = 200
_MOST_EDGES = 64
_LEAST_S = 60.0


def measure_turn(
    controller: Controller,
    guess: int,
    *,
    speed: float,
    highest: int | None = None,
    tell: Callable[[str], None] = lambda text: None,
) -> int:
    """Turn until the home switch comes again, and turn back the same way, so that no cable winds up.

    Homing searches downwards. A motion that ends a little above one turn therefore finds the edge of that turn, and the
    counter there is the length of one turn or of several; on the way back the edges in between are searched for.

    Args:
        controller: Enabled and homed.
        guess: Expected length of a turn [microsteps].
        speed: Speed of motions, for timeouts [microsteps/s].
        highest: Highest allowed position, at least `needed(guess)`; None: no limit.
        tell: Called with a sentence about each motion.

    Returns:
        Microsteps of a turn.

    Raises:
        RigError: If the switch does not come again within `2**_DOUBLINGS` times the expected turn.
        RigFault, LinkLost: From the controller.
    """
    above = needed(guess) - guess

    def to_switch_from(position: int, reach: int) -> int:
        controller.move(position, _LEAST_S + 2.0 * (abs(position) + reach) / speed)
        was = controller.home(reach, _LEAST_S + 4.0 * reach / speed)
        if was is None:
            raise RigError("the controller does not report where it found the home switch: a turn cannot be measured")
        return was

    top = guess + above
    for _ in range(_DOUBLINGS):
        tell(f"turning up to microstep {top}, then home")
        turns = to_switch_from(top, top + guess)
        if abs(turns) > TOLERANCE:
            break
        reached, top = top, 2 * top
        if highest is not None and top > highest:
            raise RigError(
                f"the home switch did not come again within {reached} microsteps, and the limits forbid more: a turn "
                f"has more than {guess} microsteps, or the table does not turn"
            )
    else:
        raise RigError(
            f"the home switch did not come again within {reached} microsteps, {2 ** (_DOUBLINGS - 1)} times a turn; "
            "check whether the table turns at all"
        )
    rest = turns
    for _ in range(_MOST_EDGES):
        tell(f"back by {rest} microsteps, home on the way")
        edge = -to_switch_from(-(rest // 2) + above, 2 * rest + guess)
        if abs(edge - rest) <= TOLERANCE:
            return rest
        if not TOLERANCE < edge < rest:
            break
        rest -= edge
    raise RigError(
        f"the home switch was found at {edge} microsteps on the way back, expected at {rest} or before: steps are "
        "lost, or the switch has moved; check belt, motor current and speed"
    )


def needed(guess: int) -> int:
    """Least height above home to which the table must turn to measure a turn of `guess` microsteps."""
    return guess + max(guess // _PART, 8)


def fitting_gear(turn: int, motor_turn: int) -> tuple[int, int] | None:
    """The simplest ratio of two integers that gives the turn within `TOLERANCE`; None if there is none.

    Args:
        turn: Microsteps of a turn of the table, as measured.
        motor_turn: Microsteps of a turn of the motor.
    """
    for denominator in range(1, _LARGEST_DENOMINATOR + 1):
        numerator = round(turn * denominator / motor_turn)
        whole = (motor_turn * numerator) % denominator == 0
        if numerator and whole and abs(Fraction(motor_turn * numerator, denominator) - turn) <= TOLERANCE:
            return numerator, denominator
    return None
