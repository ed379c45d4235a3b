"""A calibration's views of the board: somebody places it, the table turns, pairs are taken."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from scanrig.session.plan import Target, placed_targets
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
    views, stands = placed_targets(session.config, positions)
    session.start(compare=False)
    for kind, asked in (("free", views), ("placement", stands)):
        for number, targets in enumerate(asked):
            if all(target.record in session.done for target in targets):
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
            if not _take_placement(session, targets):
                return False
    if session.since_home:
        session.close_placement(in_place=False)
    return bool(session.done or session.suspect)


def _take_placement(session: Session, targets: Sequence[Target]) -> bool:
    label = session.next_placement()
    # What is left of the last time was seen from another place.
    for target in targets:
        session.done.discard(target.record)
    for target in targets:
        if session.should_stop():
            return False
        session.take(target.record, target.position, placement=label)
    if len({target.position for target in targets}) > 1:
        session.close_placement(in_place=True)
    return True


def _kind(kind: str) -> Literal["free", "placement"]:
    return "free" if kind == "free" else "placement"
