"""Looks through the camera with the laser on and off, again and again, while a person aims and focuses a rig."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import count
from typing import Any, NamedTuple

import numpy as np

from scanrig.checks import PairProof
from scanrig.config import RigConfig, with_exposure
from scanrig.controllers import require_allowed
from scanrig.errors import CameraError
from scanrig.session.job import Devices, Hooks, say_event
from scanrig.session.plan import angle_deg, controller_settings, nearest
from scanrig.session.recovery import RecoveringRig
from scanrig.session.run import ended_by, including, leave_safe
from scanrig.session.steps import Pair, prove


PAUSE_S = 0.2
"""Rest between two looks, so that the laser is mostly dark."""


class Wish(NamedTuple):
    """What a person who aims wants to see."""

    angle_deg: float = 0.0
    """Where the table is to point; it goes no further than `turntable.limits_deg`."""
    lit: bool = True
    """Whether the laser is to shine, for the time of a frame each; else its contactor stays open."""
    exposure_ms: float | None = None
    gain_db: float | None = None


@dataclass(frozen=True)
class Sight:
    """One look."""

    pair: Pair | None
    """Frames with and without the laser, not proven where `proof.ok` says so; None where it is to be dark."""
    proof: PairProof | None
    off: np.ndarray
    """The laser-off frame, uint8 [rows, columns] (rgb8: and 3)."""
    angle_deg: float

    @property
    def on(self) -> np.ndarray | None:
        """The laser-on frame."""
        return None if self.pair is None else self.pair.on.shown


def run_aiming(
    config: RigConfig,
    devices: Devices,
    see: Callable[[Sight], None],
    hooks: Hooks | None = None,
    wish: Callable[[], Wish] = Wish,
) -> str:
    """Take frames until the operator asks to stop; nothing is written.

    Args:
        see: Called with every look; with several lasers they take turns.
        hooks: Only `notify` and `should_stop` are used.
        wish: What is to be seen next; called before each look.

    Returns:
        A line for people where an e-stop ended it, or where it could not be confirmed that the laser is off; else "".

    Raises:
        RigError: If the rig failed in another way and did not recover. The laser is off, or the message says that this
            is not confirmed.
        KeyboardInterrupt: After an abort.
    """
    require_allowed(devices.controller.guarantees, config.controller)
    hooks = hooks or Hooks()

    def note(name: str, **fields: Any) -> None:
        if sentence := say_event(name, fields):
            hooks.notify(sentence)

    rig, said, error = RecoveringRig(config, devices, note), "", None
    refused: RigConfig | None = None
    try:
        rig.prepare()
        rig.doing(lambda: rig.home("start"), "homing")
        lit = True
        for number in count():
            if hooks.should_stop():
                break
            wanted, camera = wish(), config.camera
            exposed = with_exposure(
                config,
                camera.exposure_ms if wanted.exposure_ms is None else wanted.exposure_ms,
                camera.gain_db if wanted.gain_db is None else wanted.gain_db,
            )
            # What the camera refused once is not tried again.
            if exposed.camera != rig.config.camera and exposed != refused:
                try:
                    rig.adopt(exposed)
                except CameraError as problem:
                    refused = exposed
                    hooks.notify(f"{problem} The former exposure stays.")
            if wanted.lit != lit:
                lit = wanted.lit
                (rig.light if lit else rig.dark)()
            see(_sight(rig, _reachable(config, wanted.angle_deg), number, lit=lit))
            devices.clock.sleep(PAUSE_S)
    except BaseException as problem:
        ending = ended_by(problem, devices.controller)
        said, error = ending.message, ending.error
    unsafe = leave_safe(devices.controller)
    if error is not None:
        raise including(unsafe, error)
    return f"{said} {unsafe}".strip()


def _sight(rig: RecoveringRig, to: int, number: int, *, lit: bool) -> Sight:
    at = angle_deg(to, rig.config.microsteps_per_turn)
    if not lit:
        if to != rig.at:
            rig.approach(to)
        return Sight(None, None, rig.look(), at)
    pair = rig.grab(to, number)
    return Sight(pair, prove(pair, rig.config), pair.off.shown, at)


def _reachable(config: RigConfig, angle: float) -> int:
    """The position of an angle, or the nearest one within the table's limits [microsteps]."""
    turn = config.microsteps_per_turn
    low, high = controller_settings(config).limits or (-turn, turn)
    return min(max(nearest(angle, turn), low), high)
