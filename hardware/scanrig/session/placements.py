"""A calibration's views of the board: somebody places it, the table turns, pairs are taken."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from scanrig.session.session import Session


@dataclass(frozen=True)
class PlacementRequest:
    """What the operator is asked to do with the calibration board."""

    kind: Literal["free", "placement"]
    """"free": hold it anywhere; "placement": stand it where it will not move while the table turns."""
    number: int
    """Counted from 0 within its kind."""
    total: int
    advice: list[str]
    """What would help most, a sentence each."""
    look: Callable[[], np.ndarray]
    """What the camera sees now, without laser: uint8 [rows, columns] (rgb8: and 3). Comes back from what the rig
    recovers from, as every step does, and keeps the contactor open."""


class Operator(Protocol):
    """Who moves the board."""

    def place(self, request: PlacementRequest) -> bool:
        """Return when the board is placed; False: enough of this kind."""


def take_placements(session: Session, positions: Sequence[int], operator: Operator) -> bool:
    """Free views from home, then placements from all positions.

    Every placing of the board gets a number of its own: one that was half done when a session ended
    is begun anew under another, and its old records stay true of the old one.

    Args:
        session: Begun.
        positions: Where the table stops for each placement [microsteps].
        operator: Places the board.

    Returns:
        False where the operator asked to stop, or had enough before there was anything.
    """
    plan = session.config.calibration
    views = [((view,), (0,)) for view in range(plan.free_views)]
    count = len(positions)
    stands = [
        (tuple(range(plan.free_views + p * count, plan.free_views + (p + 1) * count)), tuple(positions))
        for p in range(plan.placements)
    ]
    session.start(compare=False)
    for kind, asked in (("free", views), ("placement", stands)):
        for number, (records, places) in enumerate(asked):
            if all(record in session.done for record in records):
                continue
            if session.should_stop():
                return False
            session.dark()
            advice = [] if session.job.hooks.advise is None else list(session.job.hooks.advise())
            placed = operator.place(PlacementRequest(_kind(kind), number, len(asked), advice, session.rig.look))
            if session.should_stop():
                return False
            if not placed:
                break
            session.light()
            if not _take_placement(session, records, places):
                return False
    if session.since_home:
        session.close_placement(in_place=False)
    return bool(session.done or session.suspect)


def _take_placement(session: Session, records: Sequence[int], places: Sequence[int]) -> bool:
    label = session.next_placement()
    # What is left of the last time was seen from another place.
    for record in records:
        session.done.discard(record)
    for record, to in zip(records, places, strict=True):
        if session.should_stop():
            return False
        session.take(record, to, placement=label)
    if len(records) > 1:
        session.close_placement(in_place=True)
    return True


def _kind(kind: str) -> Literal["free", "placement"]:
    return "free" if kind == "free" else "placement"
