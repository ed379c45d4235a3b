"""A running session: takes records, and tracks which are on the disk and which are suspect."""

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from scanrig.checks import PLACES, LeakWatch, Likeness, compare_pairs
from scanrig.controllers import shortcomings
from scanrig.errors import FrameError, SessionError
from scanrig.recording import KEPT_PAIRS, Ledger, require_space
from scanrig.session.ending import Ending
from scanrig.session.job import Job, SessionResult
from scanrig.session.plan import RESERVE, Target, frame_bytes
from scanrig.session.records import capture_header, record_fields
from scanrig.session.recovery import RecoveringRig
from scanrig.session.resume import Found, ranges, read_pair, require_same_camera
from scanrig.session.sentences import say_end, say_event
from scanrig.session.step import ProvenPair


class Session:
    """A running session: takes records, and tracks which are done and which are suspect."""

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
        self._ambient: float | None = None
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
        """Take one record and write it to the disk."""
        job = self.job
        room = math.ceil(KEPT_PAIRS * 2 * frame_bytes(self.config) * RESERVE)
        require_space(job.folder, room, purpose="the next pair")
        homings = self.rig.homings
        pair = self.rig.take(to, record)
        # Another placement of the board looks different whatever the table does.
        if self.rig.homings > homings and placement == self._last_placement:
            self._compare_last()
        fields = record_fields(pair, self.config, self.rig.features, job.devices.clock)
        if placement is not None:
            fields["placement"] = placement
        self.ledger.add(record, pair.on.image, pair.off.image, fields)
        self.taken += 1
        self.done.add(record)
        self.suspect.discard(record)
        self.since_home.append(record)
        self._last, self._last_placement, self._positions[record] = record, placement, pair.position
        self._watch_light(record, pair)
        self._watch_laser(record, pair, None if placement is not None else fields["angle_deg"])
        if job.hooks.on_pair is not None:
            job.hooks.on_pair(record, math.radians(fields["angle_deg"]), pair.on.image, pair.off.image)
        if job.hooks.progress is not None:
            job.hooks.progress(len(self.done), job.planned)

    def unclosed(self, turn: Sequence[Target]) -> bool:
        """Whether records of a pass were taken since home was last found well."""
        return not {target.record for target in turn}.isdisjoint(self.since_home)

    def close_turn(self, turn: Sequence[Target]) -> None:
        """Take the first step of a pass again, compare it, and search for home."""
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

    def _note(self, name: str, **fields: Any) -> None:
        self.ledger.note(name, **fields)
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

    def _watch_laser(self, record: int, pair: ProvenPair, angle_deg: float | None) -> None:
        """Stop if the laser shines in the laser-off frames of many places."""
        leak, allowed = self._leaks[pair.laser].add(angle_deg, pair.proof.leak), self.config.checks.proof.leak
        if leak is None or leak <= allowed:
            return
        self.job.devices.controller.arm(False)
        raise FrameError(
            f"step {record}: the laser stays on: {100 * leak:.0f} % of its line is in the laser-off frames of "
            f"the last {PLACES} places too, expected at most {100 * allowed:.0f} %; give it more time to go out "
            "([[laser]] off_ms), and check relay and wiring. The contactor has been opened."
        )

    def _watch_light(self, record: int, pair: ProvenPair) -> None:
        """Report a change of the room's light by a factor of two."""
        ambient = pair.proof.ambient_dn
        if self._ambient is None:
            self._ambient = ambient
        elif not 0.5 < (ambient + 2) / (self._ambient + 2) < 2:
            self._note("light", record=record, was_dn=round(self._ambient, 2), is_dn=round(ambient, 2))
            self.job.hooks.notify(f"record {record}: the light changed from {self._ambient:.0f} to {ambient:.0f} DN.")
            self._ambient = ambient
