"""Looks through the camera with the laser on and off, again and again, while a person aims and focuses a rig."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import count
from typing import Any

import numpy as np

from scanrig.checks import PairProof
from scanrig.config import RigConfig
from scanrig.controllers import require_allowed
from scanrig.session.job import Devices, Hooks, say_event
from scanrig.session.recovery import RecoveringRig
from scanrig.session.run import ended_by, leave_safe
from scanrig.session.steps import ProvenPair, prove


PAUSE_S = 0.2
"""Rest between two looks, so that the laser is mostly dark."""


@dataclass(frozen=True)
class Sight:
    """One look: two frames of the table's home angle."""

    pair: ProvenPair
    """Not proven where `proof.ok` says so."""

    @property
    def on(self) -> np.ndarray:
        """The laser-on frame, uint8 [rows, columns] (rgb8: and 3)."""
        return self.pair.on.image

    @property
    def off(self) -> np.ndarray:
        """The laser-off frame."""
        return self.pair.off.image

    @property
    def proof(self) -> PairProof:
        """What the frames show."""
        return self.pair.proof


def run_aiming(config: RigConfig, devices: Devices, see: Callable[[Sight], None], hooks: Hooks | None = None) -> str:
    """Take pairs at home until the operator asks to stop; nothing is written.

    Args:
        devices: Controller and camera, open.
        see: Called with every look; with several lasers they take turns.
        hooks: Callbacks, of which `notify` and `should_stop` are used.

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
    try:
        rig.prepare()
        rig.doing(lambda: rig.home("start"), "homing")
        for number in count():
            if hooks.should_stop():
                break
            laser = config.laser_of(number)
            taken, doubt = rig.grab(0, number)
            proof = prove(taken, config, laser)
            see(Sight(ProvenPair(taken.on, taken.off, proof, taken.position, doubt.reasons, laser)))
            devices.clock.sleep(PAUSE_S)
    except BaseException as problem:
        ending = ended_by(problem, devices.controller)
        said, error = ending.message, ending.error
    unsafe = leave_safe(devices.controller)
    if error is not None:
        if unsafe and error.args:
            error.args = (f"{str(error).rstrip('.')}. {unsafe}", *error.args[1:])
        raise error
    return " ".join(part for part in (said, unsafe) if part)
