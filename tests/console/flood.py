"""A flood of half-open connections: each requests nothing, or begins a request that never ends, and holds its place."""

import contextlib
import selectors
import socket
import struct
import threading
import time


BEGINNINGS = (b"", b"GET / HTTP/1.1\r\n", b"GET /?token=")
"""What comes of a request; the rest never does."""
RESET = struct.pack("ii", 1, 0)
"""Closed with a reset, so that no port of ours stays taken for a minute."""


class Flood:
    """Within `with`, a thread holds `held` connections to a port of the loopback, and renews those that end.

    It begins at most `per_s` in a second, and `most` in all; `held` must be far below the limit of open files.
    """

    def __init__(self, port, *, held=300, per_s=300.0, most=None):
        self.port, self.held, self.per_s, self.most = port, held, per_s, most
        self.opened = self.ended = self.highest = 0
        self._end, self._problem = threading.Event(), None
        self._thread = threading.Thread(target=self._run, name="flood", daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, kind, problem, trace):
        self._end.set()
        self._thread.join()
        if self._problem is not None and problem is None:
            raise self._problem

    @property
    def spent(self):
        return self.most is not None and self.opened >= self.most

    def _run(self):
        try:
            with selectors.DefaultSelector() as selector, contextlib.ExitStack() as stack:
                self._pour(selector, stack)
        except BaseException as problem:
            self._problem = problem

    def _pour(self, selector, stack):
        before, allowed = time.monotonic(), 0.0
        while not self._end.wait(0.01):
            now = time.monotonic()
            # What was not opened in its second is not made up for.
            before, allowed = now, min(allowed + (now - before) * self.per_s, self.per_s)
            while allowed >= 1 and not self.spent and len(selector.get_map()) < self.held:
                one = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_STREAM))
                one.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
                one.setblocking(False)
                with contextlib.suppress(BlockingIOError):
                    one.connect(("127.0.0.1", self.port))
                # It can be written to once it is connected.
                beginning = BEGINNINGS[self.opened % len(BEGINNINGS)]
                selector.register(one, selectors.EVENT_READ | selectors.EVENT_WRITE, beginning)
                self.opened, allowed = self.opened + 1, allowed - 1
            self.highest = max(self.highest, len(selector.get_map()))
            for key, _ in selector.select(0):
                if not self._goes_on(selector, key):
                    self.ended += 1
                    selector.unregister(key.fileobj)
                    key.fileobj.close()

    def _goes_on(self, selector, key):
        try:
            if key.events & selectors.EVENT_WRITE:
                key.fileobj.send(key.data)
                selector.modify(key.fileobj, selectors.EVENT_READ)
                return True
            return bool(key.fileobj.recv(4096))
        except BlockingIOError:
            return True
        except OSError:
            return False
