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
from scanrig.controllers import Firmware, shortcomings
from scanrig.errors import FrameError, SessionError
from scanrig.recording import AHEAD, KEPT_PAIRS, Ledger, require_space
from scanrig.session.job import Job, say_event
from scanrig.session.plan import RESERVE, Target, angle_deg, frame_bytes
from scanrig.session.recovery import RecoveringRig
from scanrig.session.resume import Found, ranges, read_pair, require_same_camera
from scanrig.session.steps import Flight, Flights, Pair


def capture_header(job: Job, firmware: Firmware, features: Features) -> CaptureHeader:
    """The header of a new capture, with the settings that must not change when it is resumed."""
    config, kind = job.config, job.kind
    acquisition: dict[str, Any] = {
        "software": f"jaxscan {version('jaxscan')}",
        "started": job.devices.clock.utc(),
        "config_sha256": config.digest(kind),
        "microsteps_per_turn": config.microsteps_per_turn,
        "firmware": firmware.version,
        "protocol": firmware.proto,
        "boot": firmware.boot,
        "camera": asdict(job.devices.camera.identity),
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


def record_fields(
    pair: Pair, proof: PairProof, config: RigConfig, features: Features, moment: dict[str, Any]
) -> dict[str, Any]:
    """The fields of a record, without its images and their digests; `moment`: the fields of its time."""
    n = config.microsteps_per_turn
    fields: dict[str, Any] = {
        "angle_deg": angle_deg(pair.position, n),
        **moment,
        "microsteps": pair.position,
        "microsteps_per_turn": n,
        "exposure_s": features.get("exposure_s", config.camera.exposure_ms / 1000),
        "retakes": len(pair.rejections.reasons),
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
    if pair.rejections.reasons:
        fields["rejected"] = list(pair.rejections.reasons)
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
        self.since_home: list[int] = [] if found is None else list(found.since_home)
        """Records taken since home was last found well."""
        self._unjudged = found is not None and found.unjudged
        """Whether home was found after these records without a valid counter, so that lost steps would not show."""
        self.taken = 0
        self._found = found
        self._last = next(reversed(found.records), None) if found is not None else None
        self._last_placement: int | None = None
        self._positions = {} if found is None else {i: int(r["microsteps"]) for i, r in found.records.items()}
        self._placements = 0 if found is None else found.placements
        self._flights = Flights(self.ledger, self.config)
        self._unproven: list[Flight] = []
        """Steps that were not proven, to which the table must return."""
        self._light = LightWatch()
        self._leaks = tuple(LeakWatch() for _ in self.config.laser)

    def begin(self) -> None:
        """Make the rig ready and open the capture."""
        job, rig = self.job, self.rig
        firmware = rig.prepare()
        if lacking := shortcomings(job.devices.controller.guarantees):
            self._note("guarantees", lacking=list(lacking))
            job.hooks.notify(lacking[0])
        missing = job.planned - len(self.done)
        self._require_space(missing, f"the capture of {missing} more pairs")
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
        self._require_space(KEPT_PAIRS + len(self._flights), "the next pair")
        homings = self.rig.homings
        try:
            pair = self.rig.grab(to, record)
        except FrameError:
            # If the step before fails too, it is the first to say so.
            self._return_to_unproven()
            raise
        came_from, fields = self.rig.came_from, self._fields(placement)
        self._check_homing(homings, placement)
        self._judge()
        self._flights.begin(pair, came_from, placement, fields)
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

    def _require_space(self, pairs: int, purpose: str) -> None:
        require_space(self.job.folder, math.ceil(2 * pairs * frame_bytes(self.config) * RESERVE), purpose=purpose)

    def _fields(self, placement: int | None) -> Callable[[Pair, PairProof], dict[str, Any]]:
        """Makes the fields of a record that was taken now."""
        config, clock, features = self.config, self.job.devices.clock, self.rig.features
        moment = {"time": clock.utc(), "time_s": round(clock.now(), 6)}
        place = {} if placement is None else {"placement": placement}
        return lambda pair, proof: record_fields(pair, proof, config, features, moment) | place

    def _judge(self) -> None:
        """Read the verdict on the last pair."""
        if (judged := self._flights.verdict()) is None:
            return
        flight, proof = judged
        if proof.ok:
            self._watch(flight.pair, flight.placement, proof)
        else:
            self.rig.reject(flight.pair.record, proof.reason)
            self._unproven.append(flight)

    def _return_to_unproven(self) -> None:
        """Take the steps again that were not proven, each until it is, in their order."""
        self._judge()
        while self._unproven:
            flight = self._unproven.pop(0)
            record, to = flight.pair.record, flight.pair.position
            if self.rig.at != to != flight.came_from:
                # From the same side as the first time: gears have backlash.
                self.rig.approach(flight.came_from)
            homings = self.rig.homings
            pair, proof = self.rig.take(to, record, flight.pair.rejections)
            self._check_homing(homings, flight.placement)
            self._flights.begin(pair, flight.came_from, flight.placement, self._fields(flight.placement), proof)
            self._watch(pair, flight.placement, proof)

    def _check_homing(self, homings: int, placement: int | None) -> None:
        """Judge the table's position if it was homed again since the given count of homings."""
        # Another placement of the board looks different whatever the table does.
        if self.rig.homings > homings and placement == self._last_placement:
            self._compare_last()

    def _await_written(self) -> None:
        """Wait until all pairs that are proven are on the disk."""
        self._judge()
        self._collect(0)

    def _collect(self, most: int = AHEAD) -> None:
        """Count and hand out the records that are on the disk by now; wait until at most a given number are not."""
        hooks = self.job.hooks
        for flight in self._flights.landed(most):
            self._count(flight)
            pair = flight.pair
            if hooks.on_pair is not None:
                angle = math.radians(angle_deg(pair.position, self.config.microsteps_per_turn))
                hooks.on_pair(pair.record, angle, pair.on.shown, pair.off.shown)
            if hooks.progress is not None:
                hooks.progress(len(self.done), self.job.planned)

    def _count(self, flight: Flight) -> None:
        record = flight.pair.record
        self.taken += 1
        self.done.add(record)
        self.suspect.discard(record)
        self.since_home.append(record)
        self._last, self._last_placement = record, flight.placement
        self._positions[record] = flight.pair.position

    def _watch(self, pair: Pair, placement: int | None, proof: PairProof) -> None:
        """Follow light and leak from pair to pair.

        Raises:
            FrameError: If the laser shines in the laser-off frames of many places; the contactor is open then.
        """
        ambient, allowed = proof.ambient_dn, self.config.checks.proof.leak
        if (was := self._light.add(ambient)) is not None:
            self._note("light", record=pair.record, was_dn=round(was, 2), is_dn=round(ambient, 2))
        # Boards show another scene in each pair, whatever the table does.
        angle = None if placement is not None else angle_deg(pair.position, self.config.microsteps_per_turn)
        leak = self._leaks[pair.laser].add(angle, proof.leak)
        if leak is None or leak <= allowed:
            return
        self.job.devices.controller.arm(False)
        raise FrameError(
            f"step {pair.record}: the laser stays on: {100 * leak:.0f} % of its line is in the laser-off frames of "
            f"the last {PLACES} places too, expected at most {100 * allowed:.0f} %; give it more time to go out "
            "([[laser]] off_ms), and check relay and wiring. The contactor has been opened."
        )

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
        pair, _ = self.rig.take(self._positions[record], record)
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
