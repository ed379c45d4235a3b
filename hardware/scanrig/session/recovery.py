"""A session's rig: made ready, homed, and recovered after faults."""

import contextlib
from collections.abc import Callable
from functools import partial
from typing import TypeVar

import numpy as np

from scanrig.cameras import Features, require_same
from scanrig.checks import PairProof
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
from scanrig.session.steps import NONE, Pair, Rejections, Station


_TEMPORARY = {Fault.LINK_LOST, Fault.LEASE_RAN_OUT, Fault.CAMERA_NOT_READY}
"""Faults that can be cleared without a person."""
_AFTER_RESET = {Reason.NOT_HOMED, Reason.NO_SESSION, Reason.DRIVER_OFF, Reason.NOT_ARMED}
"""Refusals of a controller that has lost its state."""
_ABOVE_HOME_DEG = 3.0
_STILL_S = 10.0
_LONGEST_PAUSE_S = 5.0
"""Between two attempts to open a lost camera."""
_RECOVERIES = 5
"""Recoveries of one step before the session ends."""

T = TypeVar("T")


class RecoveringRig:
    """Controller and camera of a session; recovers from lost links, resets, lost cameras and temporary faults.

    Its actions raise RigFault after an e-stop or another fault that needs a person, and RigError if the rig did not
    recover.
    """

    def __init__(self, config: RigConfig, devices: Devices, note: Callable[..., None]) -> None:
        """Nothing is sent yet; `note` gets the names of faults, retakes and homings, and their fields."""
        self.controller, self.camera, self._clock, self._note = devices.controller, devices.camera, devices.clock, note
        self._station = Station(
            config, self.controller, self.camera, self._clock, rejected=self.reject, reopen=self._open_anew
        )
        self.features: Features = {}
        self.position_known = False
        """Whether the counter is valid, so that the next homing shows by how much home is missed."""
        self.homings = 0
        self.rejected = 0
        self.at = self.came_from = 0
        """Where the last step was taken, and where the table stood before it went there [microsteps]."""
        self._homing = False
        """Whether a homing was begun whose result did not arrive: it may have set the counter to 0."""
        self._dark = False
        """Whether the contactor stays open even after a recovery, because somebody is in front of the laser."""

    @property
    def config(self) -> RigConfig:
        return self._station.config

    def prepare(self) -> Firmware:
        """Begin a session: table at rest, faults cleared, controller and camera set up; not homed yet.

        Raises:
            RigFault: If the e-stop is pressed.
            RigError: If controller or camera is not the expected one or does not take its settings.
        """
        firmware = self.controller.hello()
        self.controller.stop()
        self.position_known = self._rested(set(Fault)).homed
        self.controller.configure(controller_settings(self.config))
        self.camera.start()
        self.features = self.camera.features()
        return firmware

    def home(self, why: str) -> None:
        """Enable the motor, find home, and close the contactor; notes by how many microsteps home was missed.

        That is not known where the counter was not valid: the controller had not been homed, or the result of its
        homing did not arrive.
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
        self.at = self.came_from = 0
        good = {}
        if known and was is not None:
            missed = (was + n // 2) % n - n // 2
            good = {"missed": missed, "good": abs(missed) <= self.config.checks.lost_steps_tolerance}
        self._note("home", why=why, was=was, **good)
        if not self._dark:
            self.arm(True)

    def arm(self, on: bool) -> None:
        self.controller.arm(on)
        if not on:
            # With the contactor open, frames are taken without a shot, so the next frame number is not known.
            self._station.forget()

    def dark(self) -> None:
        """Open the contactor, and keep it open until `light`."""
        self._dark = True
        self.doing(lambda: self.arm(False), "opening the contactor")

    def light(self) -> None:
        self._dark = False
        self.doing(lambda: self.arm(True), "closing the contactor")

    def adopt(self, config: RigConfig) -> None:
        """Go on with other settings of the same camera; the laser stays off until it has them.

        Raises:
            CameraError: If the camera does not take them. It has the former ones then.
        """
        before, self._station.config, refused = self.config, config, None
        self._station.forget()
        self._quieten()
        try:
            self.camera.adopt(config.camera)
        except CameraError as problem:
            self._station.config, refused = before, problem
            self.camera.adopt(before.camera)
        self.camera.start()
        self.features = self.camera.features()
        self.doing(lambda: self.controller.configure(controller_settings(self.config)), "other settings")
        if not self._dark:
            self.light()
        if refused is not None:
            raise refused

    def look(self) -> np.ndarray:
        """Take a frame without laser: uint8 [rows, columns] (rgb8: and 3).

        Raises:
            CameraTimeout: If no complete frame came in any try.
        """
        attempt = 0
        while True:
            try:
                return self.doing(partial(self._look, attempt), "a look")
            except CameraTimeout as problem:
                if attempt == self.config.checks.retakes:
                    raise
                self._note("retake", reason=str(problem))
                attempt += 1

    def take(self, to: int, record: int, before: Rejections = NONE) -> tuple[Pair, PairProof]:
        """Take one record, with the laser of its number, until it is proven. Raises FrameError if it could not be."""
        return self._step(lambda: self._station.take(to, record, before), to, record)

    def grab(self, to: int, record: int) -> Pair:
        """Take the frames of one record, not proven yet, and recover as `take` does."""
        return self._step(lambda: self._station.grab(to, record), to, record)

    def approach(self, to: int) -> None:
        """Go to a position, so that the next motion comes from there."""
        self.doing(lambda: self.controller.move(to, longest_s(self.config)), "going back")
        self.at = to

    def reject(self, record: int, reason: str) -> None:
        """Count and note a take that was rejected."""
        self.rejected += 1
        self._note("retake", step=record, reason=reason)

    def doing(self, work: Callable[[], T], action: str) -> T:
        """Do some repeatable work, and repeat it after each recovery; `action` names it."""
        for _ in range(_RECOVERIES):
            try:
                return work()
            except (LinkLost, RigFault, CameraLost, Refused, RigTimeout) as problem:
                self._recover(problem, action)
        return work()

    def _look(self, attempt: int) -> np.ndarray:
        if attempt > 0 and attempt % 2 == 0:
            # Here, where a fault during the reopening is recovered too.
            self._open_anew("a look")
        return self._station.plain_frame().shown

    def _step(self, take: Callable[[], T], to: int, record: int) -> T:
        taken = self.doing(take, f"step {record}")
        if to != self.at:
            self.came_from, self.at = self.at, to
        return taken

    def _come_from_above(self) -> None:
        """Move above home, since homing searches downwards: from below it would end a turn lower and wind up cables."""
        above = nearest(_ABOVE_HOME_DEG, self.config.microsteps_per_turn)
        limits = controller_settings(self.config).limits
        if limits is not None:
            above = min(above, limits[1])
        if self.controller.stat().position < above:
            self.controller.move(above, longest_s(self.config))

    def _open_anew(self, action: str) -> None:
        self._recover(CameraLost(f"{self.camera.identity}: no frame came, twice in a row"), action)

    def _recover(self, problem: Exception, action: str) -> None:
        """Recover the rig, or raise the error that needs a person."""
        self._station.forget()
        self._note("fault", at=action, problem=str(problem))
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
            # It failed again during the recovery: reconnect once more.
            if isinstance(again, RigFault) and again.fault not in _TEMPORARY:
                raise
            self._reconnect(again)
            self._make_ready()
        self._note("recovered", at=action)

    def _quieten(self) -> None:
        """Switch the laser off before the camera is reopened, so that no lease runs out meanwhile."""
        with contextlib.suppress(Refused):
            self.controller.stop()
        self.controller.laser(False)
        self.arm(False)

    def _reconnect(self, problem: Exception) -> None:
        found = self.controller.reconnect(2.0 * (1 + self.config.controller.reconnects))
        if found.status.estop:
            raise RigFault(Fault.EMERGENCY_STOP, found.status.position) from problem
        if not found.same_boot:
            self.position_known = False
            # A reset loses the settings too.
            self._await_rest()
            self.controller.configure(controller_settings(self.config))
        self._note("reconnected", same_boot=found.same_boot)

    def _reopen(self, problem: Exception) -> None:
        """Open the camera again, ever more patiently, and check that its settings are unchanged."""
        tries, last = self.config.checks.camera_reopens, problem
        for attempt in range(tries):
            self._clock.sleep(min(0.25 * 2**attempt, _LONGEST_PAUSE_S) if attempt else 0.0)
            try:
                self.camera.reopen()
                self.camera.start()
                require_same(self.camera, self.features)
            except CameraLost as again:
                last = again
                continue
            self._note("camera", reopened=attempt + 1)
            return
        raise CameraError(f"{self.camera.identity} did not come back in {tries} tries: {last}") from problem

    def _make_ready(self) -> None:
        """Clear a fault, enable the motor, home if necessary, arm."""
        status = self._rested(_TEMPORARY)
        if not (status.enabled and status.homed):
            # If it was stopped during a motion, its counter is not valid.
            self.position_known = False
            self.home("after a fault")
        elif not status.armed and not self._dark:
            self.arm(True)

    def _rested(self, cleared: set[Fault]) -> Status:
        """The state at rest, after one of these faults was cleared. Raises RigFault for others and the e-stop."""
        status = self._await_rest()
        if status.estop:
            raise RigFault(Fault.EMERGENCY_STOP, status.position)
        if status.state == "fault":
            if (status.fault or Fault.UNKNOWN) not in cleared:
                raise RigFault(status.fault or Fault.UNKNOWN, status.position)
            self.controller.clear()
            status = self.controller.stat()
        return status

    def _await_rest(self) -> Status:
        end = self._clock.now() + _STILL_S
        while (status := self.controller.stat()).state not in ("idle", "fault"):
            if self._clock.now() > end:
                raise SessionError(
                    f'the controller is still in the state "{status.state}" after {_STILL_S:g} s; restart it.'
                )
            self._clock.sleep(0.05)
        return status
