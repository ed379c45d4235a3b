"""The rig in the hands of a session: made ready, homed, and brought back after what can be recovered from."""

import contextlib
from collections.abc import Callable
from typing import TypeVar

import numpy as np

from scanrig.cameras import Features
from scanrig.cameras.features import differences
from scanrig.config import RigConfig
from scanrig.controllers import Firmware, Status
from scanrig.errors import (
    CameraError,
    CameraLost,
    CameraTimeout,
    Fault,
    LinkLost,
    Reason,
    Refused,
    RigFault,
    RigTimeout,
    SessionError,
)
from scanrig.session.job import Devices
from scanrig.session.plan import controller_settings, longest_s, nearest
from scanrig.session.step import FrameNumbers, ProvenPair, Station, Step, next_frame, take_pair


Note = Callable[..., None]
"""Called with the name of an event and its fields."""

_TEMPORARY = {Fault.LINK_LOST, Fault.LEASE_RAN_OUT, Fault.CAMERA_NOT_READY}
"""Faults that need no person."""
_AFTER_RESET = {Reason.NOT_HOMED, Reason.NO_SESSION, Reason.DRIVER_OFF, Reason.NOT_ARMED}
"""Refusals of a controller that has forgotten."""
_ABOVE_HOME_DEG = 3.0
_STILL_S = 10.0
_RECOVERIES = 5
"""Recoveries from one failed step, of any kind, before the session ends."""
_LONGEST_PAUSE_S = 5.0

T = TypeVar("T")


class RecoveringRig:
    """Controller and camera of a session, brought back after whatever can be recovered from."""

    def __init__(self, config: RigConfig, devices: Devices, note: Note) -> None:
        """Nothing is sent yet; `note` is told of faults, retakes and homings."""
        self.controller, self.camera, self.config = devices.controller, devices.camera, config
        self.features: Features = {}
        self.position_known = False
        """Whether the controller was homed when it was made ready, so that its counter says where home is missed."""
        self.homings = 0
        self.rejected = 0
        """Takes that were dropped."""
        self.tolerance = config.checks.lost_steps_tolerance
        """Microsteps by which home may be missed."""
        self._clock, self._note = devices.clock, note
        self._numbers = FrameNumbers()
        self._homing = False
        """Whether a homing was begun whose result was not heard: it may have set the counter to 0."""
        self._dark = False
        """Whether the contactor stays open, whatever has to be recovered from: somebody is in front of the laser."""

    def prepare(self) -> Firmware:
        """Begin a session with both: at rest, out of a fault, set up; not homed yet.

        Raises:
            RigFault: If the e-stop is pressed.
            RigError: If one of them is not what it should be.
        """
        controller = self.controller
        firmware = controller.hello()
        controller.stop()
        status = self._await_rest()
        if status.estop:
            raise RigFault(Fault.EMERGENCY_STOP, status.position)
        if status.state == "fault":
            controller.clear()
            status = controller.stat()
        self.position_known = status.homed
        controller.configure(controller_settings(self.config))
        self.camera.start()
        self.features = self.camera.features()
        return firmware

    def home(self, why: str) -> int | None:
        """Enable, find home, and close the contactor.

        Returns:
            By how many microsteps home was missed; None where the counter did not say, because the
            controller had not been homed, or had been by a homing whose result was not heard.
        """
        controller, n = self.controller, self.config.microsteps_per_turn
        known = self.position_known
        controller.enable(True)
        if known:
            self._come_from_above()
        known, self._homing = known and not self._homing, True
        was = controller.home(nearest(self.config.turntable.home_within_deg, n), longest_s(self.config))
        self.position_known, self._homing = True, False
        self.homings += 1
        missed = (was + n // 2) % n - n // 2 if known and was is not None else None
        good = {} if missed is None else {"missed": missed, "good": abs(missed) <= self.tolerance}
        self._note("home", why=why, was=was, **good)
        if not self._dark:
            self.arm(True)
        return missed

    def _come_from_above(self) -> None:
        """Home is looked for downwards; from below it would be found a turn further down, and wind up the cables."""
        above = nearest(_ABOVE_HOME_DEG, self.config.microsteps_per_turn)
        limits = controller_settings(self.config).limits
        if limits is not None:
            above = min(above, limits[1])
        if self.controller.stat().position < above:
            self.controller.move(above, longest_s(self.config))

    def arm(self, on: bool) -> None:
        """Close or open the contactor."""
        self.controller.arm(on)
        if not on:
            # Without the laser somebody may look through the camera: its next frame may have any number.
            self._numbers.next = None

    def dark(self) -> None:
        """Open the contactor, and keep it open until `light`."""
        self._dark = True
        self.doing(lambda: self.arm(False), "opening the contactor")

    def light(self) -> None:
        """Close the contactor again."""
        self._dark = False
        self.doing(lambda: self.arm(True), "closing the contactor")

    def look(self) -> np.ndarray:
        """What the camera sees now, without laser: uint8 [rows, columns] (rgb8: and 3).

        Raises:
            CameraTimeout: If no whole frame came, however often it was asked for.
            RigError: If the rig did not come back.
        """
        for _ in range(self.config.checks.retakes):
            try:
                return self.doing(self._look, "a look")
            except CameraTimeout as problem:
                self._note("retake", reason=str(problem))
        return self.doing(self._look, "a look")

    def _look(self) -> np.ndarray:
        camera, settings = self.camera, self.config.camera
        self._numbers.next = None
        camera.drop()
        exposing = self.controller if camera.trigger_mode == "hardware" else None
        if exposing is not None:
            exposing.trigger()
        elif camera.trigger_mode == "software":
            camera.trigger()
        frame = next_frame(camera, exposing, settings.exposure_ms / 1000 + self.config.checks.late_s, self._clock)
        if not frame.complete:
            raise CameraTimeout(f"{camera.identity}: frame {frame.number} is not complete")
        return frame.image

    def take(self, to: int, number: int) -> ProvenPair:
        """Take one record, of the laser that its number says; come back from a lost link, a reset, a lost camera and
        temporary faults.

        Raises:
            FrameError: If the step could not be proven.
            RigFault: After an e-stop, or another fault that needs a person.
            RigError: If the rig did not come back.
        """
        return self.doing(
            lambda: take_pair(
                Station(self.config, self.controller, self.camera, self._clock, self._numbers),
                Step(to, number, self.config.laser_of(number)),
                lambda reason: self._rejected(number, reason),
            ),
            f"step {number}",
        )

    def doing(self, work: Callable[[], T], what: str) -> T:
        """Do something that may be repeated, and repeat it after a recovery."""
        for _ in range(_RECOVERIES):
            try:
                return work()
            except (LinkLost, RigFault, CameraLost, Refused, RigTimeout) as problem:
                self._recover(problem, what)
        return work()

    def _rejected(self, number: int, reason: str) -> None:
        self.rejected += 1
        self._note("retake", step=number, reason=reason)

    def _recover(self, problem: Exception, what: str) -> None:
        """Make the rig as it was, or raise what cannot be helped."""
        self._numbers.next = None
        self._note("fault", at=what, problem=str(problem))
        if isinstance(problem, RigFault) and problem.fault not in _TEMPORARY:
            raise problem
        if isinstance(problem, Refused) and problem.reason not in _AFTER_RESET:
            raise problem
        try:
            if isinstance(problem, LinkLost):
                self._reconnect(problem)
            elif isinstance(problem, CameraLost):
                self._quieten()
                self._reopen(problem)
            self._make_ready()
        except (LinkLost, RigFault) as again:
            # It went away once more, while it was brought back; the next try has the same cure.
            if isinstance(again, RigFault) and again.fault not in _TEMPORARY:
                raise
            self._reconnect(again)
            self._make_ready()
        self._note("recovered", at=what)

    def _quieten(self) -> None:
        """No light while the camera is looked for; a lease or a watchdog that runs out would be a fault of its own."""
        with contextlib.suppress(Refused):
            self.controller.stop()
        self.controller.laser(False)
        self.arm(False)

    def _reconnect(self, problem: Exception) -> None:
        patience = 2.0 * (1 + self.config.controller.reconnects)
        found = self.controller.reconnect(patience)
        if found.status.estop:
            raise RigFault(Fault.EMERGENCY_STOP, found.status.position) from problem
        if not found.same_boot:
            self.position_known = False
            # Its settings are gone with the rest.
            self._await_rest()
            self.controller.configure(controller_settings(self.config))
        self._note("reconnected", same_boot=found.same_boot)

    def _reopen(self, problem: Exception) -> None:
        """Open the camera again, and see that it is set as it was."""
        last: Exception = problem
        for attempt in range(self.config.checks.camera_reopens):
            self._clock.sleep(min(0.25 * 2**attempt, _LONGEST_PAUSE_S) if attempt else 0.0)
            try:
                self.camera.reopen()
                self.camera.start()
                self.require_features(self.features)
            except CameraLost as again:
                last = again
                continue
            self._note("camera", reopened=attempt + 1)
            return
        raise CameraError(
            f"{self.camera.identity} did not come back in {self.config.checks.camera_reopens} tries: {last}"
        ) from problem

    def require_features(self, expected: Features) -> None:
        """See that the camera is set as it was.

        Raises:
            CameraError: With all differences.
        """
        if wrong := differences(self.camera.features(), expected):
            raise CameraError(
                f"{self.camera.identity}: is not set as it was when the capture began: {'; '.join(wrong)}. "
                "Set it so, or begin a new capture."
            )

    def _make_ready(self) -> None:
        """Out of a fault, enabled, homed if it has to be, armed."""
        status = self._await_rest()
        if status.estop:
            raise RigFault(Fault.EMERGENCY_STOP, status.position)
        if status.state == "fault":
            if status.fault not in _TEMPORARY:
                raise RigFault(status.fault or Fault.UNKNOWN, status.position)
            self.controller.clear()
            status = self.controller.stat()
        if not (status.enabled and status.homed):
            # Where it was stopped while it ran, its counter may be wrong for that reason alone.
            self.position_known = False
            self.home("after a fault")
        elif not status.armed and not self._dark:
            self.arm(True)

    def _await_rest(self) -> Status:
        """Ask until nothing moves any more."""
        end = self._clock.now() + _STILL_S
        while (status := self.controller.stat()).state not in ("idle", "fault"):
            if self._clock.now() > end:
                raise SessionError(f'the controller is in the state "{status.state}" for {_STILL_S:g} s; restart it.')
            self._clock.sleep(0.05)
        return status
