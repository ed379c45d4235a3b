"""The board views of a calibration: the operator places the board, the table turns, pairs are taken."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from scanrig.session.plan import Target, angle_deg, placed_targets, placement_bearing
from scanrig.session.session import Session


PlacementKind = Literal["free", "placement"]


@dataclass(frozen=True)
class PlacementRequest:
    """A request to the operator to place the calibration board."""

    kind: PlacementKind
    """"free": hold it anywhere; "placement": stand it where it will not move while the table turns."""
    number: int
    """Counted from 0 within its kind."""
    total: int
    at_deg: float
    """Where the table points meanwhile."""
    advice: list[str]
    """The most helpful poses, a sentence each."""
    look: Callable[[], np.ndarray]
    """Takes a frame without laser: uint8 [rows, columns] (rgb8: and 3). Recovers from faults as every step does, and
    keeps the contactor open."""


class Operator(Protocol):
    """The person who moves the board."""

    def place(self, request: PlacementRequest) -> bool:
        """Return when the board is placed; False: no more of this kind."""


def take_placements(session: Session, positions: Sequence[tuple[int, ...]], operator: Operator) -> bool:
    """Take the free views at home, then each placement at its positions.

    Every placement gets a new number. A placement that was half done when a session ended is begun again under another
    number; its old records keep the old one.

    Args:
        session: A session that has begun.
        positions: From `placement_positions`.
        operator: The person who places the board.

    Returns:
        False if the operator asked to stop, or ended before any view was taken.
    """
    views, stands = placed_targets(session.config, positions)
    session.start(compare=False)
    kinds: tuple[tuple[PlacementKind, tuple[tuple[Target, ...], ...]], ...] = (("free", views), ("placement", stands))
    for kind, asked in kinds:
        for number, targets in enumerate(asked):
            if all(target.record in session.done for target in targets):
                continue
            if session.should_stop():
                return False
            bearing = 0 if kind == "free" else placement_bearing(session.config, number)
            session.face(bearing)
            session.dark()
            at_deg = angle_deg(bearing, session.config.microsteps_per_turn)
            advice = [] if session.job.hooks.advise is None else list(session.job.hooks.advise())
            placed = operator.place(PlacementRequest(kind, number, len(asked), at_deg, advice, session.rig.look))
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
    # Records of an interrupted placement show the board at another place.
    for target in targets:
        session.done.discard(target.record)
    for target in targets:
        if session.should_stop():
            session.settle()
            return False
        session.take(target.record, target.position, placement=label)
    # Before the board is moved.
    session.settle()
    if len({target.position for target in targets}) > 1:
        session.close_placement(in_place=True)
    return True
