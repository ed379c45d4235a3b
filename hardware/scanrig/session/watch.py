"""Judges pairs by others: a change of the room's light, a laser that stays on, a step that is taken again."""

from collections.abc import Callable
from pathlib import Path

from scanrig.checks import PLACES, LeakWatch, LightWatch, Likeness, PairProof, compare_pairs
from scanrig.config import RigConfig
from scanrig.controllers import Controller
from scanrig.errors import FrameError
from scanrig.session.resume import read_pair
from scanrig.session.steps import ProvenPair


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


def compare_with_record(folder: Path, record: int, pair: ProvenPair, config: RigConfig) -> Likeness:
    """Compare a pair with that of a record on the disk, taken at the same place.

    Raises:
        CaptureError: If the record is missing or damaged.
    """
    camera, line = config.camera, config.laser[pair.laser].line
    again = pair.on.image, pair.off.image
    first = read_pair(folder, record)
    return compare_pairs(first, again, pixel_format=camera.pixel_format, response=camera.response, line=line)
