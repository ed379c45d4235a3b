"""A line to the controller, whatever carries its bytes."""

from typing import Protocol


class Link(Protocol):
    """A two-way stream of bytes that can be lost."""

    @property
    def name(self) -> str:
        """What a person calls it: the port's path."""
        ...

    def write(self, data: bytes) -> None:
        """Send all of data. Raises LinkLost."""
        ...

    def read(self, timeout_s: float) -> bytes:
        """What has come, as soon as something has; b"" after timeout_s without anything. Raises LinkLost."""
        ...

    def close(self) -> None:
        """Give the port back. Never raises."""
        ...
