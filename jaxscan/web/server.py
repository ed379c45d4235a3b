"""A server in a thread of its own: the main thread answers signals, and may drive a rig meanwhile.

It accepts connections itself: asyncio would take as many as come, and where there are no descriptors left it would try
again at once, with a line in the log each time.
"""

import asyncio
import logging
import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType

from aiohttp import web

from jaxscan.web.address import Address
from jaxscan.web.connections import Connections


_END_S = 1.0
"""Longest time for connections to end, and for an unwanted body to arrive."""
_AT_ONCE = 8
"""Connections that are accepted before those that are there are heard: fewer than strangers may have, so that a head
that came with its connection is always read."""
_PAUSE_S = 0.005
"""Between two such turns: a flood leaves time for the scan."""
_FULL_PAUSE_S = 0.5
"""The same where no descriptor is left."""
_LOOK_S = 0.5
"""Between two looks for connections that take too long."""
_LOG = logging.getLogger("jaxscan.web")


class Server:
    """Serves an application within `with`."""

    def __init__(self, application: web.Application, address: Address) -> None:
        self._application, self._address = application, address
        self._begun = threading.Event()
        self._thread = threading.Thread(target=self._run, name="jaxscan-web", daemon=True)
        self._loop = asyncio.new_event_loop()
        self._end = asyncio.Event()
        self._problem: BaseException | None = None

    def __enter__(self) -> "Server":
        self._thread.start()
        self._begun.wait()
        if self._problem is not None:
            raise self._problem
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.call(self._end.set)
        self._thread.join()
        self._address.socket.close()

    def call(self, work: Callable[[], object]) -> None:
        """Do something in the server's thread, soon."""
        self._loop.call_soon_threadsafe(work)

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            self._loop.run_until_complete(self._serve())
        except BaseException as problem:
            self._problem = problem
            raise
        finally:
            self._begun.set()
            self._loop.close()

    async def _serve(self) -> None:
        runner = web.AppRunner(self._application, access_log=None, shutdown_timeout=_END_S, lingering_time=_END_S)
        await runner.setup()
        if runner.server is None:
            raise RuntimeError("a runner that is set up has a server")
        connections = Connections()
        door = _Door(self._address.socket, runner.server, connections)
        try:
            door.let_in()
            self._begun.set()
            while not self._end.is_set():
                connections.end_late_ones()
                with suppress(TimeoutError):
                    await asyncio.wait_for(self._end.wait(), _LOOK_S)
        finally:
            await door.close()
            await runner.cleanup()
            # Where the other end reads nothing, a transport waits for what is still to be sent.
            connections.abort()
            await asyncio.sleep(0)


class _Door:
    """Accepts connections, some at a time."""

    def __init__(self, listening: socket.socket, server: web.Server, connections: Connections) -> None:
        self._listening, self._server, self._connections = listening, server, connections
        self._loop = asyncio.get_running_loop()
        self._coming: set[asyncio.Task[object]] = set()
        self._spare: socket.socket | None = socket.socket()
        """A spare descriptor, closed when no other is left, to accept and refuse a connection."""
        self._again: asyncio.TimerHandle | None = None
        listening.setblocking(False)

    def let_in(self) -> None:
        """Begin to accept, or go on."""
        self._loop.add_reader(self._listening, self._accept_some)

    async def close(self) -> None:
        """Accept none any more; returns when those that were accepted are known to the server."""
        self._loop.remove_reader(self._listening)
        if self._again is not None:
            self._again.cancel()
        if self._coming:
            await asyncio.wait(self._coming)
        self._give_up_spare()

    def _accept_some(self) -> None:
        pause = _PAUSE_S
        for _ in range(_AT_ONCE):
            try:
                accepted, where = self._listening.accept()
            except (BlockingIOError, InterruptedError):
                return
            except ConnectionError:
                continue
            except OSError as problem:
                _LOG.warning("Connections are turned away for now: %s.", problem.strerror)
                self._turn_away()
                pause = _FULL_PAUSE_S
                break
            accepted.setblocking(False)
            task = self._loop.create_task(self._begin(accepted, str(where[0])))
            self._coming.add(task)
            task.add_done_callback(self._coming.discard)
        self._loop.remove_reader(self._listening)
        self._again = self._loop.call_later(pause, self.let_in)

    async def _begin(self, accepted: socket.socket, address: str) -> None:
        make = lambda: self._connections.admit(self._server(), address)
        try:
            await self._loop.connect_accepted_socket(make, accepted)
        except OSError:
            # It went in the same moment.
            accepted.close()

    def _turn_away(self) -> None:
        """Accept and close one waiting connection, so that it does not wait for ever."""
        self._give_up_spare()
        with suppress(OSError):
            accepted, _ = self._listening.accept()
            accepted.close()
        with suppress(OSError):
            self._spare = socket.socket()

    def _give_up_spare(self) -> None:
        if self._spare is not None:
            self._spare.close()
            self._spare = None
