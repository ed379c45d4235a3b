"""Motions of one axis with ramps, as GRBL's planner makes them, but that each begins and ends at rest."""

import math
from collections import deque
from dataclasses import dataclass


@dataclass(frozen=True)
class Ramp:
    """A motion from rest to rest: up with an acceleration, on with a speed, down again."""

    begin: float
    end: float
    speed: float
    acceleration: float
    start_s: float

    @property
    def _peak(self) -> float:
        return min(self.speed, math.sqrt(self.acceleration * abs(self.end - self.begin)))

    @property
    def seconds(self) -> float:
        """How long it takes."""
        distance, peak = abs(self.end - self.begin), self._peak
        return 0.0 if distance == 0 else distance / peak + peak / self.acceleration

    def at(self, now: float) -> tuple[float, float]:
        """Position and speed, which has the sign of the motion, at a time."""
        t, total, peak, a = now - self.start_s, self.seconds, self._peak, self.acceleration
        sign = math.copysign(1.0, self.end - self.begin)
        if t >= total:
            return self.end, 0.0
        up = peak / a
        if t < up:
            return self.begin + sign * a * t * t / 2, sign * a * t
        if t > total - up:
            left = total - t
            return self.end - sign * a * left * left / 2, sign * a * left
        return self.begin + sign * (a * up * up / 2 + peak * (t - up)), sign * peak


class Axis:
    """An axis that carries out one motion after the other, and can be held or stopped at once."""

    def __init__(self, place: float = 0.0) -> None:
        self.held = False
        self._queue: deque[tuple[float, float, float]] = deque()
        self._ramp: Ramp | None = None
        self._place = place

    @property
    def queued(self) -> int:
        """Motions that have not begun."""
        return len(self._queue)

    @property
    def target(self) -> float:
        """Position after all motions."""
        if self._queue:
            return self._queue[-1][0]
        return self._place if self._ramp is None else self._ramp.end

    @property
    def busy(self) -> bool:
        """Whether motions are left."""
        return self._ramp is not None or bool(self._queue)

    @property
    def moving(self) -> bool:
        """Whether it turns at this moment."""
        return self._ramp is not None

    def go(self, to: float, speed: float, acceleration: float) -> None:
        """Append a motion."""
        self._queue.append((to, speed, acceleration))

    def hold(self, now: float) -> None:
        """Slow down, and stay."""
        if self.held:
            return
        self.held = True
        if self._ramp is not None:
            place, speed = self._ramp.at(now)
            way = math.copysign(speed * speed / (2 * self._ramp.acceleration), speed)
            self._queue.appendleft((self._ramp.end, self._ramp.speed, self._ramp.acceleration))
            # A ramp whose second half is this slowing down.
            begin = now - abs(speed) / self._ramp.acceleration
            self._ramp = Ramp(place - way, place + way, math.inf, self._ramp.acceleration, begin)

    def resume(self) -> None:
        """Go on after a hold."""
        self.held = False

    def halt(self, now: float) -> None:
        """Stop at once, and clear the queue."""
        self._place = self.at(now)
        self._ramp, self.held = None, False
        self._queue.clear()

    def at(self, now: float) -> float:
        """Its position."""
        return self._place if self._ramp is None else self._ramp.at(now)[0]

    def run(self, now: float) -> None:
        """End a finished motion, and begin the next."""
        if self._ramp is not None and now - self._ramp.start_s >= self._ramp.seconds:
            self._place, self._ramp = self._ramp.end, None
        if self._ramp is None and self._queue and not self.held:
            to, speed, acceleration = self._queue.popleft()
            if to != self._place:
                self._ramp = Ramp(self._place, to, speed, acceleration, now)
