"""One step: its two frames and their proof; a take that is not believed or not proven is taken again."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, NoReturn

from scanrig.cameras import Frame
from scanrig.checks import PairProof, prove_pair
from scanrig.config import RigConfig
from scanrig.errors import FrameError
from scanrig.session.steps.grab import NoFrame, Station, Step, TakenPair, Unbelievable, discard_rest, grab


@dataclass(frozen=True)
class ProvenPair:
    """A proven pair."""

    on: Frame
    off: Frame
    proof: PairProof
    position: int
    """Position reported by the controller [microsteps from home]."""
    rejected: tuple[str, ...]
    """Why earlier takes were rejected."""
    laser: int = 0
    """Its laser, counted from 0."""


Rejected = Callable[[str], None]
"""Called with the reason for each rejected take."""


class Doubt(NamedTuple):
    """The rejected takes of a step."""

    reasons: tuple[str, ...] = ()
    verdict: str = ""
    """Of the last one, if it was the proof that rejected it."""

    def also(self, reason: str, verdict: str = "") -> "Doubt":
        """With one more."""
        return Doubt((*self.reasons, reason), verdict)


def take_pair(
    station: Station, step: Step, rejected: Rejected | None = None, before: Doubt | None = None
) -> ProvenPair:
    """Take one step, and retake it at the same position until it is proven.

    Args:
        station: The devices.
        step: The pair to take.
        rejected: Called with the reason for each rejected take.
        before: Earlier takes of this step that were rejected; they count.

    Raises:
        FrameError: If none of `1 + config.checks.retakes` takes was proven; if the laser stays on, the
            contactor has been opened.
        CameraError: If frames have the wrong size.
        CameraLost, LinkLost, RigFault, RigError: From camera and controller.
    """
    doubt = before or Doubt()
    if doubt.reasons:
        discard_rest(station)
    while True:
        taken, doubt = grab_whole(station, step, rejected, doubt)
        proof = prove(taken, station.config, step.laser)
        if proof.ok:
            return ProvenPair(taken.on, taken.off, proof, taken.position, doubt.reasons, step.laser)
        doubt = doubt.also(proof.reason, proof.verdict)
        _reject(station, rejected, proof.reason)


def grab_whole(
    station: Station, step: Step, rejected: Rejected | None = None, before: Doubt | None = None
) -> tuple[TakenPair, Doubt]:
    """Take the frames of one step, and retake them until they are believed; they are not proven yet.

    Args and errors are those of `take_pair`.

    Returns:
        The frames, and all rejected takes of the step so far.
    """
    doubt, silent = before or Doubt(), 0
    while True:
        left = station.config.checks.retakes - len(doubt.reasons)
        if left < 0:
            _give_up(station, step, doubt)
        if silent >= 2:
            silent = 0
            station.reopen()
        try:
            return grab(station, step), doubt
        except Unbelievable as problem:
            silent = silent + 1 if isinstance(problem, NoFrame) else 0
            doubt = doubt.also(str(problem))
        _reject(station, rejected, doubt.reasons[-1])


def _reject(station: Station, rejected: Rejected | None, reason: str) -> None:
    if rejected is not None:
        rejected(reason)
    discard_rest(station)


def _give_up(station: Station, step: Step, doubt: Doubt) -> NoReturn:
    number, last = step.number, doubt.reasons[-1]
    if doubt.verdict == "stays on":
        station.controller.arm(False)
        raise FrameError(
            f"step {number}: {last}. The contactor has been opened; do not look into the beam, "
            "and cut the laser's supply before working on it."
        )
    raise FrameError(f"step {number}: not proven in {len(doubt.reasons)} takes; reason of the last: {last}.")


def prove(taken: TakenPair, config: RigConfig, laser: int) -> PairProof:
    """The proof of two frames, by the limits of the configuration."""
    return prove_pair(
        taken.on.image,
        taken.off.image,
        pixel_format=config.camera.pixel_format,
        response=config.camera.response,
        line=config.laser[laser].line,
        limits=config.checks.proof,
    )
