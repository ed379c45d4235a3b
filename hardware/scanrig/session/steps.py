"""One step: a pair is taken until it is accepted, and proven and written while the next one is taken."""

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


class RejectedTake(Exception):
    """The frames are not those of the step; the message says why."""


class NoFrame(RejectedTake):
    """No frame came at all."""


class Rejections(NamedTuple):
    """The rejected takes of a step."""

    reasons: tuple[str, ...] = ()
    verdict: str = ""
    """Verdict on the last take, if it was the proof that rejected it."""

    def also(self, reason: str, verdict: str = "") -> "Rejections":
        return Rejections((*self.reasons, reason), verdict)


NONE = Rejections()


@dataclass(frozen=True, eq=False)
class Pair:
    """Two whole frames of one place, laser on and off."""

    record: int
    laser: int
    position: int
    """Position that the controller reported [microsteps from home]."""
    on: Frame
    off: Frame
    rejections: Rejections


def prove(pair: Pair, config: RigConfig) -> PairProof:
    """The proof of two frames, by the limits of the configuration."""
    return prove_pair(
        pair.on.image,
        pair.off.image,
        pixel_format=config.camera.layout,
        response=config.camera.response,
        line=config.laser[pair.laser].line,
        limits=config.checks.proof,
        bits=config.camera.bits,
    )


@dataclass(eq=False)
class Station:
    """Takes pairs with a controller that is configured, enabled, homed and armed, and a camera that is started.

    Each method may raise what camera and controller raise: CameraLost, LinkLost, RigFault, RigError; and CameraError
    for frames of the wrong size.
    """

    config: RigConfig
    controller: Controller
    camera: Camera
    clock: Clock = field(default_factory=Clock)
    rejected: Callable[[int, str], None] = lambda record, reason: None
    """Called with record and reason for each rejected take."""
    reopen: Callable[[str], None] = lambda action: None
    """Called when no frame came in two takes in a row: opens the camera again."""
    next_number: int | None = None
    """The camera's next frame, so that a gap between two pairs is noticed too."""
    _counted: tuple[float, int] | None = None
    """When the controller last reported its count of exposures, and the count."""

    def forget(self) -> None:
        """Something else was exposed since the last pair, or may have been."""
        self.next_number = self._counted = None

    def take(self, to: int, record: int, before: Rejections = NONE) -> tuple[Pair, PairProof]:
        """Take a pair at a position [microsteps], and again until it is proven; earlier rejections count.

        Raises:
            FrameError: If none of `1 + config.checks.retakes` takes was proven; if the laser stays on, the
                contactor has been opened.
        """
        rejections = before
        if rejections.reasons:
            self._discard_rest()
        while True:
            pair = self.grab(to, record, rejections)
            proof = prove(pair, self.config)
            if proof.ok:
                return pair, proof
            rejections = pair.rejections.also(proof.reason, proof.verdict)
            self.rejected(record, proof.reason)
            self._discard_rest()

    def grab(self, to: int, record: int, before: Rejections = NONE) -> Pair:
        """Take two whole frames, and again until they are accepted; they are not proven. Raises as `take`.

        With a camera that is triggered by a wire the controller runs the whole shot: exactly two complete frames with
        consecutive numbers must come from its two exposures. Otherwise the host switches the laser and renews its lease
        while it waits for the frame.
        """
        rejections, silent = before, 0
        grab = self._by_wire if self.camera.trigger_mode == "hardware" else self._by_hand
        while True:
            if len(rejections.reasons) > self.config.checks.retakes:
                self._give_up(record, rejections)
            if silent >= 2:
                silent = 0
                self.reopen(f"step {record}")
            try:
                on, off = grab(to, record)
                return Pair(record, self.config.laser_of(record), to, on, off, rejections)
            except RejectedTake as problem:
                silent = silent + 1 if isinstance(problem, NoFrame) else 0
                rejections = rejections.also(str(problem))
            self.rejected(record, rejections.reasons[-1])
            self._discard_rest()

    def plain_frame(self) -> Frame:
        """A frame without laser. Raises CameraTimeout if none came that is whole."""
        self.forget()
        self.camera.drop()
        exposing = self.camera.trigger_mode == "hardware"
        if exposing:
            self.controller.trigger()
        elif self.camera.trigger_mode == "software":
            self.camera.trigger()
        patience = self.config.camera.exposure_ms / 1000 + self.config.checks.late_s
        frame = next_frame(self.camera, self.controller if exposing else None, patience, self.clock)
        if not frame.complete:
            raise CameraTimeout(f"{self.camera.identity}: frame {frame.number} is not complete")
        return frame

    def _give_up(self, record: int, rejections: Rejections) -> NoReturn:
        last = rejections.reasons[-1]
        if rejections.verdict == "stays on":
            self.controller.arm(False)
            raise FrameError(
                f"step {record}: {last}. The contactor has been opened; do not look into the beam, "
                "and cut the laser's supply before working on it."
            )
        raise FrameError(f"step {record}: not proven in {len(rejections.reasons)} takes; reason of the last: {last}.")

    def _by_wire(self, to: int, record: int) -> tuple[Frame, Frame]:
        """A shot of the controller; frames are matched by their count."""
        controller, clock, longest = self.controller, self.clock, longest_s(self.config) + shot_s(self.config)
        waiting = self.camera.drop()
        expected = None if self.next_number is None else self.next_number + waiting
        before = self._exposures()
        controller.shot(to, record, number=1 + self.config.laser_of(record))
        give_up, running = clock.now() + longest, True
        frames: list[Frame] = []
        while len(frames) < 2 and clock.now() < give_up:
            try:
                frames.append(self._look())
            except CameraTimeout:
                if running and controller.poll().state != "shot":
                    running, give_up = False, clock.now() + self.config.checks.late_s
        done = controller.wait_shot(record, longest)
        exposures = (done.exposures - before) % _COUNT
        if exposures != 2:
            raise RejectedTake(f"the controller counted {exposures} exposures, expected 2")
        _require_place(done.position, to)
        if len(frames) < 2:
            raise (RejectedTake if frames else NoFrame)(f"{len(frames)} of 2 frames came")
        if more := self.camera.drop():
            raise RejectedTake(f"{2 + more} frames came, expected 2")
        on, off = frames
        _require_whole(on, off)
        if on.number >= 0 and off.number >= 0:
            first = on.number if expected is None else expected
            if (on.number, off.number) != (first, first + 1):
                raise RejectedTake(f"found the frames {on.number} and {off.number}, expected {first} and {first + 1}")
            self.next_number = off.number + 1
        self._counted = clock.now(), done.exposures
        return on, off

    def _by_hand(self, to: int, record: int) -> tuple[Frame, Frame]:
        """The laser switched by the host, for cameras without a trigger wire."""
        controller, config, lit = self.controller, self.config, 1 + self.config.laser_of(record)
        laser = config.laser[lit - 1]
        controller.laser(False)
        self._armed()
        _require_place(controller.move(to, longest_s(config)), to)
        rest(config.turntable.settle_ms / 1000, controller, self.clock)
        controller.laser(True, number=lit)
        try:
            rest(laser.on_ms / 1000, controller, self.clock, lit=lit)
            on = self._fresh_frame(lit)
        except (RejectedTake, CameraError):
            # After any other error the controller is gone or is about to be aborted.
            controller.laser(False)
            raise
        controller.laser(False)
        rest(laser.off_ms / 1000, controller, self.clock)
        off = self._fresh_frame()
        _require_whole(on, off)
        return on, off

    def _exposures(self) -> int:
        """The controller's count of exposures; one that came with the last shot saves a request of milliseconds."""
        counted, self._counted = self._counted, None
        if counted is not None and self.clock.now() - counted[0] < _FRESH_S:
            return counted[1]
        return self._armed().exposures

    def _armed(self) -> Status:
        """The state, with the contactor closed; after a long silence the controller opens it without a fault."""
        status = self.controller.stat()
        if not status.armed and status.fault is None:
            log.info("%s: the contactor was open, as after a long silence; it is closed again", self.controller.name)
            self.controller.arm(True)
        return status

    def _fresh_frame(self, lit: int | None = None) -> Frame:
        """A frame exposed after this call began; `lit`: the number of the laser that is on."""
        camera = self.config.camera
        self.camera.drop()
        if self.camera.trigger_mode == "software":
            self.camera.trigger()
        wait_s = (2 + camera.flush_frames) * camera.exposure_ms / 1000 + self.config.checks.late_s
        give_up = self.clock.now() + wait_s
        while True:
            try:
                return self._look()
            except CameraTimeout:
                _keep_alive(self.controller, lit)
                if self.clock.now() >= give_up:
                    raise NoFrame(f"no {'laser-on' if lit else 'laser-off'} frame came") from None

    def _look(self) -> Frame:
        frame, size = self.camera.next(LOOK_S), self.config.camera
        expected = (size.height, size.width, 3)[: frame_rank(size.layout)]
        if frame.image.shape != expected:
            raise CameraError(f"found a frame of the shape {frame.image.shape}, expected {expected}; see [camera].")
        return frame

    def _discard_rest(self) -> None:
        """Discard frames that were on their way when a take was rejected, so that the next take does not get them."""
        self.forget()
        if self.camera.trigger_mode != "free":
            for _ in range(_MOST_LATE):
                try:
                    self.camera.next(QUIET_S)
                except CameraTimeout:
                    break
        self.camera.drop()


def _require_place(position: int, to: int) -> None:
    if position != to:
        raise RejectedTake(f"the table stopped at {position}, expected {to}")


def _require_whole(*frames: Frame) -> None:
    for frame in frames:
        if not frame.complete:
            raise RejectedTake(f"frame {frame.number} is not complete" + (f": {frame.note}" if frame.note else ""))


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
        _keep_alive(controller, lit)


def _keep_alive(controller: Controller, lit: int | None) -> None:
    controller.poll()
    if lit is not None:
        controller.laser(True, number=lit)


@dataclass(frozen=True, eq=False)
class Flight:
    """A pair in flight: taken, and perhaps not proven or written yet."""

    pair: Pair
    came_from: int
    placement: int | None
    proof: Future[PairProof]
    stored: Future[bool]
    """Whether it was proven; then it is on the disk."""


Fields = Callable[[Pair, PairProof], dict[str, Any]]
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

    def begin(
        self, pair: Pair, came_from: int, placement: int | None, fields: Fields, proof: PairProof | None = None
    ) -> None:
        """Prove a pair that has no proof yet, and write it if it is proven, after all that was given before."""
        found: Future[PairProof] = Future()
        if proof is None:
            found = self._prover.submit(lambda: prove(pair, self._config))
        else:
            found.set_result(proof)

        def store() -> bool:
            if found.result().ok:
                self._ledger.add(pair.record, pair.on.image, pair.off.image, fields(pair, found.result()))
            return found.result().ok

        flight = Flight(pair, came_from, placement, found, self._submit(store))
        self._flying.append(flight)
        if proof is None:
            self._last = flight

    def verdict(self) -> tuple[Flight, PairProof] | None:
        """Wait for the verdict on the last pair; None if it was read already. A rejected take counts as such."""
        flight, self._last = self._last, None
        if flight is None:
            return None
        proof = flight.proof.result()
        if not proof.ok:
            rejections = flight.pair.rejections.also(proof.reason, proof.verdict)
            flight = replace(flight, pair=replace(flight.pair, rejections=rejections))
        return flight, proof

    def landed(self, most: int = AHEAD) -> Iterator[Flight]:
        """The pairs that are on the disk by now. Waits until at most a given number are not, and raises what failed."""
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
