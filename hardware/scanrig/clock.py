"""Time, behind a name, so that tests of waiting need not wait."""

import time
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Protocol


class Clock(Protocol):
    """What the acquisition layer knows of time."""

    def now(self) -> float:
        """Monotonic seconds; only differences mean anything."""
        ...

    def utc(self) -> str:
        """The time of day, RFC 3339 in UTC, to the microsecond."""
        ...

    def sleep(self, s: float) -> None:
        """Wait for s seconds."""
        ...


@dataclass(frozen=True)
class SystemClock:
    """The computer's own time."""

    def now(self) -> float:
        """Monotonic seconds."""
        return time.monotonic()

    def utc(self) -> str:
        """The time of day, RFC 3339 in UTC."""
        return rfc3339(datetime.now(UTC))

    def sleep(self, s: float) -> None:
        """Wait for s seconds."""
        time.sleep(s)


@dataclass
class ManualClock:
    """A clock that moves only when it is told to, or slept on. For tests."""

    time_s: float = 0.0
    start: datetime = datetime(2000, 1, 1, tzinfo=UTC)

    def now(self) -> float:
        """Seconds since the clock was made."""
        return self.time_s

    def utc(self) -> str:
        """`start` and the seconds since."""
        return rfc3339(self.start + timedelta(seconds=self.time_s))

    def sleep(self, s: float) -> None:
        """Move the clock on by s seconds, at once."""
        self.time_s += max(s, 0.0)


def rfc3339(moment: datetime) -> str:
    """A moment in UTC as RFC 3339 has it, with six decimals and a Z."""
    return moment.strftime("%Y-%m-%dT%H:%M:%S.%fZ")
