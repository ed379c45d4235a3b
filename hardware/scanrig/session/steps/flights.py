"""Pairs in flight: taken, and proven and written in the background while the table goes on."""

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

from scanrig.checks import PairProof
from scanrig.config import RigConfig
from scanrig.recording import AHEAD, Background, Ledger
from scanrig.session.steps.grab import Step, TakenPair
from scanrig.session.steps.step import Doubt, ProvenPair, prove


class Place(NamedTuple):
    """A step, and how the table came there."""

    step: Step
    came_from: int
    """Where the table stood before it went there [microsteps]."""
    placement: int | None
    """The board's, in a calibration."""


@dataclass(frozen=True, eq=False)
class Flight:
    """A pair in flight."""

    place: Place
    taken: TakenPair
    doubt: Doubt
    """The takes of its step that were rejected."""
    proof: Future[PairProof]
    stored: Future[bool]
    """Whether it was proven; then it is on the disk."""

    @property
    def record(self) -> int:
        """Number of the record."""
        return self.place.step.number


Fields = Callable[[ProvenPair], dict[str, Any]]
"""Makes the fields of a record, beside its images."""


class Flights:
    """The pairs in flight, in the order in which they were taken; at most one has a verdict that was not read yet."""

    def __init__(self, ledger: Ledger, config: RigConfig) -> None:
        """Nothing is in flight, and no thread runs."""
        self._ledger, self._config = ledger, config
        self._background = Background()
        self._flying: deque[Flight] = deque()
        self._last: Flight | None = None

    def __len__(self) -> int:
        """Pairs that may not be on the disk yet."""
        return len(self._flying)

    def begin(self, place: Place, taken: TakenPair, doubt: Doubt, fields: Fields) -> None:
        """Prove a pair, and write it if it is proven, after all that was given before."""
        self._last = self._begin(place, taken, doubt, fields, self._background.prove(self._proof(place, taken)))

    def begin_proven(self, place: Place, pair: ProvenPair, fields: Fields) -> Flight:
        """Write a pair that is proven already."""
        proof: Future[PairProof] = Future()
        proof.set_result(pair.proof)
        return self._begin(place, TakenPair(pair.on, pair.off, pair.position), Doubt(pair.rejected), fields, proof)

    def verdict(self) -> tuple[Flight, PairProof] | None:
        """Wait for the verdict on the last pair; None if it was read already. A rejected take is added to its doubt."""
        flight, self._last = self._last, None
        if flight is None:
            return None
        proof = flight.proof.result()
        return (flight if proof.ok else replace(flight, doubt=flight.doubt.also(proof.reason, proof.verdict))), proof

    def landed(self, most: int = AHEAD) -> Iterator[Flight]:
        """The pairs that are on the disk by now; waits until at most so many are not.

        Raises:
            BaseException: What proving or writing raised.
        """
        while self._flying and (len(self._flying) > most or self._flying[0].stored.done()):
            stored = self._flying[0].stored.result()
            flight = self._flying.popleft()
            if stored:
                yield flight

    def write(self, event: dict[str, Any]) -> None:
        """Write an event, after all that was given before."""
        if self._ledger.begun:
            self._background.write(partial(self._ledger.write, event))
        else:
            self._ledger.write(event)

    def wait(self) -> None:
        """Wait until all is written, events too."""
        self._background.wait()

    def end(self) -> list[Flight]:
        """Finish what is in flight and end the threads, also after an error; returns the pairs that are on the disk."""
        self._background.end()
        landed = [flight for flight in self._flying if flight.stored.exception() is None and flight.stored.result()]
        self._flying.clear()
        return landed

    def _proof(self, place: Place, taken: TakenPair) -> Callable[[], PairProof]:
        return partial(prove, taken, self._config, place.step.laser)

    def _begin(self, place: Place, taken: TakenPair, doubt: Doubt, fields: Fields, proof: Future[PairProof]) -> Flight:
        def store() -> bool:
            found = proof.result()
            if found.ok:
                pair = ProvenPair(taken.on, taken.off, found, taken.position, doubt.reasons, place.step.laser)
                self._ledger.add(place.step.number, taken.on.image, taken.off.image, fields(pair))
            return found.ok

        flight = Flight(place, taken, doubt, proof, self._background.write(store))
        self._flying.append(flight)
        return flight
