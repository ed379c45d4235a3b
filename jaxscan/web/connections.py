"""The connections of a server: how many there may be, how long each may take, and who gives way.

Those who showed the token or its cookie are guests, all others strangers. Strangers have a small pool of their own, in
which the oldest of the address that has most gives way to a new one; guests are never put out for others.
"""

import asyncio
import time
from collections import Counter
from collections.abc import Callable
from typing import cast


STRANGERS = 32
"""Connections of those who have not shown the token yet."""
STRANGERS_OF_ONE = 16
"""Connections of such strangers from one address."""
GUESTS = 128
"""Connections of those who have: twelve pages with all their files at once."""
HEAD_S = 10.0
"""Within which the head of a request has to be complete."""
IDLE_S = 30.0
"""So long a connection may wait for its next request."""
READ_S = 10.0
"""So long the other end may read nothing of what waits for it."""
_OF_ALL_FILES = 4
"""One of this many descriptors of the process is for connections; the others are for the scan."""


def _file_limit() -> int | None:
    try:
        import resource
    except ImportError:
        return None  # Windows has no such limit.
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return None if soft == resource.RLIM_INFINITY else soft


class Connection(asyncio.Protocol):
    """Passes one connection's data to the HTTP protocol, and knows what the connection waits for."""

    def __init__(self, inner: asyncio.Protocol, all_of_them: "Connections", address: str) -> None:
        self._inner, self._all, self.address = inner, all_of_them, address
        self.transport: asyncio.Transport | None = None
        self.guest = False
        self._wait: tuple[float, float] | None = (all_of_them.now(), HEAD_S)
        """Since when a request is awaited, and how long that may take; None while one is answered."""
        self._unread, self._read_at = 0, 0.0
        self._aborted = False

    # What the event loop calls

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = cast(asyncio.Transport, transport)
        self._inner.connection_made(transport)
        if self._aborted:
            self.transport.abort()

    def data_received(self, data: bytes) -> None:
        if self._wait is not None and self._wait[1] == IDLE_S:
            # The next head begins; what comes after it does not give it more time.
            self._wait = (self._all.now(), HEAD_S)
        self._inner.data_received(data)

    def eof_received(self) -> bool | None:
        return self._inner.eof_received()

    def pause_writing(self) -> None:
        self._inner.pause_writing()

    def resume_writing(self) -> None:
        self._inner.resume_writing()

    def connection_lost(self, exc: Exception | None) -> None:
        self._all.forget(self)
        self._inner.connection_lost(exc)

    # What the gate calls

    def begin(self) -> None:
        """A head is complete; its request is answered from now on."""
        self._wait = None

    def end(self) -> None:
        """The request is answered."""
        self._wait = (self._all.now(), IDLE_S)

    def welcome(self) -> bool:
        """Make it a guest's; False where there are too many of them."""
        self.guest = self.guest or self._all.room_for_a_guest()
        return self.guest

    # What the server calls

    def is_late(self, now: float) -> bool:
        """Whether the other end takes too long, to ask or to read."""
        unread = 0 if self.transport is None else self.transport.get_write_buffer_size()
        if unread == 0 or unread < self._unread or self._unread == 0:
            self._read_at = now
        self._unread = unread
        waits = self._wait is not None and now - self._wait[0] > self._wait[1]
        return waits or now - self._read_at > READ_S

    def abort(self) -> None:
        """End it at once."""
        self._aborted = True
        self._all.forget(self)
        if self.transport is not None:
            self.transport.abort()


class Connections:
    """All connections of a server; in its thread alone."""

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        """Start without connections. The limits are far below that of open files."""
        limit = _file_limit()
        most = STRANGERS + GUESTS if limit is None else min(STRANGERS + GUESTS, max(limit // _OF_ALL_FILES, 8))
        self.most_strangers = max(4, STRANGERS * most // (STRANGERS + GUESTS))
        self.most_of_one = max(2, STRANGERS_OF_ONE * most // (STRANGERS + GUESTS))
        self.most_guests = most - self.most_strangers
        self.now = now
        self._there: dict[Connection, None] = {}

    def __len__(self) -> int:
        return len(self._there)

    def admit(self, inner: asyncio.Protocol, address: str) -> Connection:
        """A stranger's new connection; another one gives way to it where there are too many."""
        strangers = [one for one in self._there if not one.guest]
        of = Counter(one.address for one in strangers)
        crowded = address if of[address] >= self.most_of_one else None
        if crowded is None and len(strangers) >= self.most_strangers:
            crowded = of.most_common(1)[0][0]
        if crowded is not None:
            next(one for one in strangers if one.address == crowded).abort()
        new = Connection(inner, self, address)
        self._there[new] = None
        return new

    def room_for_a_guest(self) -> bool:
        """Whether one more may stay."""
        return sum(one.guest for one in self._there) < self.most_guests

    def forget(self, connection: Connection) -> None:
        """It has ended."""
        self._there.pop(connection, None)

    def end_late_ones(self) -> None:
        """End those whose other end takes too long."""
        now = self.now()
        for one in [one for one in self._there if one.is_late(now)]:
            one.abort()

    def abort(self) -> None:
        """End all."""
        for one in list(self._there):
            one.abort()
