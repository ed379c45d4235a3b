"""Clocks, replaceable so that tests of waiting need not wait."""

import time
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Protocol


class Clock(Protocol):
    """The time source of the acquisition layer."""

    def now(self) -> float:
        """Monotonic seconds; only differences are meaningful."""
        ...

    def utc(self) -> str:
        """The time of day, RFC 3339 in UTC, to the microsecond."""
        ...

    def sleep(self, s: float) -> None:
        """Wait for s seconds."""
        ...


@dataclass(frozen=True)
class SystemClock:
    """The computer's clock."""

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
    """A clock that moves only when `sleep` is called or `time_s` is set. For tests."""

    time_s: float = 0.0
    start: datetime = datetime(2000, 1, 1, tzinfo=UTC)

    def now(self) -> float:
        """Seconds since the clock was made."""
        return self.time_s

    def utc(self) -> str:
        """`start` plus the seconds since."""
        return rfc3339(self.start + timedelta(seconds=self.time_s))

    def sleep(self, s: float) -> None:
        """Move the clock on by s seconds, at once."""
        self.time_s += max(s, 0.0)


def rfc3339(moment: datetime) -> str:
    """A moment in UTC in RFC 3339 format, with six decimals and a Z."""
    return moment.strftime("%Y-%m-%dT%H:%M:%S.%fZ")
