"""A flood of half-open connections: each requests nothing, or begins a request that never ends, and holds its place."""

import contextlib
import selectors
import socket
import struct
import threading
import time


LOOPBACK = "127.0.0.1"
"""Only this machine is ever flooded."""
_BEGINNINGS = (b"", b"GET / HTTP/1.1\r\n", b"GET /?token=")
"""What comes of a request; the rest never does."""
_RESET = struct.pack("ii", 1, 0)
"""Closed with a reset, so that no port of ours stays taken for a minute."""
_TURN_S = 0.01


class Flood:
    """Within `with`, a thread holds so many connections to a port of the loopback, and renews those that end."""

    def __init__(self, port: int, *, held: int = 300, per_s: float = 300.0, most: int | None = None) -> None:
        """Nothing is connected yet.

        Args:
            held: Connections at a time, which must be far below the limit of open files.
            per_s: New connections in a second, at most.
            most: Connections in all; None for as many as the time allows.
        """
        self._port, self._held, self._per_s, self._most = port, held, per_s, most
        self.opened = 0
        self.ended = 0
        self.highest = 0
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="flood", daemon=True)
        self._problem: BaseException | None = None

    def __enter__(self) -> "Flood":
        self._thread.start()
        return self

    def __exit__(self, kind: object, problem: BaseException | None, trace: object) -> None:
        self._end.set()
        self._thread.join()
        if self._problem is not None and problem is None:
            raise self._problem

    @property
    def spent(self) -> bool:
        """Whether all connections were begun that there may be."""
        return self._most is not None and self.opened >= self._most

    def _run(self) -> None:
        try:
            with selectors.DefaultSelector() as selector, contextlib.ExitStack() as stack:
                self._pour(selector, stack)
        except BaseException as problem:
            self._problem = problem

    def _pour(self, selector: selectors.BaseSelector, stack: contextlib.ExitStack) -> None:
        before, allowed = time.monotonic(), 0.0
        while not self._end.wait(_TURN_S):
            now = time.monotonic()
            # What was not opened in its second is not made up for.
            allowed = min(allowed + (now - before) * self._per_s, self._per_s)
            before = now
            while allowed >= 1 and not self.spent and len(selector.get_map()) < self._held:
                one = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_STREAM))
                one.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET)
                one.setblocking(False)
                with contextlib.suppress(BlockingIOError):
                    one.connect((LOOPBACK, self._port))
                # It can be written to once it is connected.
                beginning = _BEGINNINGS[self.opened % len(_BEGINNINGS)]
                selector.register(one, selectors.EVENT_READ | selectors.EVENT_WRITE, beginning)
                self.opened += 1
                allowed -= 1
            self.highest = max(self.highest, len(selector.get_map()))
            for key, _ in selector.select(0):
                self._hear(selector, key)

    def _hear(self, selector: selectors.BaseSelector, key: selectors.SelectorKey) -> None:
        try:
            if key.events & selectors.EVENT_WRITE:
                key.fileobj.send(key.data)
                selector.modify(key.fileobj, selectors.EVENT_READ)
                return
            if key.fileobj.recv(4096):
                return
        except BlockingIOError:
            return
        except OSError:
            pass
        self.ended += 1
        selector.unregister(key.fileobj)
        key.fileobj.close()
