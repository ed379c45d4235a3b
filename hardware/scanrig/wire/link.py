"""The interface of a link to the controller."""

from typing import Protocol


class Link(Protocol):
    """A two-way stream of bytes; the connection may be lost."""

    @property
    def name(self) -> str:
        """Its name for messages: the port's path."""
        ...

    def write(self, data: bytes) -> None:
        """Send all of data. Raises LinkLost."""
        ...

    def read(self, timeout_s: float) -> bytes:
        """The bytes received, as soon as there are any; b"" after timeout_s without any. Raises LinkLost."""
        ...

    def close(self) -> None:
        """Close the port. Never raises."""
        ...
