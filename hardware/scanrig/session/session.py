"""A running session: takes records, and tracks which are on the disk and which are suspect."""

import math
from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

from scanrig.checks import PLACES, LeakWatch, LightWatch, Likeness, PairProof, compare_pairs
from scanrig.controllers import shortcomings
from scanrig.errors import FrameError, SessionError
from scanrig.recording import AHEAD, KEPT_PAIRS, Background, Ledger, require_space
from scanrig.session.ending import Ending
from scanrig.session.grab import TakenPair
from scanrig.session.job import Job, SessionResult
from scanrig.session.plan import RESERVE, Target, angle_deg, frame_bytes
from scanrig.session.records import Moment, capture_header, record_fields
from scanrig.session.recovery import RecoveringRig
from scanrig.session.resume import Found, ranges, read_pair, require_same_camera
from scanrig.session.sentences import say_end, say_event
from scanrig.session.step import Doubt, ProvenPair, prove


@dataclass(frozen=True, eq=False)
class _Flight:
    """A pair that was taken, and that is proven and written in the background."""

    record: int
    to: int
    """Its position [microsteps]."""
    came_from: int
    """Where the table stood before it went there [microsteps]."""
    placement: int | None
    taken: TakenPair
    doubt: Doubt
    """Its takes that were rejected."""
    proof: Future[PairProof]
    stored: Future[bool]
    """Whether it was proven; then it is on the disk."""


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
        self._background = Background()
        self._flying: deque[_Flight] = deque()
        """Pairs that may not be on the disk yet."""
        self._unjudged_pair: _Flight | None = None
        """The last one, whose verdict was not read yet."""
        self._doubtful: list[_Flight] = []
        """Steps that were not proven, to which the table must return."""
        self._light = LightWatch()
        self._leaks = tuple(LeakWatch() for _ in self.config.laser)

    def should_stop(self) -> bool:
        """Whether the operator asked to stop."""
        return self.job.hooks.should_stop()

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
            rig.require_features(self._found.header.acquisition.get("features", {}))
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
        self._believe()

    def take(self, record: int, to: int, *, placement: int | None = None) -> None:
        """Take one record. It is proven and written while the table goes on.

        The verdict on the record before is read here: if that one was not proven, the table goes back and takes it
        again until it is. Call `settle` after the last record.
        """
        self._collect(AHEAD)
        pairs = KEPT_PAIRS + len(self._flying)
        require_space(
            self.job.folder, math.ceil(pairs * 2 * frame_bytes(self.config) * RESERVE), purpose="the next pair"
        )
        homings = self.rig.homings
        taken, doubt = self.rig.grab(to, record)
        # Another placement of the board looks different whatever the table does.
        if self.rig.homings > homings and placement == self._last_placement:
            self._compare_last()
        self._judge_pair()
        laser = self.config.laser_of(record)
        proof = self._background.prove(partial(prove, taken, self.config, laser))
        self._unjudged_pair = self._write(record, placement, taken, doubt, proof)
        if self._doubtful:
            self._return_to_doubtful()

    def settle(self) -> None:
        """Return to the steps that were not proven, and wait until all records are on the disk."""
        self._await_written()
        while self._doubtful:
            self._return_to_doubtful()
            self._await_written()

    def end(self, *, drop: bool) -> None:
        """End the work in the background, in any case; with `drop` only what was begun is finished."""
        self._background.end(drop=drop)
        for flight in self._flying:
            if not flight.stored.cancelled() and flight.stored.exception() is None and flight.stored.result():
                self._count(flight)
        self._flying.clear()

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
        self._find_home("end of a pass", in_place=True)

    def close_placement(self, *, in_place: bool) -> None:
        """Search for home after a placement of the board; `in_place`: the board has not moved since the last record."""
        self._find_home("end of a placement", in_place=in_place)

    def dark(self) -> None:
        """Open the contactor while somebody moves the board."""
        self.rig.dark()

    def light(self) -> None:
        """Close the contactor again when the operator is ready."""
        self.rig.light()

    def next_placement(self) -> int:
        """A new number for a placement of the board."""
        number = self._placements
        self._placements += 1
        self._note("placed", placement=number)
        return number

    def result(self, ending: Ending, unsafe: str) -> SessionResult:
        """The result of the session."""
        job, count = self.job, len(self.done)
        suspect = tuple(ranges(tuple(self.suspect)))
        says = say_end(ending, job.folder, count=count, planned=job.planned, suspect=suspect)
        return SessionResult(
            status=ending.status,  # type: ignore[arg-type]
            message=" ".join(part for part in (says, unsafe) if part),
            records=count + len(self.suspect - self.done),
            planned=job.planned,
            taken=self.taken,
            retakes=self.rig.rejected,
            suspect=suspect,
            events=tuple(self.ledger.events),
            laser_off=not unsafe,
        )

    def _write(
        self, record: int, placement: int | None, taken: TakenPair, doubt: Doubt, proof: Future[PairProof]
    ) -> _Flight:
        """Write a pair in the background when it is proven, after all before it."""
        clock, laser, features = self.job.devices.clock, self.config.laser_of(record), self.rig.features
        moment = Moment(clock.utc(), clock.now())

        def store() -> bool:
            found = proof.result()
            if found.ok:
                pair = ProvenPair(taken.on, taken.off, found, taken.position, doubt.reasons, laser)
                fields = record_fields(pair, self.config, features, moment)
                if placement is not None:
                    fields["placement"] = placement
                self.ledger.add(record, taken.on.image, taken.off.image, fields)
            return found.ok

        to, came_from = self.rig.at, self.rig.came_from
        flight = _Flight(record, to, came_from, placement, taken, doubt, proof, self._background.write(store))
        self._flying.append(flight)
        return flight

    def _judge_pair(self) -> None:
        """Read the verdict on the last pair."""
        flight, self._unjudged_pair = self._unjudged_pair, None
        if flight is None:
            return
        proof = flight.proof.result()
        if proof.ok:
            self._watch(flight, proof)
        else:
            self.rig.reject(flight.record, proof.reason)
            self._doubtful.append(replace(flight, doubt=flight.doubt.also(proof.reason, proof.verdict)))

    def _return_to_doubtful(self) -> None:
        """Take the steps again that were not proven, each until it is, in their order."""
        self._judge_pair()
        while self._doubtful:
            step = self._doubtful.pop(0)
            if step.came_from != step.to:
                # From the same side as the first time: gears have backlash.
                self.rig.approach(step.came_from)
            homings = self.rig.homings
            pair = self.rig.take(step.to, step.record, step.doubt)
            if self.rig.homings > homings and step.placement == self._last_placement:
                self._compare_last()
            proof: Future[PairProof] = Future()
            proof.set_result(pair.proof)
            taken = TakenPair(pair.on, pair.off, pair.position)
            flight = self._write(step.record, step.placement, taken, Doubt(pair.rejected), proof)
            self._watch(flight, pair.proof)

    def _await_written(self) -> None:
        """Read the verdict on the last pair, and wait until all that are proven are on the disk."""
        self._judge_pair()
        self._collect(0)

    def _collect(self, most: int) -> None:
        """Count the records that are on the disk by now, and wait until at most so many are not."""
        while self._flying and (len(self._flying) > most or self._flying[0].stored.done()):
            stored = self._flying[0].stored.result()
            flight = self._flying.popleft()
            if stored:
                self._count(flight)
                self._tell(flight)

    def _count(self, flight: _Flight) -> None:
        record = flight.record
        self.taken += 1
        self.done.add(record)
        self.suspect.discard(record)
        self.since_home.append(record)
        self._last, self._last_placement = record, flight.placement
        self._positions[record] = flight.taken.position

    def _tell(self, flight: _Flight) -> None:
        hooks, taken = self.job.hooks, flight.taken
        if hooks.on_pair is not None:
            angle = math.radians(self._angle_deg(flight))
            hooks.on_pair(flight.record, angle, taken.on.image, taken.off.image)
        if hooks.progress is not None:
            hooks.progress(len(self.done), self.job.planned)

    def _angle_deg(self, flight: _Flight) -> float:
        return angle_deg(flight.taken.position, self.config.microsteps_per_turn)

    def _note(self, name: str, **fields: Any) -> None:
        if name == "home":
            # In the journal, too, a homing judges the records that were taken before it.
            self._await_written()
        event = self.ledger.event(name, **fields)
        if self.ledger.begun:
            self._background.write(partial(self.ledger.write, event))
        else:
            self.ledger.write(event)
        if name == "home":
            # Judged at once: a homing that is repeated for another reason always finds home well.
            self._judge_home(fields.get("missed"))
        if sentence := say_event(name, fields):
            self.job.hooks.notify(sentence)

    def _find_home(self, why: str, *, in_place: bool) -> None:
        self.rig.doing(lambda: self.rig.home(why), "homing")
        if self._unjudged:
            if in_place:
                self._compare_last()
            else:
                self._believe()

    def _judge_home(self, missed: int | None) -> None:
        """Judge a homing: if home was missed, the records since it was last found well are suspect."""
        if missed is None:
            self._unjudged = bool(self.since_home)
        elif abs(missed) > self.rig.tolerance:
            self._doubt(f"home was missed by {missed} microsteps", missed=missed)
        elif not self._unjudged:
            self._believe()

    def _compare_last(self) -> None:
        """Judge the table's position by taking the last record again, after a homing without a valid counter."""
        if self._last is None or self._last not in self.done:
            return
        likeness = self._again(self._last, "compared")
        if self._is_like(likeness):
            self._believe()
        else:
            self._doubt(f"after a fault, record {self._last} looks different: {likeness}")

    def _believe(self) -> None:
        self.since_home.clear()
        self._unjudged = False

    def _doubt(self, why: str, **fields: Any) -> None:
        records = sorted(set(self.since_home))
        self._believe()
        if records:
            self._note("suspect", records=[list(run) for run in ranges(records)], why=why, **fields)
            self.suspect.update(records)
            self.done.difference_update(records)

    def _again(self, record: int, event: str) -> Likeness:
        """Take a record again only to compare it."""
        self._await_written()
        pair = self.rig.take(self._positions[record], record)
        likeness = self._compare(record, pair)
        shift = {} if likeness.shift_px is None else {"shift_px": round(likeness.shift_px, 3)}
        seen = {} if likeness.correlation is None else {"correlation": round(likeness.correlation, 4)}
        self._note(event, record=record, **shift, **seen, good=self._is_like(likeness))
        if likeness.correlation is None:
            self.job.hooks.notify(
                f"record {record}, taken again, was compared by the laser's line alone: the laser-off frames have too "
                "little contrast. With more light in the room, lost steps are found more surely."
            )
        return likeness

    def _compare(self, record: int, pair: ProvenPair) -> Likeness:
        self._background.wait()
        first = read_pair(self.job.folder, record)
        camera = self.config.camera
        return compare_pairs(
            first,
            (pair.on.image, pair.off.image),
            pixel_format=camera.pixel_format,
            response=camera.response,
            line=self.config.laser[pair.laser].line,
        )

    def _is_like(self, likeness: Likeness) -> bool:
        return likeness.within(self.config.checks.shift_px, self.config.checks.correlation)

    def _watch(self, flight: _Flight, proof: PairProof) -> None:
        """Report a change of the room's light; stop if the laser shines in the laser-off frames of many places."""
        record, ambient = flight.record, proof.ambient_dn
        if (was := self._light.add(ambient)) is not None:
            self._note("light", record=record, was_dn=round(was, 2), is_dn=round(ambient, 2))
            self.job.hooks.notify(f"record {record}: the light changed from {was:.0f} to {ambient:.0f} DN.")
        angle = None if flight.placement is not None else self._angle_deg(flight)
        leak, allowed = self._leaks[self.config.laser_of(record)].add(angle, proof.leak), self.config.checks.proof.leak
        if leak is None or leak <= allowed:
            return
        self.job.devices.controller.arm(False)
        raise FrameError(
            f"step {record}: the laser stays on: {100 * leak:.0f} % of its line is in the laser-off frames of "
            f"the last {PLACES} places too, expected at most {100 * allowed:.0f} %; give it more time to go out "
            "([[laser]] off_ms), and check relay and wiring. The contactor has been opened."
        )
