"""One step, from the motion to the disk.

Two frames are taken, and again until they are accepted or proven; pairs are proven and written in the background.
"""

import logging
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple, NoReturn, TypeVar

from jaxscan.stripes import frame_rank
from scanrig.cameras import Camera, Frame
from scanrig.checks import PairProof, prove_pair
from scanrig.clock import Clock
from scanrig.config import RigConfig
from scanrig.controllers import Controller, Status
from scanrig.errors import CameraError, CameraTimeout, FrameError
from scanrig.recording import AHEAD, Ledger
from scanrig.session.plan import longest_s, shot_s


log = logging.getLogger(__name__)

LOOK_S = 0.1
"""Longest wait for a frame between two polls of the controller: its watchdog allows 500 ms."""
QUIET_S = 0.2
"""After this much silence no late frame is expected."""
_COUNT = 65536
"""The controller counts exposures modulo this number."""
_MOST_LATE = 64
_FRESH_S = 0.2
"""So long after a shot the contactor is still closed: the controller opens it after 10 s of silence."""


@dataclass
class FrameNumbers:
    """What is known from the step before."""

    next: int | None = None
    """The number of the camera's next frame."""
    counted: tuple[float, int] | None = None
    """When the controller last reported its count of exposures, and the count."""

    def forget(self) -> None:
        """Something else was exposed since, or may have been."""
        self.next = self.counted = None


class RejectedTake(Exception):
    """The frames are not those of the step; the message says why."""


class NoFrame(RejectedTake):
    """No frame came at all."""


@dataclass(frozen=True)
class Station:
    """The devices and settings with which steps are taken."""

    config: RigConfig
    controller: Controller
    """Configured, enabled, homed and armed."""
    camera: Camera
    """Started."""
    clock: Clock = field(default_factory=Clock)
    numbers: FrameNumbers = field(default_factory=FrameNumbers)
    """Kept from step to step, so that a gap between two pairs is noticed too."""
    reopen: Callable[[], None] = lambda: None
    """Called when no frame came in two takes in a row: opens the camera again."""
    rejected: Callable[[str], None] = lambda reason: None
    """Called with the reason for each rejected take."""


class Step(NamedTuple):
    """The pair to take."""

    to: int
    """Position [microsteps from home]."""
    number: int
    """Number of the shot."""
    laser: int = 0
    """Which laser, counted from 0."""


class TakenPair(NamedTuple):
    """Two whole frames of one place, not proven yet."""

    on: Frame
    off: Frame
    position: int
    """Position reported by the controller [microsteps from home]."""
    laser: int
    """Its laser, counted from 0."""


class ProvenPair(NamedTuple):
    """A pair with its proof."""

    on: Frame
    off: Frame
    position: int
    laser: int
    proof: PairProof
    rejected: tuple[str, ...]
    """Why earlier takes were rejected."""


class Rejections(NamedTuple):
    """The rejected takes of a step."""

    reasons: tuple[str, ...] = ()
    verdict: str = ""
    """Of the last one, if it was the proof that rejected it."""

    def also(self, reason: str, verdict: str = "") -> "Rejections":
        return Rejections((*self.reasons, reason), verdict)


def take_pair(station: Station, step: Step, before: Rejections | None = None) -> ProvenPair:
    """Take one step, and retake it at the same position until it is proven.

    Args:
        before: Earlier takes of this step that were rejected; they count.

    Raises:
        FrameError: If none of `1 + config.checks.retakes` takes was proven; if the laser stays on, the
            contactor has been opened.
        CameraError: If frames have the wrong size.
        CameraLost, LinkLost, RigFault, RigError: From camera and controller.
    """
    rejections = before or Rejections()
    if rejections.reasons:
        discard_rest(station)
    while True:
        taken, rejections = grab_whole(station, step, rejections)
        proof = prove(taken, station.config)
        if proof.ok:
            return ProvenPair(*taken, proof, rejections.reasons)
        rejections = rejections.also(proof.reason, proof.verdict)
        station.rejected(proof.reason)
        discard_rest(station)


def grab_whole(station: Station, step: Step, before: Rejections | None = None) -> tuple[TakenPair, Rejections]:
    """Take the frames of one step, and retake them until they are accepted; they are not proven yet.

    Arguments and errors are those of `take_pair`.

    Returns:
        The frames, and all rejected takes of the step so far.
    """
    rejections, silent = before or Rejections(), 0
    while True:
        if len(rejections.reasons) > station.config.checks.retakes:
            _give_up(station, step, rejections)
        if silent >= 2:
            silent = 0
            station.reopen()
        try:
            return grab(station, step), rejections
        except RejectedTake as problem:
            silent = silent + 1 if isinstance(problem, NoFrame) else 0
            rejections = rejections.also(str(problem))
        station.rejected(rejections.reasons[-1])
        discard_rest(station)


def _give_up(station: Station, step: Step, rejections: Rejections) -> NoReturn:
    number, last = step.number, rejections.reasons[-1]
    if rejections.verdict == "stays on":
        station.controller.arm(False)
        raise FrameError(
            f"step {number}: {last}. The contactor has been opened; do not look into the beam, "
            "and cut the laser's supply before working on it."
        )
    raise FrameError(f"step {number}: not proven in {len(rejections.reasons)} takes; reason of the last: {last}.")


def grab(station: Station, step: Step) -> TakenPair:
    """Take two whole frames at a position.

    With a camera that is triggered by a wire the controller runs the whole shot: exactly two complete frames with
    consecutive numbers must come from its two exposures. Otherwise the host switches the laser and renews its lease
    while it waits for the frame.

    Raises:
        RejectedTake: If they are not the two frames of this step; its subclass NoFrame: if none came.
        CameraError: If frames have the wrong size.
        CameraLost, LinkLost, RigFault, RigError: From camera and controller.
    """
    return (_by_wire if station.camera.trigger_mode == "hardware" else _by_hand)(station, step)


def _by_wire(station: Station, step: Step) -> TakenPair:
    """Take a pair by a shot of the controller; frames are matched by their count."""
    controller, camera, config = station.controller, station.camera, station.config
    clock, numbers = station.clock, station.numbers
    waiting = camera.drop()
    if numbers.next is not None:
        numbers.next += waiting
    before = _exposures(station)
    controller.shot(step.to, step.number, number=1 + step.laser)
    give_up = clock.now() + longest_s(config) + shot_s(config)
    frames: list[Frame] = []
    running = True
    while len(frames) < 2 and clock.now() < give_up:
        try:
            frames.append(_look(camera, config))
        except CameraTimeout:
            if running and controller.poll().state != "shot":
                running, give_up = False, clock.now() + config.checks.late_s
    done = controller.wait_shot(step.number, longest_s(config) + shot_s(config))
    exposures = (done.exposures - before) % _COUNT
    if exposures != 2:
        raise RejectedTake(f"the controller counted {exposures} exposures, expected 2")
    if done.position != step.to:
        raise RejectedTake(f"the table stopped at {done.position}, expected {step.to}")
    if len(frames) < 2:
        raise (RejectedTake if frames else NoFrame)(f"{len(frames)} of 2 frames came")
    if more := camera.drop():
        raise RejectedTake(f"{2 + more} frames came, expected 2")
    on, off = frames
    _require_whole(on, off)
    if on.number >= 0 and off.number >= 0:
        expected = on.number if numbers.next is None else numbers.next
        if (on.number, off.number) != (expected, expected + 1):
            raise RejectedTake(f"found the frames {on.number} and {off.number}, expected {expected} and {expected + 1}")
        numbers.next = off.number + 1
    numbers.counted = clock.now(), done.exposures
    return TakenPair(on, off, done.position, step.laser)


def _by_hand(station: Station, step: Step) -> TakenPair:
    """Take a pair by switching the laser from the host, for cameras without a trigger wire."""
    controller, clock, laser = station.controller, station.clock, station.config.laser[step.laser]
    lit = 1 + step.laser
    controller.laser(False)
    _armed(controller)
    position = controller.move(step.to, longest_s(station.config))
    if position != step.to:
        raise RejectedTake(f"the table stopped at {position}, expected {step.to}")
    rest(station.config.turntable.settle_ms / 1000, controller, clock)
    controller.laser(True, number=lit)
    try:
        rest(laser.on_ms / 1000, controller, clock, lit=lit)
        on = _fresh_frame(station, lit=lit)
    except (RejectedTake, CameraError):
        # After any other error the controller is gone or is about to be aborted.
        controller.laser(False)
        raise
    controller.laser(False)
    rest(laser.off_ms / 1000, controller, clock)
    off = _fresh_frame(station)
    _require_whole(on, off)
    return TakenPair(on, off, position, step.laser)


def _exposures(station: Station) -> int:
    """The controller's count of exposures; a count that came with the last shot saves a request of milliseconds."""
    counted, station.numbers.counted = station.numbers.counted, None
    if counted is not None and station.clock.now() - counted[0] < _FRESH_S:
        return counted[1]
    return _armed(station.controller).exposures


def _armed(controller: Controller) -> Status:
    """The state, with the contactor closed; after a long silence the controller opens it without a fault."""
    status = controller.stat()
    if not status.armed and status.fault is None:
        log.info("%s: the contactor was open, as it is after a long silence; it is closed again", controller.name)
        controller.arm(True)
    return status


def _fresh_frame(station: Station, *, lit: int | None = None) -> Frame:
    """A frame exposed after this call began; `lit`: the number of the laser that is on."""
    controller, camera, config, clock = station.controller, station.camera, station.config, station.clock
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
                raise NoFrame(f"no {'laser-on' if lit else 'laser-off'} frame came") from None


def plain_frame(station: Station) -> Frame:
    """A frame without laser.

    Raises:
        CameraTimeout: If none came, or none that is whole.
        CameraLost, LinkLost, RigFault: From camera and controller.
    """
    camera, config = station.camera, station.config
    station.numbers.forget()
    camera.drop()
    exposing = station.controller if camera.trigger_mode == "hardware" else None
    if exposing is not None:
        exposing.trigger()
    elif camera.trigger_mode == "software":
        camera.trigger()
    patience = config.camera.exposure_ms / 1000 + config.checks.late_s
    frame = next_frame(camera, exposing, patience, station.clock)
    if not frame.complete:
        raise CameraTimeout(f"{camera.identity}: frame {frame.number} is not complete")
    return frame


def next_frame(camera: Camera, controller: Controller | None, timeout_s: float, clock: Clock) -> Frame:
    """Wait for the next frame and poll the controller meanwhile, since its watchdog runs during exposures too.

    Raises:
        CameraTimeout: If none came within `timeout_s`.
        CameraLost, LinkLost, RigFault: From camera and controller.
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


def rest(seconds: float, controller: Controller, clock: Clock, *, lit: int | None = None) -> None:
    """Wait and poll the controller meanwhile; renew the lease of the laser that is on, `lit` (from 1)."""
    end = clock.now() + seconds
    while (left := end - clock.now()) > 0:
        clock.sleep(min(left, LOOK_S))
        _keep_alive(controller, lit=lit)


def _keep_alive(controller: Controller, *, lit: int | None) -> None:
    """Poll the controller; renew the lease of the laser that is on."""
    controller.poll()
    if lit is not None:
        controller.laser(True, number=lit)


def _look(camera: Camera, config: RigConfig) -> Frame:
    frame = camera.next(LOOK_S)
    size = config.camera
    expected = (size.height, size.width, 3)[: frame_rank(size.layout)]
    if frame.image.shape != expected:
        raise CameraError(f"found a frame of the shape {frame.image.shape}, expected {expected}; see [camera].")
    return frame


def _require_whole(*frames: Frame) -> None:
    for frame in frames:
        if not frame.complete:
            raise RejectedTake(f"frame {frame.number} is not complete" + (f": {frame.note}" if frame.note else ""))


def discard_rest(station: Station) -> None:
    """Discard frames that were on their way when a take was rejected, so that the next take does not get them."""
    camera = station.camera
    station.numbers.forget()
    if camera.trigger_mode != "free":
        for _ in range(_MOST_LATE):
            try:
                camera.next(QUIET_S)
            except CameraTimeout:
                break
    camera.drop()


def prove(taken: TakenPair, config: RigConfig) -> PairProof:
    """The proof of two frames, by the limits of the configuration."""
    return prove_pair(
        taken.on.image,
        taken.off.image,
        pixel_format=config.camera.layout,
        response=config.camera.response,
        line=config.laser[taken.laser].line,
        limits=config.checks.proof,
        bits=config.camera.bits,
    )


class Place(NamedTuple):
    """A step, and how the table came there."""

    step: Step
    came_from: int
    """Where the table stood before it went there [microsteps]."""
    placement: int | None
    """The board's, in a calibration."""


@dataclass(frozen=True, eq=False)
class Flight:
    """A pair in flight: taken, and perhaps not proven or written yet."""

    place: Place
    taken: TakenPair
    rejections: Rejections
    proof: Future[PairProof]
    stored: Future[bool]
    """Whether it was proven; then it is on the disk."""

    @property
    def record(self) -> int:
        return self.place.step.number


Fields = Callable[[ProvenPair], dict[str, Any]]
"""Makes the fields of a record, beside its images."""
T = TypeVar("T")


class Flights:
    """The pairs in flight, in the order in which they were taken; at most one has a verdict that was not read yet.

    One thread proves and one writes, each in the order in which it was given its work. After the first failure nothing
    more is written, so that a capture never has a gap that nobody knows of.
    """

    def __init__(self, ledger: Ledger, config: RigConfig) -> None:
        """Nothing is in flight; no thread runs before there is work."""
        self._ledger, self._config = ledger, config
        self._prover = ThreadPoolExecutor(1, thread_name_prefix="scanrig-prove")
        self._writer = ThreadPoolExecutor(1, thread_name_prefix="scanrig-write")
        self._failed: BaseException | None = None
        self._flying: deque[Flight] = deque()
        self._last: Flight | None = None

    def __len__(self) -> int:
        """Pairs that may not be on the disk yet."""
        return len(self._flying)

    def begin(self, place: Place, taken: TakenPair, rejections: Rejections, fields: Fields) -> None:
        """Prove a pair, and write it if it is proven, after all that was given before."""
        proof = self._prover.submit(lambda: prove(taken, self._config))
        self._last = self._begin(place, taken, rejections, fields, proof)

    def begin_proven(self, place: Place, pair: ProvenPair, fields: Fields) -> Flight:
        """Write a pair that is proven already."""
        proof: Future[PairProof] = Future()
        proof.set_result(pair.proof)
        taken = TakenPair(pair.on, pair.off, pair.position, pair.laser)
        return self._begin(place, taken, Rejections(pair.rejected), fields, proof)

    def verdict(self) -> tuple[Flight, PairProof] | None:
        """Wait for the verdict on the last pair; None if it was read already. A rejected take counts as such."""
        flight, self._last = self._last, None
        if flight is None:
            return None
        proof = flight.proof.result()
        if not proof.ok:
            flight = replace(flight, rejections=flight.rejections.also(proof.reason, proof.verdict))
        return flight, proof

    def landed(self, most: int = AHEAD) -> Iterator[Flight]:
        """The pairs that are on the disk by now; waits until at most so many are not.

        Raises:
            BaseException: What proving or writing raised.
        """
        while self._flying and (len(self._flying) > most or self._flying[0].stored.done()):
            stored = self._flying[0].stored.result()
            flight = self._flying.popleft()
            if stored:
                yield flight

    def write(self, event: dict[str, Any]) -> None:
        """Write an event, after all that was given before."""
        if self._ledger.begun:
            self._submit(partial(self._ledger.write, event))
        else:
            self._ledger.write(event)

    def wait(self) -> None:
        """Wait until all is written, events too; raises what that raised."""
        self._submit(lambda: None).result()

    def end(self) -> list[Flight]:
        """Finish what is in flight and end the threads, also after an error; returns the pairs that are on the disk."""
        self._prover.shutdown()
        self._writer.shutdown()
        landed = [flight for flight in self._flying if flight.stored.exception() is None and flight.stored.result()]
        self._flying.clear()
        return landed

    def _begin(
        self, place: Place, taken: TakenPair, rejections: Rejections, fields: Fields, proof: Future[PairProof]
    ) -> Flight:
        def store() -> bool:
            found = proof.result()
            if found.ok:
                pair = ProvenPair(*taken, found, rejections.reasons)
                self._ledger.add(place.step.number, taken.on.image, taken.off.image, fields(pair))
            return found.ok

        flight = Flight(place, taken, rejections, proof, self._submit(store))
        self._flying.append(flight)
        return flight

    def _submit(self, work: Callable[[], T]) -> Future[T]:
        """Write something in the background; it may wait for a proof. Raises what earlier work raised."""
        if self._failed is not None:
            raise self._failed
        return self._writer.submit(self._unless_failed, work)

    def _unless_failed(self, work: Callable[[], T]) -> T:
        if self._failed is not None:
            raise self._failed
        try:
            return work()
        except BaseException as problem:
            self._failed = problem
            raise
