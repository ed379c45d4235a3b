"""One step: the table at its place, one frame with the laser and one without, proven to be that."""

import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from jaxscan.stripes.frames.formats import frame_rank
from scanrig.cameras.frame import Camera, Frame
from scanrig.checks.proof import PairProof, prove_pair
from scanrig.clock import Clock, SystemClock
from scanrig.config import RigConfig
from scanrig.controllers import Controller, Status
from scanrig.errors import CameraError, CameraTimeout, FrameError
from scanrig.session.plan import longest_s, shot_s


log = logging.getLogger(__name__)

LOOK_S = 0.1
"""Longest wait for a frame between two signs of life to the controller: its link watchdog allows 500 ms."""
QUIET_S = 0.2
"""Silence after which no late frame is expected any more."""
_COUNT = 65536
"""The controller counts exposures modulo this."""
_MOST_LATE = 64


@dataclass(frozen=True)
class Pair:
    """A proven pair."""

    on: Frame
    off: Frame
    proof: PairProof
    position: int
    """Where the controller says it was taken [microsteps from home]."""
    rejected: tuple[str, ...]
    """Why earlier takes were not believed."""


@dataclass
class FrameNumbers:
    """Which number the camera's next frame will have, as far as that is known."""

    next: int | None = None


class _Take(NamedTuple):
    on: Frame
    off: Frame
    position: int


class _Unbelievable(Exception):
    """A take that is dropped; why."""


def take_pair(
    controller: Controller,
    camera: Camera,
    config: RigConfig,
    *,
    to: int,
    number: int,
    numbers: FrameNumbers | None = None,
    clock: Clock | None = None,
    rejected: Callable[[str], None] | None = None,
) -> Pair:
    """Take one step, again and again at the same place until it is proven.

    With a camera that is triggered by a wire the controller runs the whole shot; of its two exposures
    exactly two complete frames with consecutive numbers must come. Otherwise the laser is switched
    from here, its lease renewed while the frame is awaited.

    Args:
        controller: Configured, enabled, homed and armed.
        camera: Started.
        config: The rig.
        to: Where [microsteps from home].
        number: What to call the shot.
        numbers: Kept from step to step: a gap between two pairs is noticed, too.
        clock: For waiting.
        rejected: Called with the reason each time a take is dropped.

    Raises:
        FrameError: If no take in `1 + config.checks.retakes` was believed; where the laser stays on, the
            contactor has been opened.
        CameraError: If frames have the wrong size.
        CameraLost, LinkLost, RigFault, RigError: As camera and controller have it.
    """
    clock = clock or SystemClock()
    numbers = numbers or FrameNumbers()
    take = _by_wire if camera.trigger_mode == "hardware" else _by_hand
    reasons: list[str] = []
    verdict = ""
    for _ in range(1 + config.checks.retakes):
        try:
            taken = take(controller, camera, config, to, number, numbers, clock)
            proof = _prove(taken, config)
            if proof.ok:
                return Pair(taken.on, taken.off, proof, taken.position, tuple(reasons))
            verdict = proof.verdict
            reasons.append(proof.reason)
        except _Unbelievable as problem:
            verdict = ""
            reasons.append(str(problem))
        numbers.next = None
        if rejected is not None:
            rejected(reasons[-1])
        _let_late_frames_come(camera)
    if verdict == "stays on":
        controller.arm(False)
        raise FrameError(
            f"step {number}: {reasons[-1]}. The contactor has been opened; do not look into the beam, "
            "and cut the laser's supply before working on it."
        )
    raise FrameError(f"step {number}: not believed in {len(reasons)} takes, the last time because: {reasons[-1]}.")


def _by_wire(
    controller: Controller, camera: Camera, config: RigConfig, to: int, number: int, numbers: FrameNumbers, clock: Clock
) -> _Take:
    """The controller runs the shot; frames are matched by their count."""
    waiting = camera.drop()
    if numbers.next is not None:
        numbers.next += waiting
    before = _armed(controller).exposures
    controller.shot(to, number)
    give_up = clock.now() + longest_s(config) + shot_s(config)
    frames: list[Frame] = []
    running = True
    while len(frames) < 2 and clock.now() < give_up:
        try:
            frames.append(_look(camera, config))
        except CameraTimeout:
            if running and controller.poll().state != "shot":
                running, give_up = False, clock.now() + config.checks.late_s
    done = controller.wait_shot(number, longest_s(config) + shot_s(config))
    exposures = (done.exposures - before) % _COUNT
    if exposures != 2:
        raise _Unbelievable(f"the controller counted {exposures} exposures, expected 2")
    if done.position != to:
        raise _Unbelievable(f"the table stopped at {done.position}, expected {to}")
    if len(frames) < 2:
        raise _Unbelievable(f"{len(frames)} of 2 frames came")
    if more := camera.drop():
        raise _Unbelievable(f"{2 + more} frames came, expected 2")
    on, off = frames
    _require_whole(on, off)
    if on.number >= 0 and off.number >= 0:
        expected = on.number if numbers.next is None else numbers.next
        if (on.number, off.number) != (expected, expected + 1):
            raise _Unbelievable(
                f"found the frames {on.number} and {off.number}, expected {expected} and {expected + 1}"
            )
        numbers.next = off.number + 1
    return _Take(on, off, done.position)


def _by_hand(
    controller: Controller, camera: Camera, config: RigConfig, to: int, number: int, numbers: FrameNumbers, clock: Clock
) -> _Take:
    """Laser and exposures are commanded from here, for cameras that no wire triggers."""
    del number, numbers
    controller.laser(False)
    _armed(controller)
    position = controller.move(to, longest_s(config))
    if position != to:
        raise _Unbelievable(f"the table stopped at {position}, expected {to}")
    rest(config.turntable.settle_ms / 1000, controller, clock, lit=False)
    controller.laser(True)
    try:
        rest(config.laser[0].on_ms / 1000, controller, clock, lit=True)
        on = _fresh_frame(controller, camera, config, clock, lit=True)
    except (_Unbelievable, CameraError):
        # After anything else the controller is not there, or is to be aborted at once.
        controller.laser(False)
        raise
    controller.laser(False)
    rest(config.laser[0].off_ms / 1000, controller, clock, lit=False)
    off = _fresh_frame(controller, camera, config, clock, lit=False)
    _require_whole(on, off)
    return _Take(on, off, position)


def _armed(controller: Controller) -> Status:
    """The state, with the contactor closed: after a long silence the controller has opened it, which is no fault."""
    status = controller.stat()
    if not status.armed and status.fault is None:
        log.info("%s: the contactor was open, as it is after a long silence; it is closed again", controller.name)
        controller.arm(True)
    return status


def _fresh_frame(controller: Controller, camera: Camera, config: RigConfig, clock: Clock, *, lit: bool) -> Frame:
    """A frame that was exposed after this call began."""
    camera.drop()
    if camera.trigger_mode == "software":
        camera.trigger()
    frames = 2 + config.camera.flush_frames
    give_up = clock.now() + frames * config.camera.exposure_ms / 1000 + config.checks.late_s
    while True:
        try:
            return _look(camera, config)
        except CameraTimeout:
            _keep_alive(controller, lit=lit)
            if clock.now() >= give_up:
                raise _Unbelievable(f"no {'laser-on' if lit else 'laser-off'} frame came") from None


def next_frame(camera: Camera, controller: Controller | None, timeout_s: float, clock: Clock) -> Frame:
    """A frame that is on its way, awaited with signs of life: in an exposure, too, the controller's watchdog waits.

    Raises:
        CameraTimeout: If none came within `timeout_s`.
        CameraLost, LinkLost, RigFault: As camera and controller have it.
    """
    give_up = clock.now() + timeout_s
    while True:
        try:
            return camera.next(min(LOOK_S, timeout_s))
        except CameraTimeout:
            if clock.now() >= give_up:
                raise
        if controller is not None:
            controller.poll()


def rest(seconds: float, controller: Controller, clock: Clock, *, lit: bool) -> None:
    """Wait with signs of life to the controller, and with a renewed lease while the laser is on."""
    end = clock.now() + seconds
    while (left := end - clock.now()) > 0:
        clock.sleep(min(left, LOOK_S))
        _keep_alive(controller, lit=lit)


def _keep_alive(controller: Controller, *, lit: bool) -> None:
    """A sign of life; while the laser is on, for its lease too."""
    controller.poll()
    if lit:
        controller.laser(True)


def _look(camera: Camera, config: RigConfig) -> Frame:
    frame = camera.next(LOOK_S)
    size = config.camera
    expected = (size.height, size.width, 3)[: frame_rank(size.pixel_format)]
    if frame.image.shape != expected:
        raise CameraError(f"found a frame of the shape {frame.image.shape}, expected {expected}; see [camera].")
    return frame


def _require_whole(*frames: Frame) -> None:
    for frame in frames:
        if not frame.complete:
            raise _Unbelievable(f"frame {frame.number} is not complete" + (f": {frame.note}" if frame.note else ""))


def _prove(taken: _Take, config: RigConfig) -> PairProof:
    return prove_pair(
        taken.on.image,
        taken.off.image,
        pixel_format=config.camera.pixel_format,
        response=config.camera.response,
        line=config.laser[0].line,
        limits=config.checks.proof,
    )


def _let_late_frames_come(camera: Camera) -> None:
    """What was on its way when a take was dropped must not be taken for a part of the next."""
    if camera.trigger_mode != "free":
        for _ in range(_MOST_LATE):
            try:
                camera.next(QUIET_S)
            except CameraTimeout:
                break
    camera.drop()
