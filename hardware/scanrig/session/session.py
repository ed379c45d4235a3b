"""Takes records, and tracks which are suspect: pairs are judged by others, steps are taken again."""

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict
from importlib.metadata import version
from typing import Any

from jaxscan.files.capture import CaptureHeader, PlanTable, TurntableTable
from scanrig.cameras import Features, require_same
from scanrig.checks import PLACES, LeakWatch, LightWatch, Likeness, PairProof, compare_pairs
from scanrig.config import RigConfig
from scanrig.controllers import Controller, Firmware, shortcomings
from scanrig.errors import FrameError, SessionError
from scanrig.recording import AHEAD, KEPT_PAIRS, Ledger, require_space
from scanrig.session.job import Job, say_event
from scanrig.session.plan import RESERVE, Target, angle_deg, frame_bytes
from scanrig.session.recovery import RecoveringRig
from scanrig.session.resume import Found, ranges, read_pair, require_same_camera
from scanrig.session.steps import Flight, Flights, Place, ProvenPair, Step


class PairWatch:
    """Follows the proofs of a session's pairs."""

    def __init__(self, config: RigConfig, controller: Controller, note: Callable[..., None]) -> None:
        """`note` gets changes of the light."""
        self._allowed, self._controller, self._note = config.checks.proof.leak, controller, note
        self._light = LightWatch()
        self._leaks = tuple(LeakWatch() for _ in config.laser)

    def add(self, record: int, laser: int, angle_deg: float | None, proof: PairProof) -> None:
        """Add a pair; `angle_deg`: the table's angle, None if every pair shows another scene.

        Raises:
            FrameError: If the laser shines in the laser-off frames of many places; the contactor is open then.
        """
        ambient = proof.ambient_dn
        if (was := self._light.add(ambient)) is not None:
            self._note("light", record=record, was_dn=round(was, 2), is_dn=round(ambient, 2))
        leak = self._leaks[laser].add(angle_deg, proof.leak)
        if leak is None or leak <= self._allowed:
            return
        self._controller.arm(False)
        raise FrameError(
            f"step {record}: the laser stays on: {100 * leak:.0f} % of its line is in the laser-off frames of "
            f"the last {PLACES} places too, expected at most {100 * self._allowed:.0f} %; give it more time to go out "
            "([[laser]] off_ms), and check relay and wiring. The contactor has been opened."
        )


def capture_header(job: Job, firmware: Firmware, features: Features) -> CaptureHeader:
    """The header of a new capture, with the settings that must not change when it is resumed."""
    config, kind, identity = job.config, job.kind, job.devices.camera.identity
    acquisition: dict[str, Any] = {
        "software": f"jaxscan {version('jaxscan')}",
        "started": job.devices.clock.utc(),
        "config_sha256": config.digest(kind),
        "microsteps_per_turn": config.microsteps_per_turn,
        "firmware": firmware.version,
        "protocol": firmware.proto,
        "boot": firmware.boot,
        "camera": asdict(identity),
        "features": dict(features),
        "config": config.frame_tables(kind),
    }
    if job.calibration_digest is not None:
        acquisition["calibration"] = job.calibration_digest
    return CaptureHeader(
        kind=kind,
        camera=config.camera.table,
        turntable=TurntableTable(carries=config.turntable.carries, angle_sigma_deg=config.turntable.angle_sigma_deg),
        laser=tuple(laser.table for laser in config.laser),
        board=config.board if kind == "calibration" else None,
        plan=PlanTable(steps=job.planned),
        acquisition=acquisition,
    )


def record_fields(pair: ProvenPair, config: RigConfig, features: Features, moment: dict[str, Any]) -> dict[str, Any]:
    """The fields of a record, without its images and their digests; `moment`: the fields of its time."""
    n, proof = config.microsteps_per_turn, pair.proof
    exposure = features.get("exposure_s", config.camera.exposure_ms / 1000)
    fields: dict[str, Any] = {
        "angle_deg": angle_deg(pair.position, n),
        **moment,
        "microsteps": pair.position,
        "microsteps_per_turn": n,
        "exposure_s": exposure,
        "retakes": len(pair.rejected),
        "frame_ids": [pair.on.number, pair.off.number],
        "statistics": {
            "lit_lines": round(proof.lit_lines, 4),
            "peak_dn": round(proof.peak_dn, 2),
            "saturated": round(proof.saturated, 4),
            "ambient_dn": round(proof.ambient_dn, 3),
            "unrest": round(proof.unrest, 3),
        },
    }
    if len(config.laser) > 1:
        fields["lasers"] = [config.laser[pair.laser].name]
    if pair.rejected:
        fields["rejected"] = list(pair.rejected)
    return fields


class Session:
    """A running session: takes records, and tracks which are done and which are suspect.

    While the table turns to a step, the one before is proven and written in the background; everything else happens
    in the caller's thread.
    """

    def __init__(self, job: Job, found: Found | None) -> None:
        """Nothing moves yet; `found` is the capture that an earlier session left."""
        self.job, self.config = job, job.config
        self.ledger = Ledger(job.folder, job.devices.clock)
        self.rig = RecoveringRig(job.config, job.devices, self._note)
        self.done: set[int] = set() if found is None else set(found.records)
        """Records that are on the disk and not suspect."""
        self.suspect: set[int] = set()
        """Records of this session that are suspect."""
        self.since_home: list[int] = [] if found is None else list(found.since_home)
        """Records taken since home was last found well."""
        self._unjudged = found is not None and found.unjudged
        """Whether home was found after these records without a valid counter, so that lost steps would not show."""
        self.taken = 0
        self._found = found
        self._last = found.order[-1] if found is not None and found.order else None
        self._last_placement: int | None = None
        self._positions = {} if found is None else {i: int(r["microsteps"]) for i, r in found.records.items()}
        self._placements = 0 if found is None else found.placements
        self._flights = Flights(self.ledger, self.config)
        self._unproven: list[Flight] = []
        """Steps that were not proven, to which the table must return."""
        self._watch = PairWatch(self.config, job.devices.controller, self._note)

    def begin(self) -> None:
        """Make the rig ready and open the capture."""
        job, rig = self.job, self.rig
        firmware = rig.prepare()
        if lacking := shortcomings(job.devices.controller.guarantees):
            self._note("guarantees", lacking=list(lacking))
            job.hooks.notify(lacking[0])
        missing = job.planned - len(self.done)
        needed = math.ceil(2 * missing * frame_bytes(self.config) * RESERVE)
        require_space(job.folder, needed, purpose=f"the capture of {missing} more pairs")
        identity = job.devices.camera.identity
        if self._found is None:
            self.ledger.create(capture_header(job, firmware, rig.features))
        else:
            require_same_camera(self._found, asdict(identity), folder=job.folder)
            require_same(job.devices.camera, self._found.header.acquisition.get("features", {}))
            self.ledger.resume()
            for problem in self._found.damaged:
                self._note("damaged", record=problem.record, problem=problem.message)
                job.hooks.notify(f"{problem}; it is taken again.")
        self._note("start", firmware=firmware.version, boot=firmware.boot, missing=missing, camera=str(identity))

    def start(self, *, compare: bool = True) -> None:
        """Home the table, and take the last record again to check that nothing moved.

        Raises:
            SessionError: If the last record, taken again, looks different.
        """
        self.rig.doing(lambda: self.rig.home("start"), "homing")
        if not compare or self._last is None or self._last not in self.done:
            return
        likeness = self._again(self._last, "compared")
        if not self._is_like(likeness):
            checks = self.config.checks
            raise SessionError(
                f"{self.job.folder}: record {self._last}, taken again, has changed: {likeness}; expected at "
                f"most {checks.shift_px:g} px and at least {checks.correlation:g}. The rig or the room changed, or "
                "steps were lost before. Begin a new capture, or allow more in [checks] shift_px and correlation."
            )
        self._clear_suspicion()

    def take(self, record: int, to: int, *, placement: int | None = None) -> None:
        """Take one record. It is proven and written while the table goes on.

        The verdict on the record before is read here: if that one was not proven, the table goes back and takes it
        again until it is. Call `settle` after the last record.
        """
        self._collect()
        room = math.ceil((KEPT_PAIRS + len(self._flights)) * 2 * frame_bytes(self.config) * RESERVE)
        require_space(self.job.folder, room, purpose="the next pair")
        homings = self.rig.homings
        try:
            taken, rejections = self.rig.grab(to, record)
        except FrameError:
            # If the step before fails too, it is the first to say so.
            self._return_to_unproven()
            raise
        place = Place(Step(to, record, self.config.laser_of(record)), self.rig.came_from, placement)
        fields = self._fields(placement)
        self._check_homing(homings, placement)
        self._judge()
        self._flights.begin(place, taken, rejections, fields)
        if self._unproven:
            self._return_to_unproven()

    def settle(self) -> None:
        """Return to the steps that were not proven, and wait until all records are on the disk."""
        self._return_to_unproven()
        self._collect(0)

    def end(self) -> None:
        """Finish what is done in the background, also after an error."""
        for flight in self._flights.end():
            self._count(flight)

    def unclosed(self, turn: Sequence[Target]) -> bool:
        """Whether records of a pass were taken since home was last found well."""
        return not {target.record for target in turn}.isdisjoint(self.since_home)

    def close_turn(self, turn: Sequence[Target]) -> None:
        """Take the first step of a pass again, compare it, and search for home."""
        self.settle()
        first = turn[0].record
        if first in self.done:
            likeness = self._again(first, "closing")
            if not self._is_like(likeness):
                self.job.hooks.notify(f"The first step of the pass, taken again, has changed: {likeness}.")
        self.find_home("end of a pass", in_place=True)

    def find_home(self, why: str, *, in_place: bool) -> None:
        """Search for home; `in_place`: the board, if there is one, has not moved since the last record."""
        self.rig.doing(lambda: self.rig.home(why), "homing")
        if self._unjudged:
            (self._compare_last if in_place else self._clear_suspicion)()

    def next_placement(self) -> int:
        """A new number for a placement of the board."""
        number = self._placements
        self._placements += 1
        self._note("placed", placement=number)
        return number

    def _fields(self, placement: int | None) -> Callable[[ProvenPair], dict[str, Any]]:
        """Makes the fields of a record that was taken now."""
        config, clock, features = self.config, self.job.devices.clock, self.rig.features
        moment = {"time": clock.utc(), "time_s": round(clock.now(), 6)}
        place = {} if placement is None else {"placement": placement}
        return lambda pair: record_fields(pair, config, features, moment) | place

    def _judge(self) -> None:
        """Read the verdict on the last pair."""
        if (judged := self._flights.verdict()) is None:
            return
        flight, proof = judged
        if proof.ok:
            self._add_to_watch(flight, proof)
        else:
            self.rig.reject(flight.record, proof.reason)
            self._unproven.append(flight)

    def _return_to_unproven(self) -> None:
        """Take the steps again that were not proven, each until it is, in their order."""
        self._judge()
        while self._unproven:
            flight = self._unproven.pop(0)
            place = flight.place
            if self.rig.at != place.step.to != place.came_from:
                # From the same side as the first time: gears have backlash.
                self.rig.approach(place.came_from)
            homings = self.rig.homings
            pair = self.rig.take(place.step.to, flight.record, flight.rejections)
            self._check_homing(homings, place.placement)
            written = self._flights.begin_proven(place, pair, self._fields(place.placement))
            self._add_to_watch(written, pair.proof)

    def _check_homing(self, homings: int, placement: int | None) -> None:
        """Judge the table's position if it was homed again since there were so many homings."""
        # Another placement of the board looks different whatever the table does.
        if self.rig.homings > homings and placement == self._last_placement:
            self._compare_last()

    def _await_written(self) -> None:
        """Wait until all pairs that are proven are on the disk."""
        self._judge()
        self._collect(0)

    def _collect(self, most: int = AHEAD) -> None:
        """Count and hand out the records that are on the disk by now; wait until at most so many are not."""
        hooks = self.job.hooks
        for flight in self._flights.landed(most):
            self._count(flight)
            if hooks.on_pair is not None:
                angle = math.radians(angle_deg(flight.taken.position, self.config.microsteps_per_turn))
                hooks.on_pair(flight.record, angle, flight.taken.on.shown, flight.taken.off.shown)
            if hooks.progress is not None:
                hooks.progress(len(self.done), self.job.planned)

    def _count(self, flight: Flight) -> None:
        record = flight.record
        self.taken += 1
        self.done.add(record)
        self.suspect.discard(record)
        self.since_home.append(record)
        self._last, self._last_placement = record, flight.place.placement
        self._positions[record] = flight.taken.position

    def _add_to_watch(self, flight: Flight, proof: PairProof) -> None:
        # Boards show another scene in each pair, whatever the table does.
        on_board = flight.place.placement is not None
        angle = None if on_board else angle_deg(flight.taken.position, self.config.microsteps_per_turn)
        self._watch.add(flight.record, flight.place.step.laser, angle, proof)

    def _note(self, name: str, **fields: Any) -> None:
        if name == "home":
            # In the journal, too, a homing judges the records that were taken before it.
            self._await_written()
        self._flights.write(self.ledger.event(name, **fields))
        if name == "home":
            # Judged at once: a homing that is repeated for another reason always finds home well.
            self._judge_home(fields.get("missed"))
        if sentence := say_event(name, fields):
            self.job.hooks.notify(sentence)

    def _judge_home(self, missed: int | None) -> None:
        """Judge a homing: if home was missed, the records since it was last found well are suspect."""
        if missed is None:
            self._unjudged = bool(self.since_home)
        elif abs(missed) > self.config.checks.lost_steps_tolerance:
            self._mark_suspect(f"home was missed by {missed} microsteps", missed=missed)
        elif not self._unjudged:
            self._clear_suspicion()

    def _compare_last(self) -> None:
        """Judge the table's position by taking the last record again, after a homing without a valid counter."""
        if self._last is None or self._last not in self.done:
            return
        likeness = self._again(self._last, "compared")
        if self._is_like(likeness):
            self._clear_suspicion()
        else:
            self._mark_suspect(f"after a fault, record {self._last} looks different: {likeness}")

    def _clear_suspicion(self) -> None:
        self.since_home.clear()
        self._unjudged = False

    def _mark_suspect(self, why: str, **fields: Any) -> None:
        records = sorted(set(self.since_home))
        self._clear_suspicion()
        if records:
            self._note("suspect", records=[list(run) for run in ranges(records)], why=why, **fields)
            self.suspect.update(records)
            self.done.difference_update(records)

    def _again(self, record: int, event: str) -> Likeness:
        self._await_written()
        pair = self.rig.take(self._positions[record], record)
        self._flights.wait()
        likeness = compare_pairs(
            read_pair(self.job.folder, record),
            (pair.on.shown, pair.off.shown),
            pixel_format=self.config.camera.layout,
            response=self.config.camera.response,
            line=self.config.laser[pair.laser].line,
        )
        self._note(event, record=record, **likeness.fields(), good=self._is_like(likeness))
        return likeness

    def _is_like(self, likeness: Likeness) -> bool:
        return likeness.within(self.config.checks.shift_px, self.config.checks.correlation)
