"""The clock of the acquisition layer. Tests replace it by one that they move."""

import time
from datetime import UTC, datetime


class Clock:
    """The computer's clock."""

    def now(self) -> float:
        """Monotonic seconds; only differences are meaningful."""
        return time.monotonic()

    def utc(self) -> str:
        """The time of day, RFC 3339 in UTC."""
        return rfc3339(datetime.now(UTC))

    def sleep(self, s: float) -> None:
        time.sleep(s)


def rfc3339(moment: datetime) -> str:
    """A moment in UTC in RFC 3339 format, with six decimals and a Z."""
    return moment.strftime("%Y-%m-%dT%H:%M:%S.%fZ")
